"""Superposition (paper eq:compose): a zone's temperature is its free response plus the forced one.

Solvers state the sum in their own variables; identification estimates both parts of a measured temperature at once.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data.clock import Array


def compose(T_free_C: Array | float, forced_K: Array | float) -> Array:
    """T = T_free + F, °C; shapes that broadcast, such as (Z, N) and (..., Z, N)."""
    return np.asarray(T_free_C + forced_K, dtype=np.float64)


def control_free(T_zone_C: Array, forced_K: Array) -> Array:
    """T_free = T − F, °C: a measured temperature without what actions added to it; NaN where T is not measured."""
    return np.asarray(T_zone_C - forced_K, dtype=np.float64)
