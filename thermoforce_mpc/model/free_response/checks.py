"""What every free response checks and shares: the history's shape, and quantiles from past errors."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.errors import DataError

LEVELS = np.arange(1, 10) / 10.0


def checked_free(free_C: Array, history: Record) -> Array:
    """`free_C` as float64; raises `DataError` when it does not fit `history` or has no finite value."""
    free = np.asarray(free_C, dtype=np.float64)
    if free.shape != history.time_s.shape:
        raise DataError(f"control-free history has shape {free.shape}, the history {history.time_s.shape}")
    if not np.isfinite(free).any():
        raise DataError("control-free history has no finite value: the temperature sensor was silent throughout")
    return free


def quantiles_from_errors(center: Array, errors: Array) -> Array:
    """Quantiles (9, N) around `center` (N,) from past errors (measured − forecast).

    Args:
        errors: shape (k, N), NaN where unknown; a lead time with fewer than eight errors takes the spread of the
            nearest lead time before it that has enough, or none.
    """
    offsets = np.zeros((LEVELS.size, center.size))
    last = np.zeros(LEVELS.size)
    for lead in range(center.size):
        known = errors[:, lead][np.isfinite(errors[:, lead])]
        if known.size >= 8:
            last = np.quantile(known, LEVELS)
            last = last - np.interp(0.5, LEVELS, last)  # the median stays the forecast itself
        offsets[:, lead] = last
    return np.asarray(np.sort(center + offsets, axis=0))
