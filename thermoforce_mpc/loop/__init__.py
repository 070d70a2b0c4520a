"""The one loop: a controller on a plant step by step, its forecasts, the steps it keeps, and probing."""
