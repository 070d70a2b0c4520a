"""Verdicts on models beside what the models are worth. Read `house`."""
