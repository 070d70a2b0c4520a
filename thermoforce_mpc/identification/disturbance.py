"""Disturbance model: a sum of Ornstein-Uhlenbeck processes and sensor noise.

Unmeasured disturbances (wind, blinds, cooking, moving clouds) act through the building's time constants, so the
residuals are correlated. Least squares with independent noise would underestimate the uncertainty of the slow gain.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.config import IdentificationConfig


def disturbance_covariance(time_s: Array, config: IdentificationConfig, scale: float = 1.0) -> Array:
    """Return the covariance of the disturbance at `time_s` (n,) s, shape (n, n), K²; `scale` multiplies its sd."""
    lag_h = np.abs(time_s[:, None] - time_s[None, :]) / HOUR_S
    covariance = config.sensor_sd_K**2 * np.eye(time_s.size)
    for sd, hours in zip(config.disturbance_sd_K, config.disturbance_hours, strict=True):
        covariance += (scale * sd) ** 2 * np.exp(-lag_h / hours)
    return np.asarray(covariance)
