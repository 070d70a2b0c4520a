"""Interventional validity: paired interventions on EnergyPlus, methods that predict their effect, and their scores."""
