"""Records as regressions, modes and their uncertainty, and what is left of a record without effects."""
