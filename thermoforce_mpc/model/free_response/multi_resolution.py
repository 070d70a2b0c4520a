"""Forecast of one series at several resolutions: its own step, hourly, and hourly over the last week only.

A model that forecasts 64 steps at once covers 16 h at 15 min and must be unrolled beyond. An hourly series of the same
history reaches further back and ahead in one pass: beyond 16 h errors are a few percent smaller, and the interval, far
too narrow when unrolled, is nearly right (docs/evidence/free-responses.md). The mean over resolutions is
better than most single ones. Quantiles are averaged level by level (Lichtendahl et al. 2013).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.model.free_response.backbones.base import Context

# Steps that the resolution at the series' own step forecasts at once: Chronos-Bolt's output patch.
_AT_ONCE = 64
_WEEK_S = 7 * DAY_S
# The last week is a separate resolution only if the history is longer than this.
_MORE_THAN_A_WEEK_S = 8 * DAY_S
# Least number of values for instance normalisation.
FEWEST_VALUES = 8


@dataclass(frozen=True)
class Resolution:
    """Input of the backbone at one resolution: a context with every `stride`-th value, for `n_steps` steps ahead."""

    context: Context
    stride: int
    n_steps: int
    now_C: float

    def of(self, free_C: Array) -> Resolution:
        """The same instants and weather of another series (k,), °C, with values where this one's has them."""
        series = _every(free_C, self.stride, self.context.free_C.size)
        context = Context(series, self.context.past_weather, self.context.ahead_weather)
        return Resolution(context, self.stride, self.n_steps, _now_C(free_C))

    def last(self, k: int) -> Resolution:
        """Only the last `k` values of the context."""
        free_C, past_weather = self.context.free_C[-k:], self.context.past_weather[-k:]
        return replace(self, context=replace(self.context, free_C=free_C, past_weather=past_weather))


def own_resolution(free_C: Array, past_weather: Array, ahead_weather: Array, longest: int) -> Resolution:
    """Return the resolution at the series' own step, over all steps ahead; arguments as in `resolutions_of`."""
    return _at_resolution(free_C, past_weather, ahead_weather, stride=1, longest=longest, ahead=len(ahead_weather))


def resolutions_of(
    free_C: Array, past_weather: Array, ahead_weather: Array, step_s: float, longest: int
) -> list[Resolution]:
    """Return all resolutions of a series; the first is at its own step.

    Args:
        free_C: (k,) °C, the last value is now; NaN if not measured, at least one value known.
        past_weather: (k, 3) at the same instants, see `Context`.
        ahead_weather: (N, 3) at the ends of the steps ahead.
        step_s: step of both, s.
        longest: largest number of values of a context.
    """
    n = len(ahead_weather)
    stride = max(1, int((HOUR_S + 1e-6) // step_s))
    whole = _at_resolution(free_C, past_weather, ahead_weather, stride=stride, longest=longest, ahead=n)
    coarse, coarse_s = [whole] if stride > 1 else [], stride * step_s
    if min(free_C.size * step_s, longest * coarse_s) > _MORE_THAN_A_WEEK_S:
        coarse.append(whole.last(round(_WEEK_S / coarse_s) + 1))
    coarse = [resolution for resolution in coarse if np.isfinite(resolution.context.free_C).sum() >= FEWEST_VALUES]
    # Steps beyond one output patch are left to the coarse resolutions, if there are any.
    ahead = min(n, _AT_ONCE) if any(resolution.stride > 1 for resolution in coarse) else n
    return [_at_resolution(free_C, past_weather, ahead_weather, stride=1, longest=longest, ahead=ahead), *coarse]


def _at_resolution(
    free_C: Array, past_weather: Array, ahead_weather: Array, *, stride: int, longest: int, ahead: int
) -> Resolution:
    """Return the resolution of the last `longest` of every `stride`-th value up to now, and `ahead` steps ahead."""
    series = _every(free_C, stride, longest)
    # Weather of a coarse step is its mean, since irradiance at one instant does not represent an hour.
    past = _block_means(past_weather[-series.size * stride :], stride, pad_before=True)
    coming = _block_means(ahead_weather[:ahead], stride, pad_before=False)
    return Resolution(Context(series, past, coming), stride, len(ahead_weather), _now_C(free_C))


def _every(free_C: Array, stride: int, longest: int) -> Array:
    return free_C[::-1][::stride][::-1][-longest:]


def _now_C(free_C: Array) -> float:
    """The last value that is known."""
    return float(free_C[-1] if np.isfinite(free_C[-1]) else free_C[np.isfinite(free_C)][-1])


def merged(resolutions: list[Resolution], answers: list[Array]) -> Array:
    """Return the mean over the resolutions that reach each lead time, (levels, N), °C; NaN only if one returned NaN.

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
    """What the last known value (n_steps,) and the answer (ahead, n_steps) of each resolution count in the mean.

    `courses`: stride and number of steps ahead of each.
    """
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
