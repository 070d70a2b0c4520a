"""Differentiable predictive control: a policy trained through the model takes the place of the solver."""
