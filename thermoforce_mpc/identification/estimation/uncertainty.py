"""What an actuator does to a zone, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.modes import unit_steps

# Times after a step to full level at which the response and its standard deviation are stored, h.
STEP_RESPONSE_H: tuple[int, ...] = (1, 2, 4, 8, 12, 24, 48)


@dataclass(frozen=True)
class Effect:
    """What an actuator does to a zone: `log_tau` (r,): ln(τ/h), `gains` (r,): [slope K/h, G_2 … G_r K] in the direction
    of its sign, and `sd_K` (7,): standard deviations of the response at `STEP_RESPONSE_H`.
    """

    log_tau: Array
    gains: Array
    sd_K: Array

    @property
    def step_K(self) -> Array:
        """Response (m = 1) to full level, `STEP_RESPONSE_H` after, K."""
        return np.asarray(unit_steps(self.log_tau, np.array(STEP_RESPONSE_H)) @ self.gains)

    def uncertainty(self, level_sd: float = 0.0) -> dict[str, float]:
        """The step response and its standard deviations by name, K.

        `level_sd` is the relative standard deviation of the heat of a level, which adds to them.
        """
        out: dict[str, float] = {}
        for hours, mean_K, sd_K in zip(STEP_RESPONSE_H, self.step_K, self.sd_K, strict=True):
            out |= {f"step_response_{hours}h_K": float(mean_K)}
            out |= {f"step_response_{hours}h_sd_K": float(np.hypot(sd_K, level_sd * mean_K))}
        return out
