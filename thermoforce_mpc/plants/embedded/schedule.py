"""Occupancy, comfort bounds, native set-points and gains of the test cases by time of day and week."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.compiled import njit

# The same in all three test cases.
LOWER_OCCUPIED_C, UPPER_OCCUPIED_C = 21.0, 24.0
LOWER_EMPTY_C, UPPER_EMPTY_C = 15.0, 30.0
CO2_LIMIT_PPM = 894.0
# W per person: 60 % of the sensible part is radiant.
PERSON_RADIANT_W, PERSON_CONVECTIVE_W, PERSON_LATENT_W = 43.8, 29.2, 45.0
# Heat that the vapour of a person brings into the air, W: what the balance of the air over records of the real
# `bestest_air` and `bestest_hydronic` lacks while somebody is there.
PERSON_VAPOUR_W = 0.85
# `bestest_air`: W of lights and plugs while it is open, radiant shares, and the share that is always on.
LIGHTS_W, PLUGS_W = 11.8 * 48.0, 5.4 * 48.0
LIGHTS_RADIANT, PLUGS_RADIANT = 0.5, 0.7
STANDBY = 0.1
# Native set-point of `bestest_hydronic_heat_pump` above the lower bound, K.
SETPOINT_OCCUPIED_K, SETPOINT_EMPTY_K = 0.2, 5.5
# Sampling intervals of the boundary data of the houses and of the office, s, each held until the next.
_DATA_S, _OFFICE_DATA_S = 900.0, 600.0


@njit(cache=True)
def is_occupied(time_s: float) -> bool:
    """Whether a house is occupied: weekdays before 07:00 and from 20:00, weekends all day; day 0 is a Tuesday."""
    day = int(np.floor(time_s / 86400.0))
    weekday = day % 7
    hour = (time_s - day * 86400.0) / 3600.0
    return weekday == 4 or weekday == 5 or hour < 7.0 or hour >= 20.0


@njit(cache=True)
def is_occupied_sample(time_s: float) -> bool:
    """Return `OccupancySchedule.occupied_sample` of a house at one time."""
    data_s = np.floor(time_s / _DATA_S + 1e-9) * _DATA_S
    return is_occupied(data_s) or data_s % 86400.0 == 7 * 3600.0


@njit(cache=True)
def is_open(time_s: float) -> bool:
    """Whether the office is occupied: every day from 08:00 to 18:00."""
    hour = (time_s - np.floor(time_s / 86400.0) * 86400.0) / 3600.0
    return 8.0 <= hour < 18.0


def _house_occupied(time_s: Array) -> NDArray[np.bool_]:
    time_s = np.asarray(time_s, dtype=np.float64)
    day = np.floor(time_s / 86400.0)
    hour, weekday = (time_s - day * 86400.0) / 3600.0, day % 7
    return np.asarray((weekday == 4) | (weekday == 5) | (hour < 7.0) | (hour >= 20.0))


def _office_open(time_s: Array) -> NDArray[np.bool_]:
    time_s = np.asarray(time_s, dtype=np.float64)
    hour = (time_s - np.floor(time_s / 86400.0) * 86400.0) / 3600.0
    return np.asarray((hour >= 8.0) & (hour < 18.0))


def set_points_C(at_home: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return heating and cooling set-points, °C, for occupancy `at_home` (booleans)."""
    return (np.where(at_home, LOWER_OCCUPIED_C, LOWER_EMPTY_C), np.where(at_home, UPPER_OCCUPIED_C, UPPER_EMPTY_C))


@dataclass(frozen=True)
class OccupancySchedule:
    """Use of a building.

    Attributes:
        people: how many are there while it is occupied.
        occupied: occupancy (booleans, shape of the times, s), as the plant uses it.
        last_hour: hour of the day whose sample of the boundary data still counts as occupied.
        empty_ppm: CO2 bound while nobody is there; `CO2_LIMIT_PPM` while somebody is.
        data_s: sampling interval of the boundary data, s.
        equipped: whether it has the lights and plugs of the office.
    """

    people: int
    occupied: Callable[[Array], NDArray[np.bool_]]
    last_hour: float
    empty_ppm: float = CO2_LIMIT_PPM
    data_s: float = _DATA_S
    equipped: bool = False

    def occupied_sample(self, time_s: Array) -> NDArray[np.bool_]:
        """Return occupancy (booleans, shape of `time_s`) of BOPTEST's boundary data, for forecasts and KPIs."""
        data_s = np.floor(np.asarray(time_s, dtype=np.float64) / self.data_s + 1e-9) * self.data_s
        return self.occupied(data_s) | (data_s % 86400.0 == self.last_hour * 3600.0)

    def occupants(self, time_s: Array) -> Array:
        """Return the number of people of the boundary data."""
        return np.where(self.occupied_sample(time_s), float(self.people), 0.0)

    def bounds_C(self, time_s: Array) -> tuple[Array, Array]:
        """Return the lower and upper comfort bound of the boundary data, °C, see `occupied_sample`."""
        return set_points_C(self.occupied_sample(time_s))

    def co2_limit_ppm(self, time_s: Array) -> Array:
        """Return the CO2 bound of the boundary data, ppm."""
        return np.where(self.occupied_sample(time_s), CO2_LIMIT_PPM, self.empty_ppm)

    def gains_W(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Return radiant, convective and latent gains of the boundary data, W, (n,) each."""
        people = self.occupants(time_s)
        radiant, convective = PERSON_RADIANT_W * people, PERSON_CONVECTIVE_W * people
        if self.equipped:
            on: Array = np.where(people > 0, 1.0, STANDBY)
            radiant = radiant + on * (LIGHTS_RADIANT * LIGHTS_W + PLUGS_RADIANT * PLUGS_W)
            convective = convective + on * ((1.0 - LIGHTS_RADIANT) * LIGHTS_W + (1.0 - PLUGS_RADIANT) * PLUGS_W)
        return radiant, convective, PERSON_LATENT_W * people


HEAT_PUMP_USE = OccupancySchedule(5, _house_occupied, 7.0)
BOILER_USE = OccupancySchedule(1, _house_occupied, 7.0)
OFFICE_USE = OccupancySchedule(2, _office_open, 18.0, empty_ppm=1500.0, data_s=_OFFICE_DATA_S, equipped=True)
