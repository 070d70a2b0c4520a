"""Commands that look inside: decisions, models, files, and what is there by name."""
