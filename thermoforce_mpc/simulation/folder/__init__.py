"""The folder of a run: configuration, trajectories, steps, KPIs, log."""
