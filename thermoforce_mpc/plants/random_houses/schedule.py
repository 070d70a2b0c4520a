"""Presence, comfort bounds, native set-point and internal gains of a generated house."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.plants.drawn_houses.occupants import PERSON_W, at_home, set_back, varying
from thermoforce_mpc.plants.random_houses.draw import House

# Native set-point above the lower bound while at home, K; set-back below it, K, and preheating, h, by emitter.
NATIVE_ABOVE_K = 0.6
SET_BACK_K = {"floor": 1.0, "radiator": 2.0, "air": 3.0}
PREHEAT_H = {"floor": 4.0, "radiator": 3.0, "air": 2.0}


def bounds_C(house: House, time_s: Array) -> tuple[Array, Array]:
    """Return lower and upper comfort bound at `time_s`, °C."""
    home = at_home(house.pattern, time_s)
    return (
        np.where(home, house.lower_C, house.empty_lower_C),
        np.where(home, house.upper_C, house.empty_upper_C),
    )


def native_setpoint_C(house: House, time_s: Array) -> Array:
    """Return the set-point of the house's own control, °C: set back while nobody is home, preheating before they come.

    As installers set it: slow emitters are set back little and preheated early, and the set-back shrinks to nothing
    between a machine of 1.3 and one of 0.8 times the design load, which could not recover from it.
    """
    away = set_back(lambda t: at_home(house.pattern, t), time_s, lead_s=PREHEAT_H[house.emitter] * HOUR_S)
    day_C = house.lower_C + NATIVE_ABOVE_K
    back_K = SET_BACK_K[house.emitter] * min(max((house.sizing - 0.8) / 0.5, 0.0), 1.0)
    return np.where(away, day_C - back_K, day_C)


def gains_W(house: House, time_s: Array) -> Array:
    """Return internal heat gains on an equally spaced grid `time_s`, W: people, and appliances that vary at random.

    Appliances follow a log-normal first-order process with a correlation time of 2 h, seeded by the house.
    """
    home = at_home(house.pattern, time_s)
    varied = varying(np.random.default_rng([house.seed, house.index, 1]), time_s, house.gains_sd)
    appliances = np.where(home, house.gains_home_W_m2, house.gains_empty_W_m2) * house.floor_area_m2
    return np.asarray(np.where(home, house.people * PERSON_W, 0.0) + varied * appliances)
