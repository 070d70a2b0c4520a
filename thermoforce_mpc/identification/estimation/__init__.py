"""Estimators: from records to modes, gains and their uncertainty, at once or online."""
