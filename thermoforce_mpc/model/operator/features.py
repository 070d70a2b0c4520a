"""Features x_t of the modulation (paper eq:mod): zone temperature and weather, without the control.

Without `u` and `F` in x_t the effect of an action is exactly `a^k g m(x_t)` (paper eq:marginal). An operator with
`feedback` adds F to the first column itself, and its certificate accounts for it.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.errors import DataError

FEATURES: tuple[str, ...] = ("free_temperature_C", "outdoor_temperature_C", "solar_W_m2", "time_of_day")
"""Order of the columns: T − F in °C, outdoor °C, global horizontal W/m², cos(2π(hour − 15)/24)."""

N_FEATURES = len(FEATURES)
ZONE = FEATURES.index("free_temperature_C")
OUTDOOR = FEATURES.index("outdoor_temperature_C")

_WARMEST_HOUR = 15.0


def time_of_day(time_s: Array) -> Array:
    """Return cos(2π(hour − 15)/24): 1 at 15:00, −1 at 03:00; `time_s` in s since 1 January 00:00, any shape."""
    hour = np.mod(np.asarray(time_s, dtype=np.float64), DAY_S) / HOUR_S
    return np.asarray(np.cos(2.0 * np.pi * (hour - _WARMEST_HOUR) / 24.0))


def feature_matrix(free_C: Array, T_out_C: Array, solar_W_m2: Array, time_s: Array) -> Array:
    """Stack the four features of N steps, each sampled at the *start* of its step: (..., N, 4), as `FEATURES`.

    `free_C`: T − F, °C; `time_s`: s since 1 January; all (..., N) in physical units. Raises `DataError` where shapes do
    not broadcast, or a value is not finite.
    """
    columns = (free_C, T_out_C, solar_W_m2, time_of_day(time_s))
    try:
        matrix = np.empty((*np.broadcast_shapes(*map(np.shape, columns)), N_FEATURES))
    except ValueError as error:
        raise DataError(f"features of the operator differ in shape: {error}") from error
    for i, column in enumerate(columns):
        matrix[..., i] = column
    if not np.isfinite(matrix).all():
        bad = [name for i, name in enumerate(FEATURES) if not np.isfinite(matrix[..., i]).all()]
        raise DataError(f"features of the operator are not finite: {', '.join(bad)}; fill gaps first")
    return matrix
