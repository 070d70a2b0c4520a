"""What the weather inputs do not explain: a sum of Ornstein-Uhlenbeck processes and sensor noise.

A house is disturbed by what nobody measures (wind, blinds, cooking, moving clouds), and answers with its own slowness.
Least squares that take such drift for independent noise believe the slow gain long before the data can know it.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.config import IdentificationConfig


def disturbance_covariance(time_s: Array, config: IdentificationConfig, scale: float = 1.0) -> Array:
    """Covariance of the unexplained temperature at the times `time_s` (n,) s, shape (n, n), K²."""
    lag_h = np.abs(time_s[:, None] - time_s[None, :]) / HOUR_S
    covariance = config.sensor_sd_K**2 * np.eye(time_s.size)
    for sd, hours in zip(config.disturbance_sd_K, config.disturbance_hours, strict=True):
        covariance += (scale * sd) ** 2 * np.exp(-lag_h / hours)
    return np.asarray(covariance)
