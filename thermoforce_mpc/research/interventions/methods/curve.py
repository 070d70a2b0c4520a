"""v(u), what enters the modes of the operator instead of u: concave, as natural convection makes it.

The heat q that a room's air passes on to its surfaces grows with the temperature difference to the power 1.2 … 1.33, so
the difference grows with q to the power 0.75 … 0.83 (ASHRAE Handbook Fundamentals 2021, ch. 4: laminar and turbulent
natural convection at plates). Some heat passes without us, by sun, people and weather, so u begins at an offset.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import Array, Record

# Heat that the air passes on anyway, as a share of the capacity; fixed on validation windows of the first two draws.
_OFFSET = 0.3
EXPONENTS = (1.0, 0.9, 0.85, 0.8, 0.75, 0.7, 0.6, 0.5)
"""Exponents that are tried where a method has a curve; 1 is v(u) = u."""


def curved(u: Array, exponent: float) -> Array:
    """v(u) = ((u + c)^p − c^p) / ((1 + c)^p − c^p) with p = `exponent` in (0, 1], any shape; v(0) = 0, v(1) = 1.

    It rises with u, so what is monotone in v is monotone in u: the operator's certificate stays.
    """
    start = _OFFSET**exponent
    return np.asarray(((u + _OFFSET) ** exponent - start) / ((1.0 + _OFFSET) ** exponent - start))


def with_curve(history: Record, exponent: float) -> Record:
    """A record whose control is v(u)."""
    return replace(history, u=np.clip(curved(history.u, exponent), 0.0, 1.0))
