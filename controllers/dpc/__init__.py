"""Differentiable predictive control: a policy trained offline through the thermal model (Drgoňa et al. 2022)."""
