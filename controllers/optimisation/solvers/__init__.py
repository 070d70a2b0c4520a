"""Solvers of the problem of a plan, one a file, and the programmes' own solvers behind them."""
