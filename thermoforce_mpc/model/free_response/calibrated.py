"""Calibration of forecast intervals by the errors of issued forecasts, including errors of the weather forecast.

Each issued forecast is compared with the later free response by lead time, and the errors of the last 6 days set the
width (split conformal prediction over a rolling window, Angelopoulos and Bates 2023). These errors are few and
correlated, so the width is also adapted: wider after a value outside, narrower after a value inside (adaptive conformal
inference, Gibbs and Candès 2021, on the logarithm of the width as in the quantile tracking of Angelopoulos, Candès and
Tibshirani 2023).

The error of a forecast is known hours later, when the window already includes much of it. Adapting to it as well would
widen the interval twice for the same errors. So a value counts as outside only if it is outside with the present window
and the adaptation at the time of issue.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.asking import Asking, answered
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.checks import checked_free
from thermoforce_mpc.model.free_response.following import following
from thermoforce_mpc.protocols import FreeResponse

_INSIDE = 0.8
_WINDOW_S = 6 * DAY_S
# Forecasts issued within an hour are nearly identical: one per hour is stored.
_EVERY_S = HOUR_S
# Edges of the groups of lead times that share a width, h.
_LEAD_EDGES_H = (1.0, 2.0, 6.0, 12.0, 18.0, 24.0)
# Least number of hourly values of a group before its width is scaled.
_LEAST_VALUES = 24
# Adaptation gain: change of the log width per hour and unit of deviation from nominal coverage: 10 % wider if all
# values of a group are outside, 2 % narrower if none is. At long lead times the error is known later and the same gain
# would oscillate, so beyond 12 h it falls in proportion. Chosen on free runs of EnergyPlus and closed loops of the
# embedded plant, as was the separate group for the first hour.
_STEERING, _STEERING_LEAD_H, _FURTHEST_H = 0.12, 12.0, 48.0
_STEERING_OF_GROUP = tuple(_STEERING * min(1.0, _STEERING_LEAD_H / lead_h) for lead_h in (*_LEAD_EDGES_H, _FURTHEST_H))
_STEERING_RANGE = (-1.1, 1.1)
_SCALE_RANGE = (0.25, 5.0)


@dataclass(frozen=True)
class _Issued:
    """Issued forecast: ends of its steps, raw median and half-widths, and log-width adaptation, each (N,)."""

    time_s: float
    ends_s: Array
    median_C: Array
    up_K: Array
    down_K: Array
    steering: Array
    compared: int = 0


@dataclass(frozen=True)
class _Group:
    """State of a group of lead times that share a width.

    `steering`: adaptation of the log width. `window`: width from the last days, NaN with too few values. `scores`: time
    (s) and distance from the median in raw half-widths of past values.
    """

    steering: float = 0.0
    window: float = float("nan")
    scores: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class CalibratedState:
    """State of a run: forecasts issued and not yet fully compared, and the width of each group of lead times.

    `latest_s`: time of the last forecast, s; `n_steps`: its length; `inner`: state of the wrapped method.
    """

    issued: tuple[_Issued, ...] = ()
    groups: tuple[_Group, ...] = (_Group(),) * (len(_LEAD_EDGES_H) + 1)
    latest_s: float = -np.inf
    n_steps: int = 0
    inner: object = None


class CalibratedFreeResponse:
    """`inner` with intervals scaled to a coverage of 80 %.

    The state of a run holds its forecasts; a step back in time or another horizon resets it.
    """

    def __init__(self, inner: FreeResponse) -> None:
        """Wrap `inner`; its own intervals are used until enough errors are known."""
        self.inner = inner
        self.name = inner.name

    def weight_hash(self) -> str:
        """Return the hash of the weights of the wrapped method; raises `DataError` if it has none."""
        hashed = getattr(self.inner, "weight_hash", None)
        if hashed is None:
            raise DataError(f"free response '{self.name}' has no weights")
        return str(hashed())

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises what the wrapped method raises."""
        return self.follow(free_C, history, boundary, None)[0]

    def follow(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> tuple[FreeForecast, CalibratedState]:
        """See `FollowingFreeResponse.follow`; raises what the wrapped method raises."""
        return answered(self.following(free_C, history, boundary, state))

    def following(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> Asking[tuple[FreeForecast, CalibratedState]]:
        """See `AskingFreeResponse.following`; raises what the wrapped method raises."""
        free = checked_free(free_C, history)
        now, n = float(history.time_s[-1]), boundary.n_steps
        last = state if isinstance(state, CalibratedState) else CalibratedState()
        raw, inner = yield from following(self.inner, free, history, boundary, last.inner)
        group_of = np.searchsorted(_LEAD_EDGES_H, np.arange(1, n + 1) * boundary.step_s / HOUR_S - 1e-9)
        if now < last.latest_s or n != last.n_steps:
            last = CalibratedState()
        issued, groups = _compared(last, free, history, group_of, boundary.step_s)
        steering = np.array([group.steering for group in groups])[group_of]
        window = np.array([group.window for group in groups])[group_of]
        scale = _width(window, steering)
        if not issued or now - issued[-1].time_s >= _EVERY_S - 1.0:
            # NaN marks forecasts issued without a known width, which were not adapted.
            new = _issued(now, boundary.time_s[1:], raw, np.where(np.isnan(window), np.nan, steering))
            issued = (*issued, new)
        median = raw.median_C
        note = f"{raw.note}; interval times {scale.min():.1f} to {scale.max():.1f}"
        forecast = FreeForecast(raw.levels, np.asarray(median + scale * (raw.quantiles_C - median)), note)
        return forecast, CalibratedState(issued, groups, now, n, inner)


def _compared(
    last: CalibratedState, free: Array, history: Record, group_of: NDArray[np.intp], step_s: float
) -> tuple[tuple[_Issued, ...], tuple[_Group, ...]]:
    """Compare the values since the last call with their forecasts; return pending forecasts and updated groups."""
    now = float(history.time_s[-1])
    # One lead time per hour: those between are nearly identical.
    stride = max(1, round(_EVERY_S / step_s))
    held: list[list[bool]] = [[] for _ in last.groups]
    new: list[list[tuple[float, float]]] = [[] for _ in last.groups]
    issued = []
    for past in last.issued:
        came = int(np.searchsorted(past.ends_s, now + 0.5))
        leads = np.arange(past.compared, came)
        leads = leads[(leads + 1) % stride == 0]
        if came < past.ends_s.size:
            issued.append(replace(past, compared=came))
        gap = _known(past.ends_s[leads], history.time_s, free) - past.median_C[leads]
        scores = np.abs(gap) / np.where(gap >= 0, past.up_K[leads], past.down_K[leads])
        for lead, score in zip(leads[np.isfinite(scores)], scores[np.isfinite(scores)], strict=True):
            index = group_of[lead]
            new[index].append((float(past.ends_s[lead]), float(score)))
            steering, window = past.steering[lead], last.groups[index].window
            if np.isfinite(steering + window):
                held[index].append(bool(score <= _width(window, steering)))
    groups = []
    for group, inside, found, gain in zip(last.groups, held, new, _STEERING_OF_GROUP, strict=True):
        steering = group.steering
        if inside:
            steering = float(np.clip(steering + gain * (_INSIDE - float(np.mean(inside))), *_STEERING_RANGE))
        kept = tuple(item for item in (*group.scores, *found) if now - item[0] <= _WINDOW_S)
        known = len(kept) >= _LEAST_VALUES
        width = float(np.quantile([score for _, score in kept], _INSIDE)) if known else float("nan")
        groups.append(_Group(steering, width, kept))
    return tuple(issued), tuple(groups)


def _width(window: Array | float, steering: Array | float) -> Array:
    """Return the factor on the distance of each quantile from the median; 1 with too few values."""
    return np.nan_to_num(np.clip(window * np.exp(steering), *_SCALE_RANGE), nan=1.0)


def _issued(time_s: float, ends_s: Array, raw: FreeForecast, steering: Array) -> _Issued:
    median = raw.median_C
    up, down = raw.quantiles_C[-1] - median, median - raw.quantiles_C[0]
    return _Issued(time_s, np.asarray(ends_s), median, np.maximum(up, 1e-6), np.maximum(down, 1e-6), steering)


def _known(ends_s: Array, time_s: Array, free: Array) -> Array:
    """Return the control-free temperature at `ends_s` (N,), NaN if not in the history."""
    index = np.searchsorted(time_s, ends_s - 0.5)
    inside = (index < time_s.size) & (ends_s >= time_s[0] - 0.5)
    index = np.minimum(index, time_s.size - 1)
    match = inside & (np.abs(time_s[index] - ends_s) < 0.5)
    return np.where(match, free[index], np.nan)
