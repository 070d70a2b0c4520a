"""What the drawn houses share, `random_houses` and `rooms`: walls and windows, weeks, and their plant."""
