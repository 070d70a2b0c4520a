"""One control step: what is believed, what is held, the forecast, the problem, its solution, and the plan."""
