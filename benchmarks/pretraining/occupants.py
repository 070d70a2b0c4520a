"""Occupant effects in the synthetic rooms: presence and appliances, short events, an external thermostat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array

_MOST_BLOCKS = 3


def random_people(rng: np.random.Generator, hour: Array) -> Array:
    """Heat of presence and appliances relative to a usual day, shape (n, total) as `hour` (h).

    One to three blocks a day with start times that vary from day to day, different weekends, days of absence, days with
    more or less heat, and short events (cooking, window opening) at loosely repeating times.
    """
    n = int(hour.shape[0])
    day = np.floor(hour / 24.0).astype(int)
    days = int(day.max()) + 1
    hour_of_day = np.mod(hour, 24.0)
    weekday = (np.arange(days)[None, :] + rng.integers(0, 7, n)[:, None]) % 7
    weekend = (weekday >= 5) & (rng.random(n) < 0.6)[:, None]
    away = _stays(rng, n, days, 0.06) & (rng.random(n) < 0.3)[:, None]
    loud = rng.gamma(6.0, 1 / 6.0, (n, days)) * np.where(away, 0.1, 1.0)
    jitter = rng.normal(0, 1.0, (n, days)) * rng.uniform(0.0, 1.2, n)[:, None]
    shift = np.where(weekend, rng.normal(2.0, 2.0, n)[:, None], 0.0) + jitter
    blocks = rng.integers(1, _MOST_BLOCKS + 1, n)
    out = np.zeros(hour.shape)
    for block in range(_MOST_BLOCKS):
        start = rng.uniform(0, 24, n)
        length = rng.uniform(2, 16, n) / blocks
        begin = np.take_along_axis(start[:, None] + shift, day, axis=1)
        inside = np.mod(hour_of_day - begin, 24.0) < length[:, None]
        # At weekends a block may be missing, or occupants are present at other times.
        swapped = np.take_along_axis(weekend & (rng.random(n) < 0.4)[:, None], day, axis=1)
        size = rng.uniform(0.5, 1.5, n) * (block < blocks)
        out += size[:, None] * (inside != swapped)
    return np.asarray(out * np.take_along_axis(loud, day, axis=1) + _events(rng, hour_of_day))


def held_by_others(rng: np.random.Generator, T: Array, hour: Array, step_h: Array) -> Array:
    """`T` (n, total) under an external thermostat that limits its fall, with or without a set-back.

    Below the set-point a fraction of the deviation remains; above it the series is unchanged.
    """
    n, total = int(T.shape[0]), int(T.shape[1])
    setback = rng.uniform(0, 4, n) * (rng.random(n) < 0.6)
    start, length = rng.uniform(18, 28, n), rng.uniform(4, 12, n)
    night = np.mod(hour - start[:, None], 24.0) < length[:, None]
    wanted = np.where(night, -setback[:, None], 0.0)
    # Set-points anywhere in the range of the free response: active always, at times, or hardly ever.
    share = rng.uniform(0.3, 1.2, n)[:, None]
    low, high = T.min(axis=1, keepdims=True), T.max(axis=1, keepdims=True)
    wanted = wanted + low + share * (high - low)
    up, down = np.exp(-step_h / rng.uniform(0.3, 3, n)), np.exp(-step_h / rng.uniform(5, 60, n))
    level, value = np.empty((n, total)), wanted[:, 0].copy()
    for t in range(total):
        keep = np.where(wanted[:, t] > value, up, down)
        value = keep * value + (1.0 - keep) * wanted[:, t]
        level[:, t] = value
    over = T - level
    leak, knee = rng.uniform(0.0, 0.3, n)[:, None], rng.uniform(0.1, 1.0, n)[:, None]
    return np.asarray(level + leak * over + (1.0 - leak) * knee * np.logaddexp(0.0, over / knee))


def _events(rng: np.random.Generator, hour_of_day: Array) -> Array:
    """Positive or negative pulses of one step, rare or at repeating hours, shape (n, total)."""
    n = int(hour_of_day.shape[0])
    favourite = rng.uniform(0, 24, n)[:, None]
    distance = np.abs(np.mod(hour_of_day - favourite + 12.0, 24.0) - 12.0)
    spread = rng.uniform(0.5, 6, n)[:, None]
    chance = rng.uniform(0.01, 0.5, n)[:, None] * np.exp(-((distance / spread) ** 2))
    size = np.exp(rng.normal(0.5, 0.8, n)) * rng.choice([1.0, -1.0], n, p=[0.7, 0.3]) * (rng.random(n) < 0.5)
    return np.asarray((rng.random(hour_of_day.shape) < chance) * size[:, None])


def _stays(rng: np.random.Generator, n: int, days: int, chance: float) -> NDArray[np.bool_]:
    """Stretches of one to a few days, shape (n, days), boolean."""
    state = np.zeros(n, dtype=bool)
    out = np.empty((n, days), dtype=bool)
    for day in range(days):
        state = np.where(state, rng.random(n) < 0.6, rng.random(n) < chance)
        out[:, day] = state
    return out
