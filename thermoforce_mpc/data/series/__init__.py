"""What is done with a series of readings: gaps filled, and what follows it with a lag."""
