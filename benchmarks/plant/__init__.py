"""Accuracy and speed of the embedded plant, alone, together and as a Gymnasium environment."""
