"""Closed-loop runs on plants, their reports and comparisons."""
