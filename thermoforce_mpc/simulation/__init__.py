"""Closed loops on plants, their reports and comparisons."""
