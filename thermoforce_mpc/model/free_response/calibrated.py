"""Calibration of forecast intervals by the errors of issued forecasts, including errors of the weather forecast.

Each issued forecast is compared with the later free response by lead time, and the errors of the last 6 days set the
width (split conformal prediction over a rolling window, Angelopoulos and Bates 2023). These errors are few and
correlated, so the width is also adapted: wider after a value outside, narrower after a value inside (adaptive conformal
inference, Gibbs and Candès 2021, on the logarithm of the width as in Angelopoulos, Candès and Tibshirani 2023).

The error of a forecast is known hours later, when the window already includes much of it. To not widen twice for the
same errors, a value counts as outside only if it is so with the present window and the adaptation at the time of issue.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.data.series import at_instants
from thermoforce_mpc.execution.cooperative import Computation
from thermoforce_mpc.model.free_response.checks import checked_free
from thermoforce_mpc.model.free_response.following import Computed, MeanState, following
from thermoforce_mpc.protocols import FreeResponse

# Share of values that a band promises to hold, and hours of forecasts that it is fitted to: six days are those of a
# weather (`bench free-response`, 2026-11-21).
_INSIDE = 0.8
_WINDOW_S = 6 * DAY_S
# Forecasts issued within an hour are nearly identical: one per hour is stored.
_EVERY_S = HOUR_S
# Edges of the groups of lead times that share a width, h: errors grow fast in the first hours, then by the day.
_LEAD_EDGES_H = (1.0, 2.0, 6.0, 12.0, 18.0, 24.0)
# Least number of hourly values of a group before its width is scaled. By judgement: a day.
_LEAST_VALUES = 24
# Adaptation gain: change of the log width per hour and unit of deviation from nominal coverage: 10 % wider if all
# values of a group are outside, 2 % narrower if none is. At long lead times the error is known later and the same gain
# would oscillate, so beyond 12 h it falls in proportion. Chosen on free runs of EnergyPlus and closed loops of the
# embedded plant, as was the separate group for the first hour.
_STEERING, _STEERING_LEAD_H, _FURTHEST_H = 0.12, 12.0, 48.0
_STEERING_OF_GROUP = tuple(_STEERING * min(1.0, _STEERING_LEAD_H / lead_h) for lead_h in (*_LEAD_EDGES_H, _FURTHEST_H))
_GROUPS = len(_STEERING_OF_GROUP)
# Logarithm of the width by steering, and factor of the width by the window: by judgement, a third to three times and a
# quarter to five times.
_STEERING_RANGE = (-1.1, 1.1)
_SCALE_RANGE = (0.25, 5.0)


@dataclass(frozen=True)
class IssuedForecasts:
    """I forecasts at K lead times, one for each hour.

    `time_s` (I,): when each was issued, s. `raw` (I, 3, K): median °C, half-widths above and below, K. `adapted` (I,
    G): adaptation of the log width then, NaN where no width was known.
    """

    time_s: Array
    raw: Array
    adapted: Array

    def select(self, which: NDArray[np.bool_]) -> IssuedForecasts:
        """Those of `which` (I,)."""
        return IssuedForecasts(self.time_s[which], self.raw[which], self.adapted[which])


@dataclass(frozen=True)
class Scores:
    """Distances (H, K) of past values at `time_s` (H,), s, from the medians that forecast them, in raw half-widths."""

    time_s: Array
    values: Array


@dataclass(frozen=True)
class CalibratedState:
    """State of a run: forecasts issued and not yet fully compared, and the width of each of G groups of lead times.

    `steering` (G,): adaptation of the log width; `window` (G,): width from the `scores` of the last days, NaN with too
    few of them. `latest_s`: time of the last forecast, s; `n_steps`: its length. `inner`: what the method inside keeps.
    """

    issued: IssuedForecasts | None = None
    scores: Scores | None = None
    steering: Array = field(default_factory=lambda: np.zeros(_GROUPS))
    window: Array = field(default_factory=lambda: np.full(_GROUPS, np.nan))
    latest_s: float = -np.inf
    n_steps: int = 0
    inner: MeanState | None = None


class CalibratedFreeResponse(Computed):
    """`inner` with intervals scaled to a coverage of 80 %; a step back in time or another horizon begins anew."""

    def __init__(self, inner: FreeResponse) -> None:
        """Wrap `inner`; its own intervals are used until enough errors are known."""
        super().__init__(inner)
        self.inner = inner

    def following(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> Computation[tuple[FreeForecast, CalibratedState]]:
        """See `ComputedFreeResponse.following`; raises what the wrapped method raises."""
        free = checked_free(free_C, history)
        now, n = float(history.time_s[-1]), boundary.n_steps
        last = state if isinstance(state, CalibratedState) else CalibratedState()
        raw, inner = yield from following(self.inner, free, history, boundary, last.inner)
        if now < last.latest_s or n != last.n_steps:
            last = CalibratedState()
        lead_s = np.asarray(np.arange(1, n + 1) * boundary.step_s, dtype=np.float64)
        group_of = np.searchsorted(_LEAD_EDGES_H, lead_s / HOUR_S - 1e-9)
        # One lead time per hour: those between are nearly identical.
        stride = max(1, round(_EVERY_S / boundary.step_s))
        hourly = slice(stride - 1, None, stride)
        compared = _scored(last, lead_s[hourly], group_of[hourly], free, history)
        scale = _width(compared.window[group_of], compared.steering[group_of])
        median, issued = raw.median_C, compared.issued
        if issued is None or not issued.time_s.size or now - issued.time_s[-1] >= _EVERY_S - 1.0:
            up, down = raw.quantiles_C[-1] - median, median - raw.quantiles_C[0]
            new = np.stack([median, np.maximum(up, 1e-6), np.maximum(down, 1e-6)])[None, :, hourly]
            # NaN marks forecasts issued without a known width, which were not adapted.
            adapted = np.where(np.isnan(compared.window), np.nan, compared.steering)[None]
            if issued is None:
                issued = IssuedForecasts(np.array([now]), new, adapted)
            else:
                issued = IssuedForecasts(
                    np.append(issued.time_s, now),
                    np.concatenate([issued.raw, new]),
                    np.concatenate([issued.adapted, adapted]),
                )
        note = f"{raw.note}; interval times {scale.min():.1f} to {scale.max():.1f}"
        forecast = FreeForecast(raw.levels, np.asarray(median + scale * (raw.quantiles_C - median)), note)
        kept = inner if isinstance(inner, MeanState) else None
        return forecast, replace(compared, issued=issued, latest_s=now, n_steps=n, inner=kept)


def _scored(
    last: CalibratedState, lead_s: Array, group_of: NDArray[np.intp], free: Array, history: Record
) -> CalibratedState:
    """The state after comparing the values since the last call with what forecast them at `lead_s` (K,), s."""
    issued, now = last.issued, float(history.time_s[-1])
    if issued is None:
        return last
    scores = last.scores or Scores(np.empty(0), np.empty((0, lead_s.size)))
    ends = issued.time_s[:, None] + lead_s
    due = (ends > last.latest_s + 0.5) & (ends <= now + 0.5)
    fresh = now - scores.time_s <= _WINDOW_S
    if not due.any() and fresh.all():
        return last
    which, lead = np.nonzero(due)
    median, up, down = issued.raw[which, :, lead].T
    gap = at_instants(ends[due], history.time_s, free, 0.5) - median
    score = np.abs(gap) / np.where(gap >= 0, up, down)
    group, at = group_of[lead], last.window[group_of[lead]]
    adapted = issued.adapted[which, group]
    inside = score <= _width(at, adapted)
    scored = np.isfinite(score + adapted + at)
    steering = last.steering.copy()
    for index in np.unique(group[scored]):
        share = float(inside[scored & (group == index)].mean())
        steering[index] = np.clip(steering[index] + _STEERING_OF_GROUP[index] * (_INSIDE - share), *_STEERING_RANGE)
    instants, row = np.unique(ends[due], return_inverse=True)
    new = np.full((instants.size, lead_s.size), np.nan)
    new[row, lead] = score
    values = np.concatenate([scores.values[fresh], new])
    window = np.array([_quantile(values[:, group_of == index], _INSIDE) for index in range(_GROUPS)])
    return replace(
        last,
        issued=issued.select(np.asarray((ends[:, -1:] > now + 0.5).any(axis=1))),
        scores=Scores(np.concatenate([scores.time_s[fresh], instants]), values),
        steering=steering,
        window=window,
    )


def _quantile(values: Array, level: float) -> float:
    """Quantile of the known `values`, NaN of too few; `np.quantile` takes ten times as long, in every hour."""
    ordered = np.sort(values[np.isfinite(values)])
    if ordered.size < _LEAST_VALUES:
        return float("nan")
    place = level * (ordered.size - 1)
    below = int(place)
    return float(ordered[below] + (place - below) * (ordered[min(below + 1, ordered.size - 1)] - ordered[below]))


def _width(window: Array | float, steering: Array | float) -> Array:
    """Return the factor on the distance of each quantile from the median; 1 with too few values."""
    width = np.clip(window * np.exp(steering), *_SCALE_RANGE)
    return np.where(np.isnan(width), 1.0, width)
