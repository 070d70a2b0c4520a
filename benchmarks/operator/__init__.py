"""Predicted effects of actions against reference interventions, and computing times of operator and training."""
