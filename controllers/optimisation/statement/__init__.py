"""The problem of a plan, stated once, and the functions that are built from it."""
