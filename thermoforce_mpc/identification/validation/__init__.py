"""Held-out data, the verdict that they give, and the picture of an identification."""
