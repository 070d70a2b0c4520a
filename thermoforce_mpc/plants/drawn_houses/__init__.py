"""What the drawn houses share, `random_houses` and `rooms`: walls and windows, occupants, weeks, and their plant."""
