"""Held-out data: which order, which verdict, and the picture of both."""
