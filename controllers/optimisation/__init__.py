"""The optimisation problem of a plan, and its solvers."""
