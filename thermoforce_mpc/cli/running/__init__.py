"""Commands that run controllers on plants: one run, comparisons, sweeps, fleets."""
