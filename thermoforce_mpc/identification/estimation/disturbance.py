"""Disturbance model: a sum of Ornstein-Uhlenbeck processes and sensor noise.

Unmeasured disturbances (wind, blinds, cooking, moving clouds) act through the building's time constants, so the
residuals are correlated. Least squares with independent noise would underestimate the uncertainty of the slow gain.

The processes are Markov, so a Kalman filter gives each row's innovation given all rows before (Harvey 1989, section
3.4): what a solve with the Cholesky factor of the covariance gives, in linear instead of quadratic time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.recursions import (
    covariance,
    innovation_effects,
    innovation_form,
    innovations,
)


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
    def assumed(cls, time_s: Array, config: IdentificationConfig) -> Disturbance:
        """What `config` assumes."""
        processes = np.array([config.disturbance_sd_K, config.disturbance_hours], dtype=np.float64)
        return cls(time_s, processes[0], processes[1], config.sensor_sd_K)

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

    def covariance(self) -> Array:
        """Covariance (rows, rows), K²."""
        return np.asarray(covariance(self.sd_K**2, self._decay, self.noise_sd_K**2))

    def factor(self, first: int = 0) -> Array:
        """L of the rows from `first` on (m, m), K: the effect of their innovations on them."""
        gain, decay, sd = self.innovations
        return np.asarray(innovation_effects(gain[first:], decay[first:], sd[first:]))

    def whitened(self, values: Array) -> Array:
        """Innovations of `values` (rows, ...) K in standard deviations: L⁻¹ values, where L Lᵀ is the covariance."""
        columns = np.ascontiguousarray(values, dtype=np.float64).reshape(values.shape[0], -1)
        return np.asarray(innovations(columns, *self.innovations)).reshape(values.shape)

    @cached_property
    def _decay(self) -> Array:
        """Decay of each process to the next row (rows, k)."""
        lag_h = np.diff(self.time_s, append=self.time_s[-1:]) / HOUR_S
        return np.asarray(np.exp(-lag_h[:, None] / self.hours))

    @cached_property
    def innovations(self) -> tuple[Array, Array, Array]:
        """Gains and decays (rows, k), standard deviations (rows,) K; see `recursions.innovations`."""
        gain, sd = innovation_form(self.sd_K**2, self._decay, self.noise_sd_K**2)
        return gain, self._decay, sd
