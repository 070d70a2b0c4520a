"""Everything that decides an action."""
