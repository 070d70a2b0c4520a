"""Look one step ahead while probing a light zone, which a full step can bring far outside its comfort band.

The change over a step is regressed, step by step, on the level, on the distances to the zone's recent mean and to the
outdoor temperature, and on the sun. Until the probing has shown what a level does, its effect is taken as the largest
change that native control caused per unit of level, or as large where that is unknown.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record

# Effect of full level over a step that is assumed where nothing was seen, K: a fan coil's on a light room in 15 min.
_UNSEEN_K = 10.0
# Native control shows the effect of a level only where it used at least this much of it, for at least this long. Set on
# `bestest_air`, as the numbers below: probing left its limits by 46 K·h in three days before, 0.03 since (2026-11-22).
_LEAST_LEVEL, _LEAST_PAST_S = 0.2, DAY_S
# Priors of the regression: standard deviations per unit of (distance to the recent mean, distance outdoors, 100 W/m²),
# and of what remains per step, K.
_REST_SD = (0.7, 0.03, 0.1)
_NOISE_K = 0.3
# Time constant of the recent mean, h: of a room's surfaces rather than its air.
_MEAN_H = 3.0


class Foresight:
    """Running estimate of what a level does to the zone within a step.

    Attributes:
        weights, covariance: of the effects of the level and what else moves the zone, (4,) and (4, 4).
        mean_C: recent mean of the zone, °C.

    Args:
        past: native control before the probing, at its step; may be one instant; None: `restore` follows.
        sign: +1 heating, −1 cooling.
    """

    def __init__(self, past: Record | None, sign: float, step_s: float) -> None:
        self._sign = sign
        self._keep = float(np.exp(-step_s / (_MEAN_H * HOUR_S)))
        self.weights: Array = np.zeros(4)
        self.covariance: Array = np.zeros((4, 4))
        self.mean_C = float("nan")
        if past is None:
            return
        bound = _bound_K(past)
        # In the direction of the actuator: mean + standard deviation of the effect is the bound.
        self.weights[0] = 0.5 * bound
        self.covariance = np.diag([0.5 * bound, *_REST_SD]) ** 2
        for T in past.T_zone_C[0]:
            self._remember(float(T))

    def restore(self, weights: Array, covariance: Array, mean_C: float) -> None:
        """Go on from what another one had learned."""
        self.weights, self.covariance, self.mean_C = weights, covariance, mean_C

    @property
    def effect_K(self) -> float:
        """Effect of full level over a step, on the safe side, K: mean plus standard deviation."""
        return float(self.weights[0] + np.sqrt(self.covariance[0, 0]))

    def learn(self, record: Record) -> None:
        """Learn from the last step of `record`, where its readings are complete."""
        start, end = record.T_zone_C[0, -2:]
        x = np.concatenate([[record.u[0, -1]], self._other_inputs(start, record.T_out_C[-2], record.solar_W_m2[-2])])
        change = self._sign * (end - start)
        if np.isfinite(x).all() and np.isfinite(change):
            gain = self.covariance @ x / (x @ self.covariance @ x + _NOISE_K**2)
            self.weights = self.weights + gain * (change - self.weights @ x)
            self.covariance = self.covariance - np.outer(gain, x @ self.covariance)
        self._remember(float(end))

    def polite(
        self, level: float, highest: float, T_zone_C: float, T_out_C: float, solar_W_m2: float, low: float, high: float
    ) -> float:
        """Return the level nearest to `level` that keeps the zone between `low` and `high` °C until the step's end.

        Where both cannot be kept, the side that the actuator itself would leave counts. A level in [0, `highest`].
        """
        if not np.isfinite(T_zone_C):
            return level
        rest = float(self.weights[1:] @ self._other_inputs(T_zone_C, T_out_C, solar_W_m2))
        towards, behind = (high, low) if self._sign > 0 else (-low, -high)
        room_K = towards - self._sign * T_zone_C - rest
        least_K = behind - self._sign * T_zone_C - rest
        raised = max(level, least_K / max(float(self.weights[0]), 1e-6))
        return float(np.clip(min(raised, room_K / max(self.effect_K, 1e-6)), 0.0, highest))

    def _other_inputs(self, T: float, T_out: float, solar: float) -> Array:
        """Regressors besides the level, (3,), in the direction of the actuator."""
        mean = self.mean_C if np.isfinite(self.mean_C) else T
        return self._sign * np.array([mean - T, T_out - T, solar / 100.0])

    def _remember(self, T: float) -> None:
        if np.isfinite(T):
            self.mean_C = self._keep * self.mean_C + (1 - self._keep) * T if np.isfinite(self.mean_C) else T


def _bound_K(past: Record) -> float:
    """Return the largest change of the zone over a step per unit of level in `past`, K."""
    if past.n_steps * (past.step_s if past.n_steps else 0.0) < _LEAST_PAST_S:
        return _UNSEEN_K
    used = past.u[0, np.isfinite(past.u[0])]
    changes = np.abs(np.diff(past.T_zone_C[0]))
    changes = changes[np.isfinite(changes)]
    if not (used.size and changes.size) or used.max() < _LEAST_LEVEL:
        return _UNSEEN_K
    return float(changes.max() / min(used.max(), 1.0))
