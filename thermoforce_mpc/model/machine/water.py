"""Warm water and electric power: a heat pump or condensing boiler takes more power per heat the warmer its water is.

Radiators follow the level within an hour. Power is then that of the level and a part u·w in the warmth w, the level
that the water follows over the time constant of the emitter; a level or a share of time that stays, which is what a
plan decides, has w = u: a part in u². Where that does not explain the power and the return water is measured, the power
has a factor 1 + κ (T_return − reference) instead; in predictions the return temperature is the zone temperature plus
the mean difference of the last day.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.data.series import lagged
from thermoforce_mpc.model.machine.load import LEVEL_EDGE, RESIDUAL_SCALE

# Times that are tried, s. A floor takes longer than the last but one: there no step of a plan warms its own water.
WATER_S = (0.25 * HOUR_S, 0.5 * HOUR_S, HOUR_S, 2.0 * HOUR_S, 6.0 * HOUR_S)
LONGEST_S = 2.0 * HOUR_S
# Share of the error of a power without it that may be left: else something else than the water makes most of it.
MOST_LEFT = 0.6
# Error over that with the measured return water up to which it stands for that: a plan sees the level, not the water.
AS_GOOD = 1.5
# Warmth at which levels are compared: that of a machine that gives half its heat.
COMPARED_AT = 0.5
# Least number of running steps with a measured return temperature to identify κ.
_LEAST_STEPS = 20
# 1 K of lift changes a heat pump's efficiency by 2 to 3 %, partly through the heat instead of the power.
_PRIOR_PER_K, _PRIOR_SD_PER_K = 0.01, 0.01
_BOUNDS_PER_K = (-0.02, 0.05)
# Extrapolation beyond the return temperatures of the data, K.
_TRUST_K = 5.0


def warmth(u: Array, step_s: float, water_s: float) -> Array:
    """Mean over each step of the level that the water follows over `water_s`, (n,); it begins at the mean of `u`."""
    levels = np.nan_to_num(u)
    ends = lagged(levels, float(np.exp(-step_s / water_s)), float(levels.mean()))
    return np.asarray(0.5 * (ends[:-1] + ends[1:]))


def squares_of(histories: Sequence[Record], water_s: float) -> Array:
    """Level times warmth in each step of records of one actuator, (n,)."""
    return np.concatenate([h.u[0] * warmth(h.u[0], h.step_s, water_s) for h in histories])


@dataclass(frozen=True)
class ReturnWater:
    """Factor on electric power by return water temperature.

    `per_K`: κ, 1/K; `reference_C`: return temperature of the fitted load, °C; `range_C`: valid range, °C (held beyond);
    `above_zone_K`: mean difference of return and zone temperature while the machine runs, K.
    """

    per_K: float
    reference_C: float
    range_C: tuple[float, float]
    above_zone_K: float

    def factor(self, T_return_C: Array) -> Array:
        """Return the factor on the power at `T_return_C` °C; 1 if it is NaN (not measured)."""
        T = np.clip(T_return_C, *self.range_C)
        return np.where(np.isfinite(T), 1.0 + self.per_K * (T - self.reference_C), 1.0)

    def expected_C(self, history: Record, T_zone_C: Array) -> Array:
        """The expected return temperature with the zone at `T_zone_C` °C and the machine on, same shape, °C.

        The difference is that of the last day of `history` while running, or of the identification where there is none.
        """
        if history.n_steps:
            last_day = history.last(max(1, round(DAY_S / history.step_s)))
            above_K = above_zone(last_day.T_return_C[0], last_day.T_zone_C[0, :-1], last_day.u[0])
        else:
            above_K = float("nan")
        return np.asarray(T_zone_C + (above_K if np.isfinite(above_K) else self.above_zone_K))


def above_zone(T_return_C: Array, T_zone_C: Array, u: Array) -> float:
    """Return the mean of return − zone temperature over running steps, weighted by u, K; NaN without measurements."""
    weight = np.where(np.isfinite(T_return_C) & np.isfinite(T_zone_C) & (u > LEVEL_EDGE), u, 0.0)
    if not weight.sum() > 0:
        return float("nan")
    return float(np.average(np.nan_to_num(T_return_C - T_zone_C), weights=weight))


def fit_return_water(
    T_return_C: Array, T_zone_C: Array, u: Array, misfit_of: Callable[[Array], float], full_W: float
) -> ReturnWater | None:
    """Fit κ by least squares with a prior; None if too few running steps have a measured return temperature.

    `T_return_C`, `u` (n,): means over each step; `T_zone_C` (n,) at its start. `misfit_of`: sum of squared residuals,
    W², of the load fitted with given factors (n,). `full_W`: an error of a step has `RESIDUAL_SCALE` times that.
    """
    running = np.isfinite(T_return_C) & (u > LEVEL_EDGE)
    if running.sum() < _LEAST_STEPS:
        return None
    low, high = float(T_return_C[running].min()), float(T_return_C[running].max())
    reference = float(np.average(T_return_C[running], weights=u[running]))
    above_K = above_zone(T_return_C, T_zone_C, u)
    if not np.isfinite(above_K):
        return None

    def water(per_K: float) -> ReturnWater:
        return ReturnWater(per_K, reference, (low - _TRUST_K, high + _TRUST_K), above_K)

    def loss(per_K: float) -> float:
        prior = ((per_K - _PRIOR_PER_K) / _PRIOR_SD_PER_K) ** 2
        return misfit_of(water(per_K).factor(T_return_C)) / (RESIDUAL_SCALE * full_W) ** 2 + prior

    minimum = minimize_scalar(loss, bounds=_BOUNDS_PER_K, method="bounded", options={"xatol": 1e-5})
    return water(float(minimum.x))
