"""Disturbance model: a sum of Ornstein-Uhlenbeck processes and sensor noise.

Unmeasured disturbances (wind, blinds, cooking, moving clouds) act through the building's time constants, so the
residuals are correlated. Least squares with independent noise would underestimate the uncertainty of the slow gain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from thermoforce_mpc.data import HOUR_S, Array

SENSOR_SD_K = 0.01
"""Noise of a temperature sensor, K."""
ASSUMED_SD_K, ASSUMED_H = np.array([0.02, 0.2, 2.0]), np.array([0.5, 3.0, 50.0])
"""Standard deviations of disturbances, K, and their time constants, h."""


@dataclass(frozen=True)
class Disturbance:
    """Disturbance of each row of a regression.

    `time_s` (rows,) s; `sd_K` (k,) K and `hours` (k,) h of the processes; `noise_sd_K` of the white noise, K.
    """

    time_s: Array
    sd_K: Array
    hours: Array
    noise_sd_K: float

    @classmethod
    def assumed(cls, time_s: Array, sensor_sd_K: float) -> Disturbance:
        """What is assumed of a house."""
        return cls(time_s, ASSUMED_SD_K, ASSUMED_H, sensor_sd_K)

    @classmethod
    def independent(cls, time_s: Array, sd_K: float) -> Disturbance:
        """White noise."""
        return cls(time_s, np.empty(0), np.empty(0), sd_K)

    def scaled(self, scale: float) -> Disturbance:
        """All standard deviations times `scale`."""
        return replace(self, sd_K=self.sd_K * scale, noise_sd_K=self.noise_sd_K * scale)

    def first(self, n: int) -> Disturbance:
        """The first `n` rows."""
        return replace(self, time_s=self.time_s[:n])

    @cached_property
    def covariance(self) -> Array:
        """Covariance (rows, rows), K²."""
        lag_h = np.abs(self.time_s[:, None] - self.time_s) / HOUR_S
        total = self.noise_sd_K**2 * np.eye(self.time_s.size)
        for sd, hours in zip(self.sd_K, self.hours, strict=True):
            total += sd**2 * np.exp(-lag_h / hours)
        return np.asarray(total)

    @cached_property
    def factor(self) -> Array:
        """L (rows, rows), K, with L Lᵀ the covariance: the effect of the rows' innovations on them."""
        return np.asarray(cholesky(self.covariance, lower=True, check_finite=False))

    def whitened(self, values: Array) -> Array:
        """Innovations L⁻¹ values of `values` (rows, ...) K, in standard deviations, each given the rows before it."""
        return np.asarray(solve_triangular(self.factor, values, lower=True, check_finite=False))
