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

from dataclasses import dataclass, field, replace

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


# Rows of an issued forecast.
_ENDS, _MEDIAN, _UP, _DOWN, _ADAPTED = range(5)
_NONE = np.empty((0, 2))


@dataclass(frozen=True)
class _Group:
    """State of a group of lead times that share a width.

    `steering`: adaptation of the log width. `window`: width from the last days, NaN with too few values. `scores`
    (k, 2): time, s, and distance from the median in raw half-widths of past values.
    """

    steering: float = 0.0
    window: float = float("nan")
    scores: Array = field(default_factory=lambda: _NONE)

    def ages(self, now: float) -> bool:
        """Whether a value is older than the window; the first is the oldest."""
        return bool(len(self.scores)) and now - float(self.scores[0, 0]) > _WINDOW_S


@dataclass(frozen=True)
class CalibratedState:
    """State of a run: forecasts issued and not yet fully compared, and the width of each group of lead times.

    `issued` (I, 5, K): of each forecast, at one lead time per hour, the end of the step, s, raw median, half-widths
    above and below, and log-width adaptation. `issued_s`: time of the last of them, s; `latest_s`: time of the last
    forecast, s; `n_steps`: its length; `inner`: state of the wrapped method.
    """

    issued: Array | None = None
    issued_s: float = -np.inf
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
        # One lead time per hour: those between are nearly identical.
        stride = max(1, round(_EVERY_S / boundary.step_s))
        hourly = slice(stride - 1, None, stride)
        before = np.empty((0, 5, len(range(n)[hourly]))) if last.issued is None else last.issued
        issued, groups = _compared(last, before, free, history, group_of[hourly])
        steering = np.array([group.steering for group in groups])[group_of]
        window = np.array([group.window for group in groups])[group_of]
        scale = _width(window, steering)
        median, issued_s = raw.median_C, last.issued_s
        if not len(issued) or now - issued_s >= _EVERY_S - 1.0:
            # NaN marks forecasts issued without a known width, which were not adapted.
            given = np.where(np.isnan(window), np.nan, steering)
            up, down = raw.quantiles_C[-1] - median, median - raw.quantiles_C[0]
            new = np.stack([boundary.time_s[1:], median, np.maximum(up, 1e-6), np.maximum(down, 1e-6), given])
            issued, issued_s = np.concatenate([issued, new[None, :, hourly]]), now
        note = f"{raw.note}; interval times {scale.min():.1f} to {scale.max():.1f}"
        forecast = FreeForecast(raw.levels, np.asarray(median + scale * (raw.quantiles_C - median)), note)
        return forecast, CalibratedState(issued, issued_s, groups, now, n, inner)


def _compared(
    last: CalibratedState, issued: Array, free: Array, history: Record, group_of: NDArray[np.intp]
) -> tuple[Array, tuple[_Group, ...]]:
    """Compare the values since the last call with their forecasts; return pending forecasts and updated groups."""
    now = float(history.time_s[-1])
    ends = issued[:, _ENDS]
    due = (ends > last.latest_s + 0.5) & (ends <= now + 0.5)
    if not due.any() and not any(group.ages(now) for group in last.groups):
        return issued, last.groups
    pending = issued[(ends[:, -1:] > now + 0.5).any(axis=1)]
    came = issued.transpose(1, 0, 2)[:, due]
    gap = _known(came[_ENDS], history.time_s, free) - came[_MEDIAN]
    scores = np.abs(gap) / np.where(gap >= 0, came[_UP], came[_DOWN])
    known = np.isfinite(scores)
    of = np.broadcast_to(group_of, due.shape)[due]
    window_of = np.array([group.window for group in last.groups])[of]
    inside = scores <= _width(window_of, came[_ADAPTED])
    adapted = np.isfinite(came[_ADAPTED] + window_of) & known
    groups = []
    for index, (group, gain) in enumerate(zip(last.groups, _STEERING_OF_GROUP, strict=True)):
        new, steering = known & (of == index), group.steering
        judged = inside[new & adapted]
        if judged.size:
            steering += gain * (_INSIDE - float(judged.mean()))
            steering = min(max(steering, _STEERING_RANGE[0]), _STEERING_RANGE[1])
        if not new.any() and not group.ages(now):
            groups.append(replace(group, steering=steering))
            continue
        kept = group.scores[now - group.scores[:, 0] <= _WINDOW_S]
        kept = np.concatenate([kept, np.stack([came[_ENDS, new], scores[new]], axis=1)])
        width_now = _quantile(kept[:, 1], _INSIDE) if len(kept) >= _LEAST_VALUES else float("nan")
        groups.append(_Group(steering, width_now, kept))
    return pending, tuple(groups)


def _quantile(values: Array, level: float) -> float:
    """What `np.quantile` returns of finite `values` (k,), in a tenth of its time; it is asked for in every hour."""
    ordered, place = np.sort(values), level * (values.size - 1)
    below = int(place)
    return float(ordered[below] + (place - below) * (ordered[min(below + 1, values.size - 1)] - ordered[below]))


def _width(window: Array | float, steering: Array | float) -> Array:
    """Return the factor on the distance of each quantile from the median; 1 with too few values."""
    return np.nan_to_num(np.clip(window * np.exp(steering), *_SCALE_RANGE), nan=1.0)


def _known(ends_s: Array, time_s: Array, free: Array) -> Array:
    """Return the control-free temperature at `ends_s` (N,), NaN if not in the history."""
    index = np.searchsorted(time_s, ends_s - 0.5)
    inside = (index < time_s.size) & (ends_s >= time_s[0] - 0.5)
    index = np.minimum(index, time_s.size - 1)
    match = inside & (np.abs(time_s[index] - ends_s) < 0.5)
    return np.where(match, free[index], np.nan)
