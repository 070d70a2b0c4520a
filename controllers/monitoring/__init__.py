"""Which readings of sensors and meters are used, and whether the model's predictions come true."""
