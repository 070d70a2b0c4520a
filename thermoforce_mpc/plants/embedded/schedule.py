"""Occupancy, comfort bounds and the native set-point of the test case, by the clock."""

from __future__ import annotations

import numpy as np
from numba import njit

from thermoforce_mpc.data import Array

PEOPLE = 5
LOWER_OCCUPIED_C, UPPER_OCCUPIED_C = 21.0, 24.0
LOWER_EMPTY_C, UPPER_EMPTY_C = 15.0, 30.0
# Native set-point above the lower bound, K.
SETPOINT_OCCUPIED_K, SETPOINT_EMPTY_K = 0.2, 5.5
CO2_LIMIT_PPM = 894.0


@njit(cache=True)
def is_occupied(time_s: float) -> bool:
    """Before 07:00 and from 20:00 on weekdays, all day at weekends; day 0 is a Tuesday."""
    day = math_floor(time_s / 86400.0)
    weekday = day % 7
    hour = (time_s - day * 86400.0) / 3600.0
    return weekday == 4 or weekday == 5 or hour < 7.0 or hour >= 20.0


@njit(cache=True, inline="always")
def math_floor(x: float) -> int:
    """The integer below `x`."""
    return int(np.floor(x))


def occupied_sample(time_s: Array) -> Array:
    """Occupancy as BOPTEST's boundary data samples it: the 07:00 sample still counts as occupied. Booleans."""
    time_s = np.asarray(time_s, dtype=np.float64)
    day = np.floor(time_s / 86400.0)
    hour = (time_s - day * 86400.0) / 3600.0
    return np.asarray(np.isin(day % 7, (4, 5)) | (hour <= 7.0) | (hour >= 20.0))


def bounds_C(time_s: Array) -> tuple[Array, Array]:
    """Lower and upper comfort bound at sample times, °C."""
    occupied = occupied_sample(time_s)
    return (
        np.where(occupied, LOWER_OCCUPIED_C, LOWER_EMPTY_C),
        np.where(occupied, UPPER_OCCUPIED_C, UPPER_EMPTY_C),
    )
