"""Forced state over a past record: the remaining effect of past heat (paper, below eq:arx)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.signal import lfilter

from thermoforce_mpc.data import DAY_S, Array, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.limits import ROUNDING
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.parameters import OperatorParameters

InitialForce = Literal["steady", "zero"]

# Fixed-point iterations for the initial forced state; the modulation changes it by a few percent only.
_START_ROUNDS = 5


def forced_history(operator: OperatorParameters, history: Record, *, initial_force: InitialForce = "steady") -> Array:
    """Return the forced state of each mode at each boundary of `history` (paper, below eq:arx), shape (n + 1, r), K.

    The modulation uses T − F of the rollout; a missing temperature is held at its last value. If the operator is driven
    by heat, measured heat is used instead of the map of u, under native control too.

    Raises:
        DataError: the weather has gaps, u has gaps without measured heat, or u is outside [0, 1]; says where.
    """
    n = history.n_steps
    if n == 0:
        return np.zeros((1, operator.order))
    operator = operator.resampled(history.step_s)
    heat = heat_drive(operator, history, 0, n)
    T_zone = _held(history.T_zone_C)
    features = feature_matrix(T_zone[:-1], history.T_out_C[:-1], history.solar_W_m2[:-1], history.time_s[:-1])
    forced = np.empty((n + 1, operator.order))
    forced[0] = _steady_start(operator, heat, features) if initial_force == "steady" else 0.0
    if not operator.output_weight.any():  # constant modulation: all steps at once
        drive = operator.modulation(features[0]) * heat
        for i, (a, g) in enumerate(zip(operator.poles, operator.gains, strict=True)):
            forced[1:, i] = lfilter([g], [1.0, -a], drive, zi=[a * forced[0, i]])[0]
        return forced
    for t in range(n):
        features[t, 0] = T_zone[t] - forced[t].sum()
        forced[t + 1] = operator.advance(forced[t], heat[t], features[t])
    return forced


def heat_drive(operator: OperatorParameters, history: Record, start: int, stop: int) -> Array:
    """Return v of the steps `start` … `stop` − 1 of `history`, shape (stop − start,), from measured heat if available.

    Identification is driven by v(u) instead; `identification.regression_data.run_regression` says why.

    Raises:
        DataError: the weather has gaps, u has gaps without measured heat, or u is outside [0, 1]; says where.
    """
    steps = slice(start, stop)
    heat_W, u = history.heat_W[steps], history.u[steps]
    T_out, solar = history.T_out_C[start : stop + 1], history.solar_W_m2[start : stop + 1]
    measured = np.isfinite(heat_W) & (operator.heat_input.heat is not None)
    u = np.where(measured & ~np.isfinite(u), 0.0, u)  # u is not used there
    for name, values in (("u", u), ("T_out_C", T_out), ("solar_W_m2", solar)):
        gaps = np.flatnonzero(~np.isfinite(values))
        if gaps.size:
            raise DataError(
                f"history: {name} is not finite at step {start + gaps[0]} of {history.n_steps} ({gaps.size} such): "
                "bridge it first (thermoforce_mpc.model.gaps)"
            )
    # Means over a step can exceed 1 by rounding.
    lowest = operator.heat_input.lowest
    outside = np.flatnonzero((u < lowest - ROUNDING) | (u > 1 + ROUNDING))
    if outside.size:
        at = start + outside[0]
        raise DataError(f"history: u is {u[outside[0]]:g} at step {at}, expected values in [{lowest:g}, 1]")
    heat = operator.heat_input(np.clip(u, lowest, 1.0), T_out[:-1])
    return np.where(measured, operator.sign * heat_W / operator.heat_input.reference_W, heat)


def _steady_start(operator: OperatorParameters, heat: Array, features: Array) -> Array:
    """Return the steady forced state under the first day's mean drive, shape (r,), K."""
    day = max(1, min(heat.size, round(DAY_S / operator.step_s)))
    heat, features = heat[:day], features[:day].copy()
    T_zone = features[:, 0].copy()
    forced = operator.steady_gains_K * heat.mean()
    for _ in range(_START_ROUNDS):
        features[:, 0] = T_zone - forced.sum()
        forced = operator.steady_gains_K * np.mean(operator.modulation(operator.seen(features, forced)) * heat)
    return np.asarray(forced)


def _held(values: Array) -> Array:
    """Return `values` with each gap filled by the last finite value (at the start, by the first)."""
    finite = np.isfinite(values)
    if not finite.any():
        return np.zeros_like(values)
    index = np.maximum.accumulate(np.where(finite, np.arange(values.size), -1))
    index = np.where(index < 0, np.flatnonzero(finite)[0], index)
    return np.asarray(values[index])
