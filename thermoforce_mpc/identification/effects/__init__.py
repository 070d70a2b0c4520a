"""What changes an actuator's effect: part load, outdoor temperature, the others, sun on the sensor."""
