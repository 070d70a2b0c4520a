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
# Distance of the boundary data's samples.
_DATA_S = 900.0


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


def occupied(time_s: Array) -> Array:
    """Occupancy by the clock, as the house knows it, see `is_occupied`. Booleans."""
    time_s = np.asarray(time_s, dtype=np.float64)
    day = np.floor(time_s / 86400.0)
    hour = (time_s - day * 86400.0) / 3600.0
    return np.asarray(np.isin(day % 7, (4, 5)) | (hour < 7.0) | (hour >= 20.0))


def occupied_sample(time_s: Array) -> Array:
    """Occupancy as BOPTEST's boundary data have it, for forecasts and KPIs. Booleans.

    The data lie every 15 min and are held until the next; the one of 07:00 still counts as occupied.
    """
    data_s = np.floor(np.asarray(time_s, dtype=np.float64) / _DATA_S + 1e-9) * _DATA_S
    return occupied(data_s) | (data_s % 86400.0 == 7 * 3600.0)


def bounds_C(time_s: Array) -> tuple[Array, Array]:
    """Lower and upper comfort bound of the boundary data, °C, see `occupied_sample`."""
    return set_points_C(occupied_sample(time_s))


def set_points_C(at_home: Array) -> tuple[Array, Array]:
    """Set-points for heating and cooling where somebody is at home (booleans) and where not, °C."""
    return (
        np.where(at_home, LOWER_OCCUPIED_C, LOWER_EMPTY_C),
        np.where(at_home, UPPER_OCCUPIED_C, UPPER_EMPTY_C),
    )
