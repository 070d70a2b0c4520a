"""Plans in commands of a building: what is set at actuators that answer through a loop of their own."""
