"""Occupancy, comfort bounds and native set-point of the test case by time of day and week."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from thermoforce_mpc.data import Array

PEOPLE = 5
OFFICE_PEOPLE = 2
# Heat that the vapour of a person brings into the air, W: what the air's balance over records of the real test cases
# lacks while somebody is there.
PERSON_VAPOUR_W = 0.85
LOWER_OCCUPIED_C, UPPER_OCCUPIED_C = 21.0, 24.0
LOWER_EMPTY_C, UPPER_EMPTY_C = 15.0, 30.0
# Native set-point above the lower bound, K.
SETPOINT_OCCUPIED_K, SETPOINT_EMPTY_K = 0.2, 5.5
CO2_LIMIT_PPM = 894.0
# Sampling interval of the boundary data, s.
_DATA_S = 900.0


@njit(cache=True)
def is_occupied(time_s: float) -> bool:
    """Whether the house is occupied: weekdays before 07:00 and from 20:00, weekends all day; day 0 is a Tuesday."""
    day = int(np.floor(time_s / 86400.0))
    weekday = day % 7
    hour = (time_s - day * 86400.0) / 3600.0
    return weekday == 4 or weekday == 5 or hour < 7.0 or hour >= 20.0


@njit(cache=True)
def is_open(time_s: float) -> bool:
    """Whether the office is occupied: every day from 8:00 to 18:00."""
    hour = (time_s - np.floor(time_s / 86400.0) * 86400.0) / 3600.0
    return 8.0 <= hour < 18.0


def occupied(time_s: Array) -> Array:
    """Return occupancy (booleans, shape of `time_s`) by the rule of `is_occupied`, as the plant uses it."""
    time_s = np.asarray(time_s, dtype=np.float64)
    day = np.floor(time_s / 86400.0)
    hour, weekday = (time_s - day * 86400.0) / 3600.0, day % 7
    return np.asarray((weekday == 4) | (weekday == 5) | (hour < 7.0) | (hour >= 20.0))


def occupied_sample(time_s: Array) -> Array:
    """Return occupancy (booleans, shape of `time_s`) of BOPTEST's boundary data, for forecasts and KPIs.

    The data have 15-min samples, each held until the next; the 07:00 sample still counts as occupied.
    """
    time_s = np.asarray(time_s, dtype=np.float64)
    return np.asarray(_occupied_samples(time_s.ravel())).reshape(time_s.shape)


@njit(cache=True)
def _occupied_samples(time_s: Array) -> NDArray[np.bool_]:
    occupied = np.empty(time_s.size, np.bool_)
    for i, at_s in enumerate(time_s):
        occupied[i] = is_occupied_sample(at_s)
    return occupied


@njit(cache=True)
def is_occupied_sample(time_s: float) -> bool:
    """Return `occupied_sample` of one time."""
    data_s = np.floor(time_s / _DATA_S + 1e-9) * _DATA_S
    return is_occupied(data_s) or data_s % 86400.0 == 7 * 3600.0


def bounds_C(time_s: Array) -> tuple[Array, Array]:
    """Return the lower and upper comfort bound of the boundary data, °C, see `occupied_sample`."""
    return set_points_C(occupied_sample(time_s))


def set_points_C(at_home: Array) -> tuple[Array, Array]:
    """Return heating and cooling set-points, °C, for occupancy `at_home` (booleans)."""
    return (np.where(at_home, LOWER_OCCUPIED_C, LOWER_EMPTY_C), np.where(at_home, UPPER_OCCUPIED_C, UPPER_EMPTY_C))
