"""The file of a model, of this release and of older ones."""
