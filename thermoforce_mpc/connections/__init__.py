"""Ways to read and set a real building."""
