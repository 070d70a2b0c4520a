"""What is believed of sensors and meters, and whether the model's predictions come true."""
