"""Checks shared by free responses, and quantiles from past errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermoforce_mpc.data import Array, FreeForecast, Record
from thermoforce_mpc.errors import DataError

# Deciles: what forecasters of the Chronos family are trained for (Ansari et al. 2024).
LEVELS = np.arange(1, 10) / 10.0

# Tolerated crossing of neighbouring quantiles by rounding, K.
_ROUNDING_K = 1e-6


def level_places(quantiles: Sequence[float]) -> list[int] | None:
    """Where `LEVELS` are among the levels that a model was trained for; None unless all of them are."""
    trained, levels = [round(float(level), 6) for level in quantiles], LEVELS.round(1).tolist()
    return [trained.index(level) for level in levels] if set(levels) <= set(trained) else None


def checked_free(free_C: Array, history: Record) -> Array:
    """Return `free_C` as float64; raises `DataError` if it does not fit `history` or has no finite value."""
    free = np.asarray(free_C, dtype=np.float64)
    if free.shape != history.time_s.shape:
        raise DataError(f"control-free history has shape {free.shape}, the history {history.time_s.shape}")
    if not np.isfinite(free).any():
        raise DataError("control-free history has no finite value: the zone temperature was never measured")
    return free


def checked_forecast(forecast: object, n_steps: int, name: str) -> FreeForecast:
    """Return `forecast` of the free response `name`; raises `DataError` unless it has `n_steps` rising quantiles."""
    wrong = f"free response '{name}'"
    if not isinstance(forecast, FreeForecast):
        raise DataError(f"{wrong} gave a {type(forecast).__name__}, expected a FreeForecast")
    levels = np.asarray(forecast.levels, dtype=np.float64)
    if levels.ndim != 1 or not levels.size or not ((levels > 0) & (levels < 1)).all() or (np.diff(levels) <= 0).any():
        raise DataError(f"{wrong} gave the levels {levels.tolist()}, expected values in (0, 1) that rise")
    quantiles = np.asarray(forecast.quantiles_C, dtype=np.float64)
    if quantiles.shape != (levels.size, n_steps):
        raise DataError(f"{wrong} gave quantiles of shape {quantiles.shape}, expected ({levels.size}, {n_steps})")
    if not np.isfinite(quantiles).all():
        gaps = np.argwhere(~np.isfinite(quantiles))
        level, step = gaps[0]
        raise DataError(
            f"{wrong}: its {levels[level]:g} quantile is not finite at step {step} of {n_steps} ({len(gaps)} such)"
        )
    crossed = quantiles[1:] - quantiles[:-1] < -_ROUNDING_K
    if crossed.any():
        level, step = np.argwhere(crossed)[0]
        raise DataError(
            f"{wrong}: at step {step} its {levels[level + 1]:g} quantile is below its {levels[level]:g} quantile"
        )
    return forecast


def quantiles_from_errors(center: Array, errors: Array) -> Array:
    """Return quantiles (9, N) around `center` (N,) from past errors (measured − forecast), (k, N), NaN if unknown.

    A lead time with fewer than eight uses the spread of the nearest shorter one that has enough, or none.
    """
    finite = np.isfinite(errors)
    enough = np.count_nonzero(finite, axis=0) >= 8
    whole, offsets = finite.all(axis=0) & enough, np.zeros((LEVELS.size, center.size))
    if whole.any():
        offsets[:, whole] = np.quantile(errors[:, whole], LEVELS, axis=0)
    for lead in np.flatnonzero(enough & ~whole):
        offsets[:, lead] = np.quantile(errors[finite[:, lead], lead], LEVELS)
    offsets -= offsets[LEVELS.size // 2]  # keep the forecast as the median
    nearest = np.maximum.accumulate(np.where(enough, np.arange(center.size), -1))
    offsets = np.where(nearest < 0, 0.0, offsets[:, nearest])
    return np.asarray(np.sort(center + offsets, axis=0))
