"""Synthetic control-free temperature series: simulated rooms without control, and series of no physical origin.

No data of a measured building or of the real test case are used; the shipped forecaster was trained on these series
only. All series of a batch are generated together, step by step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.pretraining.climate import first_order, random_weather
from benchmarks.pretraining.occupants import held_by_others, random_people
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.model.free_response.backbones.base import clock
from thermoforce_mpc.model.free_response.linear_weather import DISTURBANCES_H, fitted, mean_course

# Steps in hours and how often each is drawn.
_STEPS_H = (0.25, 0.5, 1.0)
_STEP_SHARE = (0.4, 0.1, 0.5)
_SHARE_OF_ROOMS = 0.75
# Shares of rooms with an external thermostat, and of sensors that record the mean of a step.
_SHARE_HELD = 0.15
_SHARE_OF_MEANS = 0.25
_BURN_IN = 200
_SHARE_PADDED = 0.5
# Of a padded context, h: with less than a day there is no linear model.
_SHORTEST_CONTEXT_H = 25.0
_LEAST_FITTED_H = 20.0
# Irradiance of a clear sky at noon, W/m².
_SUN_W_M2 = 900.0
# Share of series whose weather ahead is a forecast with errors, and the correlation time of these errors, h.
_SHARE_UNCERTAIN = 0.5
_ERROR_H = 12.0


@dataclass(frozen=True)
class Batch:
    """`context` (B, C), padded with NaN on the left if short, and `future` (B, H), °C, float32.

    `covariates` (B, 3, C + H), float32: outdoor temperature, irradiance and `clock`, those of the future as forecast,
    at `hour` (B, C + H), h.
    """

    context: NDArray[np.float32]
    future: NDArray[np.float32]
    covariates: NDArray[np.float32]
    hour: Array


def draw_batch(rng: np.random.Generator, size: int, context: int, horizon: int) -> Batch:
    """Draw `size` series and cut them into context and future."""
    length = context + horizon
    n_rooms = round(_SHARE_OF_ROOMS * size)
    step_h = rng.choice(_STEPS_H, size, p=_STEP_SHARE)
    hour = rng.uniform(0, 24, size)[:, None] + step_h[:, None] * np.arange(length + _BURN_IN)
    outdoor, gain, irradiance = random_weather(rng, hour, step_h)
    rooms = _rooms(rng, hour[:n_rooms], step_h[:n_rooms], outdoor[:n_rooms], gain[:n_rooms])
    others = _others(rng, size - n_rooms, length)  # which no weather moves
    series = _measured(rng, np.concatenate([rooms, others]))
    covariates = np.stack([outdoor, irradiance, clock(HOUR_S * hour)], axis=1)[:, :, _BURN_IN:]
    _forecast_errors(rng, covariates[:, :2, context:], step_h)
    past, future = series[:, :context].copy(), series[:, context:]
    latest = context - np.minimum(np.ceil(_SHORTEST_CONTEXT_H / step_h).astype(int), context)
    # Evenly in the logarithm of the length: buildings begin with a day.
    starts = np.minimum(context - context * ((context - latest) / context) ** rng.random(size), latest).astype(int)
    starts = np.where(rng.random(size) < _SHARE_PADDED, starts, 0)
    past[np.arange(context) < starts[:, None]] = np.nan
    order = rng.permutation(size)
    seen, ahead, known = (values[order].astype(np.float32) for values in (past, future, covariates))
    return Batch(seen, ahead, known, hour[order, _BURN_IN:])


def courses(batch: Batch) -> NDArray[np.float32]:
    """What the linear weather model, fitted to each context, says of context and future (B, C + H), °C.

    NaN before a context begins, and where less than 20 h of it are known.
    """
    out = np.full(batch.hour.shape, np.nan, dtype=np.float32)
    for course, past, (T_out, sun, _), hour in zip(out, batch.context, batch.covariates, batch.hour, strict=True):
        known, step_h = np.flatnonzero(np.isfinite(past)), float(hour[1] - hour[0])
        if known.size * step_h >= _LEAST_FITTED_H:
            ahead = slice(known[0], None)
            free_C, T_out_C, solar = (row[ahead].astype(np.float64) for row in (past, T_out, _SUN_W_M2 * sun))
            fits = fitted(free_C, HOUR_S * hour[ahead], T_out_C, solar, HOUR_S * step_h, DISTURBANCES_H)
            course[ahead] = mean_course(fits)
    return out


def _forecast_errors(rng: np.random.Generator, ahead: Array, step_h: Array) -> None:
    """Add the errors of a forecast to outdoor temperature and irradiance ahead (n, 2, H), in place."""
    n, _, steps = ahead.shape
    grows = np.minimum(step_h[:, None] * np.arange(1, steps + 1) / 24.0, 1.0) ** 0.5
    size = np.stack([rng.uniform(0.0, 2.0, n), rng.uniform(0.0, 0.3, n)], axis=1) * (
        rng.random((n, 1)) < _SHARE_UNCERTAIN
    )
    for k in range(2):
        ahead[:, k] += size[:, k, None] * grows * first_order(rng, n, steps, step_h, np.full(n, _ERROR_H))
    ahead[:, 1] = np.maximum(ahead[:, 1], 0.0)


def _rooms(rng: np.random.Generator, hour: Array, step_h: Array, outdoor: Array, sun: Array) -> Array:
    """Rooms of one to four time constants, driven by weather, people and leftover control, °C, shape (n, length).

    `hour`, `outdoor`, `sun` (n, length + burn-in) and `step_h` (n,): see `random_weather`.
    """
    n, total = int(hour.shape[0]), int(hour.shape[1])
    people = random_people(rng, hour)
    drive = np.stack(
        [
            outdoor,
            sun * np.exp(rng.normal(-0.2, 0.8, n))[:, None],
            people * np.exp(rng.normal(-0.7, 0.8, n))[:, None],
            _leftover_control(rng, n, total) * np.exp(rng.normal(-1.5, 1.0, n))[:, None],
        ],
        axis=-1,
    )  # (n, total, 4)
    # Time constants from room air (half an hour) to a massive structure (ten days); light houses have fewer.
    tau_h = np.exp(np.stack([rng.uniform(np.log(a), np.log(b), n) for a, b in ((0.4, 2), (2, 8), (8, 40), (40, 240))]))
    tau_h = tau_h.T
    order = rng.integers(1, 5, n)
    weights = rng.gamma(0.8, 1.0, (n, 4, 4))  # drive by mode
    # Light houses lack slow modes, heavy ones fast modes: keep `order` neighbouring modes.
    first = (rng.random(n) * (5 - order)).astype(int)
    mode = np.arange(4)
    kept = (mode >= first[:, None]) & (mode < (first + order)[:, None])
    weights *= kept[:, None, :]
    weights[:, 0] /= np.maximum(weights[:, 0].sum(axis=-1, keepdims=True), 1e-9)  # steady-state gain of T_out is 1
    # Sun and people act faster than T_out: more weight on fast modes, smaller steady-state gain.
    weights[:, 1:] *= (tau_h[:, None, :] / 24.0) ** 0.3
    keep = np.exp(-step_h[:, None] / tau_h)
    state = np.repeat(outdoor.mean(axis=1)[:, None], 4, axis=1) * weights[:, 0]
    T = np.empty((n, total))
    gain = 1.0 - keep
    pushed = np.einsum("ntd,ndm->ntm", drive, weights)
    for t in range(total):
        state = keep * state + gain * pushed[:, t]
        T[:, t] = state.sum(axis=1)
    T += _fading_transient(rng, tau_h, kept, step_h, total)
    held = rng.random(n) < _SHARE_HELD
    T[held] = held_by_others(rng, T[held], hour[held], step_h[held])
    mean = rng.random(n) < _SHARE_OF_MEANS
    T[mean, 1:] = 0.5 * (T[mean, 1:] + T[mean, :-1])
    drift = rng.normal(0, 0.02, n)[:, None] * (rng.random(n) < 0.2)[:, None] * hour / 24
    return np.asarray((T + drift + rng.uniform(0, 18, n)[:, None])[:, _BURN_IN:])


def _fading_transient(
    rng: np.random.Generator, tau_h: Array, kept: NDArray[np.bool_], step_h: Array, total: int
) -> Array:
    """Decay after heating has stopped or a window was shut: a constant level, then a decay with the modes of the room.

    Shape (n, total), K, zero for most rooms. The decay starts in the first 85 % of the series, so that it seldom starts
    within the part to be forecast.
    """
    n = int(step_h.size)
    size = np.exp(rng.normal(1.0, 0.9, n)) * rng.choice([1.0, -1.0], n, p=[0.7, 0.3]) * (rng.random(n) < 0.3)
    share = rng.gamma(1.0, 1.0, kept.shape) * kept
    share /= share.sum(axis=1, keepdims=True)
    moment = rng.uniform(_BURN_IN - 100, 0.85 * total, n)
    since_h = np.maximum(np.arange(total) - moment[:, None], 0.0) * step_h[:, None]
    out = np.zeros((n, total))
    for mode in range(kept.shape[1]):
        out += share[:, mode, None] * np.exp(-since_h / tau_h[:, mode, None])
    return size[:, None] * out


def _leftover_control(rng: np.random.Generator, n: int, total: int) -> Array:
    """On/off pattern around zero, as an imperfect operator leaves in T − F, shape (n, total)."""
    stay = rng.uniform(0.7, 0.97, n)[:, None]
    flips = rng.random((n, total)) > stay
    return np.asarray(np.where(np.cumsum(flips, axis=1) % 2 == 0, -1.0, 1.0))


def _others(rng: np.random.Generator, n: int, length: int) -> Array:
    """Smooth random functions (random Fourier features of a Gaussian process), seasons, trends and noise."""
    t = np.arange(length)
    scale = np.exp(rng.uniform(np.log(4), np.log(300), (n, 1, 1)))
    # Heavier tails of the frequencies give rougher functions (Matérn instead of squared exponential).
    freedom = rng.uniform(1.5, 8.0, (n, 1, 1))
    frequency = (
        rng.standard_normal((n, 24, 1)) / scale / np.sqrt(rng.chisquare(np.broadcast_to(freedom, (n, 24, 1))) / freedom)
    )
    smooth = np.cos(frequency * t + rng.uniform(0, 2 * np.pi, (n, 24, 1))).sum(axis=1) / np.sqrt(12)
    period = rng.choice([24.0, 48.0, 96.0, 168.0], n)[:, None]
    season = np.zeros((n, length))
    for harmonic in range(1, 5):
        size = rng.normal(0, 1.0 / harmonic, n)[:, None]
        season += size * np.cos(2 * np.pi * harmonic * t / period + rng.uniform(0, 2 * np.pi, n)[:, None])
    slope = rng.normal(0, 1.0, n)[:, None] * (rng.random(n) < 0.3)[:, None] * t / length
    noise = rng.standard_normal((n, length)) * np.exp(rng.normal(-2.5, 1.0, n))[:, None]
    share = rng.gamma(1.0, 1.0, (n, 2))
    return np.asarray(share[:, :1] * smooth + share[:, 1:] * season + slope + noise)


def _measured(rng: np.random.Generator, series: Array) -> Array:
    """Add sensor effects: noise, rounding and rare gaps (NaN)."""
    n, length = int(series.shape[0]), int(series.shape[1])
    noisy = (
        series + rng.standard_normal((n, length)) * np.where(rng.random(n) < 0.5, rng.uniform(0, 0.08, n), 0.0)[:, None]
    )
    grain = rng.choice([0.0, 0.01, 0.1, 0.5], n, p=[0.5, 0.2, 0.25, 0.05])[:, None]
    rounded = np.where(grain > 0, np.round(noisy / np.maximum(grain, 1e-9)) * grain, noisy)
    gap = (rng.random((n, length)) < 0.01) & (rng.random(n) < 0.1)[:, None]
    return np.asarray(np.where(gap, np.nan, rounded))
