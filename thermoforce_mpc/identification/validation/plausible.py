"""What the heat of an actuator can do to a room at most, from physics alone.

Rooms are those that the priors of the network allow (`network.room`, which has the source of each figure: capacity of
air, furniture and structure, heat loss of windows, air change and walls, all per m² of floor), with the heat of full
level as it was metered, else as the priors have it. Heat enters the air at once here, which is the most it can do.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.network.room import EMITTER, ROOM, Room

# Rooms drawn, and the share of them that a response may not exceed.
_ROOMS, _SHARE, _SEED = 1000, 0.99, 0
# Logarithm of a conductance that joins nothing.
_NOTHING = -30.0


def most_K(hours: Sequence[float], heat_W_m2: float = float("nan")) -> Array:
    """The step response to full level, K at `hours` (T,), that 1 in 100 rooms exceeds; its size if cooled.

    `heat_W_m2`: heat of full level per m² of floor, NaN where it was not metered or the area is not known.
    """
    return np.array(_most_K(tuple(hours), round(heat_W_m2, 1) if np.isfinite(heat_W_m2) else None))


@lru_cache(maxsize=64)
def _most_K(hours: tuple[float, ...], heat_W_m2: float | None) -> tuple[float, ...]:
    room = Room((1,), (float("nan") if heat_W_m2 is None else heat_W_m2,))
    draws = room.mean + room.sd * np.random.default_rng(_SEED).normal(size=(_ROOMS, room.mean.size))
    draws[:, room.place["H_emitter_0"]] = _NOTHING
    F = np.array([room.equations(theta).matrix[:EMITTER, :EMITTER] for theta in draws])
    heat = np.array([room.value(theta, "heat_0") / room.value(theta, "C_room") for theta in draws])
    rates, modes = np.linalg.eig(F)
    entering = np.linalg.inv(modes)[:, :, ROOM] * heat[:, None]
    rising = np.expm1(rates[:, None] * np.asarray(hours)[:, None]) / rates[:, None]
    responses = np.einsum("nm,nhm,nm->nh", modes[:, ROOM], rising, entering).real
    return tuple(np.quantile(responses, _SHARE, axis=0).tolist())
