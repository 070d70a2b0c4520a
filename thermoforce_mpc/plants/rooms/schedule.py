"""When each room is used; its comfort bounds, native set-point, people and internal gains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.plants.people import PERSON_W, at_home, hour_of_day, set_back, varying
from thermoforce_mpc.plants.random_houses.plant import PREHEAT_H, SET_BACK_K
from thermoforce_mpc.plants.rooms.house import DrawnHouse, Room
from thermoforce_mpc.plants.rooms.use import Kind

# Comfort bounds of a room that is not used, °C (BOPTEST's of an empty house).
UNUSED_LOWER_C, UNUSED_UPPER_C = 15.0, 30.0
# Native set-point above the lower bound in use, K: more than the dead band of the thermostat.
NATIVE_ABOVE_K = 0.4
_NIGHT_FROM_H, _NIGHT_TO_H = 22.0, 6.0


def at_home_or_asleep(house: DrawnHouse, time_s: Array) -> NDArray[np.bool_]:
    """Return whether people are in at `time_s`: by the pattern of presence, and in a house from 22 to 6 h."""
    present = at_home(house.pattern, time_s)
    return present if house.use == "office" else np.asarray(present | _night(hour_of_day(time_s)))


def in_use(house: DrawnHouse, kind: Kind, time_s: Array) -> NDArray[np.bool_]:
    """Bedrooms 20 to 9 h, baths 6 to 9 and 18 to 22 h, others 6 to 22 h, while people are in; like `time_s`."""
    hour = hour_of_day(time_s)
    if kind == "bedroom":
        used = (hour < 9.0) | (hour >= 20.0)
    elif kind == "bath":
        used = ((hour >= _NIGHT_TO_H) & (hour < 9.0)) | ((hour >= 18.0) & (hour < _NIGHT_FROM_H))
    else:
        used = ~_night(hour)
    return np.asarray(used & at_home_or_asleep(house, time_s))


def bounds_C(house: DrawnHouse, time_s: Array) -> tuple[Array, Array]:
    """Return lower and upper comfort bounds of the rooms at `time_s` (n,), °C, shape (Z, n) each."""
    used = {kind: in_use(house, kind, time_s) for kind in {room.kind for room in house.rooms}}
    lower = [np.where(used[room.kind], room.lower_C, UNUSED_LOWER_C) for room in house.rooms]
    upper = [np.where(used[room.kind], room.upper_C, UNUSED_UPPER_C) for room in house.rooms]
    return np.array(lower), np.array(upper)


def native_setpoints_C(house: DrawnHouse, time_s: Array) -> Array:
    """Return the rooms' native set-points at `time_s` (n,), °C, shape (Z, n): set back while unused, preheated before.

    Set-back, its shrinking with the machine, and preheating are those of the emitter in a generated house.
    """
    shrink = min(max((house.sizing - 0.8) / 0.5, 0.0), 1.0)
    unused: dict[tuple[str, str], NDArray[np.bool_]] = {}
    rows = []
    for room in house.rooms:
        key = (room.kind, room.emitter)
        if key not in unused:
            unused[key] = set_back(
                lambda t, room=room: in_use(house, room.kind, t),  # type: ignore[misc]
                time_s,
                lead_s=PREHEAT_H[room.emitter] * HOUR_S,
            )
        rows.append(room.lower_C + NATIVE_ABOVE_K - unused[key] * SET_BACK_K[room.emitter] * shrink)
    return np.array(rows)


def people(house: DrawnHouse, time_s: Array) -> Array:
    """Return the expected number of people in each room at `time_s` (n,), shape (Z, n)."""
    return in_rooms(house, time_s, np.where(at_home_or_asleep(house, time_s), float(house.people), 0.0))


def in_rooms(house: DrawnHouse, time_s: Array, home: Array) -> Array:
    """Return people in each room, shape (Z, n), where `home` (n,) of them are in at `time_s` (n,)."""
    night = _night(hour_of_day(time_s))
    return np.array([home * np.where(night, room.people_night, room.people_day) for room in house.rooms])


def gains_W(house: DrawnHouse, time_s: Array) -> Array:
    """Return internal gains of each room on an equally spaced grid `time_s` (n,), W, shape (Z, n).

    People, and appliances that vary at random (see `varying`) in each room on its own, seeded by the house.
    """
    home = at_home(house.pattern, time_s)
    level_W_m2 = np.where(home, house.gains_home_W_m2, house.gains_empty_W_m2)

    def appliances_W(i: int, room: Room) -> Array:
        rng = np.random.default_rng([house.seed, len(house.rooms), 1, i])
        return level_W_m2 * room.appliances * room.area_m2 * varying(rng, time_s, house.gains_sd)

    appliances = np.array([appliances_W(i, room) for i, room in enumerate(house.rooms)])
    return np.asarray(PERSON_W * people(house, time_s) + appliances)


def _night(hour: Array) -> NDArray[np.bool_]:
    return np.asarray((hour >= _NIGHT_FROM_H) | (hour < _NIGHT_TO_H))
