"""The map of a table (map.yaml): which column is what."""
