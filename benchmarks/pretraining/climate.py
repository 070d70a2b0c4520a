"""Random weather for the synthetic rooms: correlated outdoor temperature and solar gain.

Components: weather systems, fronts, cloud that lasts hours or days and damps the daily cycle, seasonal drift. All
series of a batch are generated together.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array


def random_weather(rng: np.random.Generator, hour: Array, step_h: Array) -> tuple[Array, Array, Array]:
    """Outdoor temperature, K about its mean, solar gain through a window as a temperature rise, K, and irradiance.

    The irradiance is that of a horizontal surface, relative to the clear sky at noon: what a forecast tells.

    Args:
        rng: random generator.
        hour: time of the steps, h, shape (n, total).
        step_h: step of each series, h, shape (n,).

    Returns:
        Three arrays of shape (n, total).
    """
    n, total = int(hour.shape[0]), int(hour.shape[1])
    swing = rng.uniform(0.5, 7.0, n)[:, None]
    systems = first_order(rng, n, total, step_h, rng.uniform(30, 120, n)) * rng.uniform(1, 5, n)[:, None]
    gusts = first_order(rng, n, total, step_h, rng.uniform(4, 20, n)) * rng.uniform(0.2, 1.5, n)[:, None]
    clear = 1.0 - 0.85 * _cloud(rng, n, total, step_h)
    half_day = rng.uniform(3.8, 8.2, n)[:, None]
    noon = rng.normal(12.5, 0.8, n)[:, None]
    from_noon = np.mod(hour - noon + 12.0, 24.0) - 12.0
    elevation = np.where(np.abs(from_noon) < half_day, np.cos(np.pi / 2 * from_noon / half_day), 0.0)
    # Windows to the east or west receive sun before or after noon.
    facing = np.clip(1.0 + rng.normal(0, 0.12, n)[:, None] * from_noon, 0.0, 2.0)
    irradiance = elevation * clear
    sun = irradiance * facing * rng.uniform(1, 14, n)[:, None]
    angle = 2 * np.pi * (hour - rng.normal(15, 1, n)[:, None]) / 24
    # Temperature rises faster after dawn than it falls at night.
    cycle = np.cos(angle) + rng.uniform(0, 0.3, n)[:, None] * np.cos(2 * angle + rng.normal(0.5, 0.5, n)[:, None])
    # Clear days are warm in summer and cold in winter.
    season = rng.normal(0, 0.12, n)[:, None] * (hour - hour[:, :1]) / 24 + rng.normal(0, 2.0, n)[:, None] * clear
    outdoor = systems + gusts + _fronts(rng, n, total, step_h) + swing * (0.3 + 0.7 * clear) * cycle + season
    return outdoor, sun, irradiance


def _cloud(rng: np.random.Generator, n: int, total: int, step_h: Array) -> Array:
    """Cloud cover in [0, 1], mostly near 0 or 1, persistent over days with short breaks, shape (n, total)."""
    days = first_order(rng, n, total, step_h, rng.uniform(15, 90, n))
    breaks = first_order(rng, n, total, step_h, rng.uniform(2, 12, n))
    share = rng.uniform(0.3, 1.0, n)[:, None]
    slope = rng.uniform(1.0, 4.0, n)[:, None]
    return np.asarray(
        1.0 / (1.0 + np.exp(-slope * (share * days + (1 - share) * breaks) - rng.normal(0, 1, n)[:, None]))
    )


def _fronts(rng: np.random.Generator, n: int, total: int, step_h: Array) -> Array:
    """Step changes every few days that decay over a few days, K, shape (n, total)."""
    chance = step_h / rng.uniform(40, 200, n)
    size = rng.uniform(1.0, 5.0, n) * (rng.random(n) < 0.6)
    jumps = rng.standard_normal((n, total)) * (rng.random((n, total)) < chance[:, None]) * size[:, None]
    forget = np.exp(-step_h / rng.uniform(20, 100, n))
    arrive = np.exp(-step_h / rng.uniform(0.5, 4.0, n))
    level, value, out = np.zeros(n), np.zeros(n), np.empty((n, total))
    for t in range(total):
        level = forget * level + jumps[:, t]
        value = arrive * value + (1.0 - arrive) * level
        out[:, t] = value
    return out


def first_order(rng: np.random.Generator, n: int, total: int, step_h: Array, tau_h: Array) -> Array:
    """Gaussian noise of unit variance with correlation time `tau_h` (n,), shape (n, total)."""
    keep = np.exp(-step_h / tau_h)
    shock = rng.standard_normal((n, total)) * np.sqrt(1.0 - keep**2)[:, None]
    out = np.empty((n, total))
    value = rng.standard_normal(n)
    for t in range(total):
        value = keep * value + shock[:, t]
        out[:, t] = value
    return out
