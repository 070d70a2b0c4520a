"""The file of a model."""
