"""Held-out data and the verdict that they give."""
