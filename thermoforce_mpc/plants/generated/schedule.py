"""Presence, comfort bounds, native set-point and internal gains of a generated house."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.plants.generated.draw import House

# Days of the year modulo 7 that are a weekend (BOPTEST: 1 January is a Tuesday).
_WEEKEND = (4, 5)
# Native set-point above the lower bound while at home, K; set-back below it, K, and preheating, h, by emitter.
NATIVE_ABOVE_K = 0.6
_SET_BACK_K = {"floor": 1.0, "radiator": 2.0, "air": 3.0}
_PREHEAT_H = {"floor": 4.0, "radiator": 3.0, "air": 2.0}
_PERSON_W = 80.0
_GAINS_HOURS = 2.0


def at_home(house: House, time_s: Array) -> NDArray[np.bool_]:
    """Return presence at `time_s`, shape of `time_s`, by the pattern of the house.

    away: weekdays before 7:00 and from 20:00, weekends (BOPTEST); home: daily 6:00 to 22:00; workers: weekdays 6:00 to
    8:00 and 17:00 to 22:00, weekends 7:00 to 23:00; always: all the time.
    """
    time_s = np.asarray(time_s, dtype=np.float64)
    day = np.floor(time_s / DAY_S + 1e-9)
    hour = (time_s - day * DAY_S) / HOUR_S + 1e-9
    weekend = np.isin(day % 7, _WEEKEND)
    if house.pattern == "away":
        return np.asarray(weekend | (hour < 7.0) | (hour >= 20.0))
    if house.pattern == "home":
        return np.asarray((hour >= 6.0) & (hour < 22.0))
    if house.pattern == "workers":
        working = ((hour >= 6.0) & (hour < 8.0)) | ((hour >= 17.0) & (hour < 22.0))
        return np.asarray(np.where(weekend, (hour >= 7.0) & (hour < 23.0), working))
    return np.ones(time_s.shape, dtype=bool)


def bounds_C(house: House, time_s: Array) -> tuple[Array, Array]:
    """Return lower and upper comfort bound at `time_s`, °C."""
    home = at_home(house, time_s)
    return (
        np.where(home, house.lower_C, house.empty_lower_C),
        np.where(home, house.upper_C, house.empty_upper_C),
    )


def native_setpoint_C(house: House, time_s: Array) -> Array:
    """Return the set-point of the house's own control, °C: set back while nobody is home, preheating before they come.

    As installers set it: slow emitters are set back little and preheated early, and the set-back shrinks to nothing
    between a machine of 1.3 and one of 0.8 times the design load, which could not recover from it.
    """
    lead_s = _PREHEAT_H[house.emitter] * HOUR_S
    # Presence within the preheating time, on the 15-min grid of the schedules.
    ahead = np.arange(0.0, lead_s + 1.0, 900.0)
    soon = np.any([at_home(house, time_s + shift) for shift in ahead], axis=0)
    day_C = house.lower_C + NATIVE_ABOVE_K
    back_K = _SET_BACK_K[house.emitter] * min(max((house.sizing - 0.8) / 0.5, 0.0), 1.0)
    return np.where(soon, day_C, day_C - back_K)


def gains_W(house: House, time_s: Array) -> Array:
    """Return internal heat gains on an equally spaced grid `time_s`, W: people, and appliances that vary at random.

    Appliances follow a log-normal first-order process with a correlation time of 2 h, seeded by the house.
    """
    home = at_home(house, time_s)
    rng = np.random.default_rng([house.seed, house.index, 1])
    memory = np.exp(-(time_s[1] - time_s[0]) / HOUR_S / _GAINS_HOURS)
    draws = rng.standard_normal(time_s.size)
    noise = np.empty(time_s.size)
    noise[0] = draws[0]
    for i in range(1, time_s.size):
        noise[i] = memory * noise[i - 1] + np.sqrt(1.0 - memory**2) * draws[i]
    sd = np.sqrt(np.log1p(house.gains_sd**2))
    varied = np.exp(sd * noise - 0.5 * sd**2)
    appliances = np.where(home, house.gains_home_W_m2, house.gains_empty_W_m2) * house.floor_area_m2
    return np.asarray(np.where(home, house.people * _PERSON_W, 0.0) + varied * appliances)
