"""Commands for a building of your own: measurements, model, plans and what they saved."""
