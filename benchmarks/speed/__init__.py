"""This checkout beside another one: `python -m benchmarks.speed --against PATH`."""
