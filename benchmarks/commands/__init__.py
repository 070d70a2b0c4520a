"""Benchmarks of plans in commands."""
