"""What faults of plant, sensors, forecasts and solvers cost, and how soon they are noticed."""
