"""One zone: its records as regressions, and its model from them, with its verdict."""
