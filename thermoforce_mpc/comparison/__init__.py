"""Comparison of controllers on windows and tariffs, in parallel processes, resumable."""
