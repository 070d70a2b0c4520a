"""Forecast of one series at two resolutions: its own step, and hourly.

A model that forecasts 64 steps at once covers 16 h at 15 min and must be unrolled beyond. An hourly series of the same
history reaches further: beyond 16 h errors are a few percent smaller, and the interval, far too narrow when unrolled,
is nearly right (docs/evidence/free-responses.md). The mean of both is better than either.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.model.free_response.backbones.base import Context

# Steps that the resolution at the series' own step forecasts at once: Chronos-Bolt's output patch.
_AT_ONCE = 64
# Least number of values for instance normalisation: with fewer a standard deviation is wrong by a quarter and more.
FEWEST_VALUES = 8


@dataclass(frozen=True)
class Resolution:
    """Input of the backbone at one resolution: a context with every `stride`-th value, for `n_steps` steps ahead."""

    context: Context
    stride: int
    n_steps: int
    now_C: float


def resolutions_of(
    free_C: Array, past_weather: Array, ahead_weather: Array, step_s: float, longest: int, *, hourly: bool = True
) -> list[Resolution]:
    """Return all resolutions of a series; the first is at its own step.

    `free_C` (k,) °C: the last value is now, NaN if not measured, at least one known; `past_weather` (k, 3) and
    `ahead_weather` (N, 3) as in `Context`, at steps of `step_s`; `longest`: most values of a context.
    Without `hourly` the first alone, over all steps ahead.
    """
    n = len(ahead_weather)
    stride = max(1, int((HOUR_S + 1e-6) // step_s)) if hourly else 1
    if stride > 1:
        coarse = _at_resolution(free_C, past_weather, ahead_weather, stride=stride, longest=longest, ahead=n)
        if np.isfinite(coarse.context.free_C).sum() >= FEWEST_VALUES:
            # Steps beyond one output patch are left to the hourly one.
            ahead = min(n, _AT_ONCE)
            own = _at_resolution(free_C, past_weather, ahead_weather, stride=1, longest=longest, ahead=ahead)
            return [own, coarse]
    return [_at_resolution(free_C, past_weather, ahead_weather, stride=1, longest=longest, ahead=n)]


def _at_resolution(
    free_C: Array, past_weather: Array, ahead_weather: Array, *, stride: int, longest: int, ahead: int
) -> Resolution:
    """Return the resolution of the last `longest` of every `stride`-th value up to now, and `ahead` steps ahead."""
    series = free_C[::-1][::stride][::-1][-longest:]
    # Weather of a coarse step is its mean, since irradiance at one instant does not represent an hour.
    past = _block_means(past_weather[-series.size * stride :], stride, pad_before=True)
    coming = _block_means(ahead_weather[:ahead], stride, pad_before=False)
    return Resolution(Context(series, past, coming), stride, len(ahead_weather), float(free_C[np.isfinite(free_C)][-1]))


def merged(resolutions: list[Resolution], answers: list[Array]) -> Array:
    """The mean over the resolutions that reach each lead time, (levels, N), °C; NaN only if one returned NaN.

    Coarse ones are interpolated linearly between their instants, starting from the last known value.
    """
    courses = tuple((resolution.stride, len(resolution.context.ahead_weather)) for resolution in resolutions)
    total = np.zeros((len(answers[0]), resolutions[0].n_steps))
    for resolution, answer, (of_now, of_answer) in zip(
        resolutions, answers, _shares(courses, resolutions[0].n_steps), strict=True
    ):
        total += answer @ of_answer
        total += resolution.now_C * of_now
    return total


@lru_cache(maxsize=64)
def _shares(courses: tuple[tuple[int, int], ...], n_steps: int) -> list[tuple[Array, Array]]:
    """What the last known value (n_steps,) and the answer (ahead, n_steps) of each course count in the mean."""
    lead = np.arange(1, n_steps + 1)
    reaches = np.array([lead <= stride * ahead for stride, ahead in courses])
    shares = []
    for (stride, ahead), reached in zip(courses, reaches / reaches.sum(axis=0), strict=True):
        # The answer to step i of its own counts fully at lead i · stride, and less before and after.
        of_each = np.maximum(0.0, 1.0 - np.abs(lead / stride - np.arange(ahead + 1)[:, None])) * reached
        shares.append((of_each[0], of_each[1:]))
    return shares


def _block_means(weather: Array, stride: int, *, pad_before: bool) -> Array:
    """Return means of `stride` rows each; an incomplete first (`pad_before`) or last block repeats its end value."""
    if stride == 1:
        return weather
    short, padded = (-len(weather)) % stride, weather
    if short and pad_before:
        padded = np.concatenate([np.repeat(weather[:1], short, axis=0), weather])
    elif short:
        padded = np.concatenate([weather, np.repeat(weather[-1:], short, axis=0)])
    return np.asarray(padded.reshape(-1, stride, weather.shape[1]).mean(axis=1))
