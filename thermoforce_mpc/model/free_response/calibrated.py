"""Calibration of forecast intervals by the errors of issued forecasts, including errors of the weather forecast.

Each issued forecast is compared with the later free response, and the errors of the last 6 days set the width (split
conformal prediction over a rolling window, Angelopoulos and Bates 2023). Errors grow with the lead time, and what the
sun does is known least: an hour of rising sun errs several times as much as one of the night. So each group of lead
times and kind of sun has a width of its own (Mondrian conformal prediction, Vovk et al. 2005): one for all hours is too
wide in the night and holds half of what it promises by day. These errors are few and correlated, so the width is also
adapted: wider after a value outside, narrower after a value inside (adaptive conformal inference, Gibbs and Candès
2021, on the logarithm of the width as in Angelopoulos, Candès and Tibshirani 2023).

The error of a forecast is known hours later, when the window already includes much of it. To not widen twice for the
same errors, a value counts as outside only if it is so with the present window and the adaptation at the time of issue.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Record, steps_in
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
# Edges of the lead times that share a width, h: errors grow fast in the first hours, then by the day.
_LEAD_EDGES_H = (1.0, 2.0, 6.0, 12.0, 18.0, 24.0)
_LEADS = len(_LEAD_EDGES_H) + 1
# Kinds of sun that share a width, by the forecast since it was issued: none, none any more, more than an hour before,
# and else. Irradiance from which there is sun, W/m²: less moves no room.
_NONE, _GONE, _RISING, _FALLING = range(4)
_KINDS, _SUN_W_M2 = 4, 5.0
_GROUPS = _KINDS * _LEADS
# Least number of hourly values of lead times before a width is scaled, and hours in which a kind of sun is seen until
# its own width counts for half. By judgement: a day each; 12 h err by 1 % more on seventeen records of the heat pump
# and of drawn houses (2026-11-29).
_LEAST_VALUES, _SHARED_HOURS = 24, 24
# Adaptation gain: change of the log width per hour and unit of deviation from nominal coverage: 10 % wider if all
# values of a group are outside, 2 % narrower if none is. At long lead times the error is known later and the same gain
# would oscillate, so beyond 12 h it falls in proportion. Chosen on free runs of EnergyPlus and closed loops of the
# embedded plant, as was the separate group for the first hour.
_STEERING, _STEERING_LEAD_H, _FURTHEST_H = 0.12, 12.0, 48.0
_STEERING_OF_LEAD = tuple(_STEERING * min(1.0, _STEERING_LEAD_H / lead_h) for lead_h in (*_LEAD_EDGES_H, _FURTHEST_H))
# Logarithm of the width by steering, and factor of the width by the window: by judgement, a third to three times and a
# quarter to five times.
_STEERING_RANGE = (-1.1, 1.1)
_SCALE_RANGE = (0.25, 5.0)


@dataclass(frozen=True)
class IssuedForecasts:
    """I forecasts at K lead times, one for each hour.

    `time_s` (I,): when each was issued, s. `raw` (I, 3, K): median °C, half-widths above and below, K. `group` (I, K):
    number of the group of each value, see `_group_of`. `adapted` (I, G): adaptation of the log width then, NaN where no
    width was known.
    """

    time_s: Array
    raw: Array
    group: NDArray[np.int8]
    adapted: Array

    def select(self, which: NDArray[np.bool_]) -> IssuedForecasts:
        """Those of `which` (I,)."""
        return IssuedForecasts(self.time_s[which], self.raw[which], self.group[which], self.adapted[which])


@dataclass(frozen=True)
class Scores:
    """Distances (H, K) of past values at `time_s` (H,), s, from the medians that forecast them, in raw half-widths.

    `group` (H, K): number of the group of each.
    """

    time_s: Array
    values: Array
    group: NDArray[np.int8]


@dataclass(frozen=True)
class CalibratedState:
    """State of a run: forecasts issued and not yet fully compared, and the width of each of G groups.

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
        group_of = _group_of(boundary)
        # One lead time per hour: those between are nearly identical.
        stride = steps_in(_EVERY_S, boundary.step_s)
        hourly = slice(stride - 1, None, stride)
        compared = _scored(last, lead_s[hourly], free, history)
        scale = _width(compared.window[group_of], compared.steering[group_of])
        median, issued = raw.median_C, compared.issued
        if issued is None or not issued.time_s.size or now - issued.time_s[-1] >= _EVERY_S - 1.0:
            up, down = raw.quantiles_C[-1] - median, median - raw.quantiles_C[0]
            new = np.stack([median, np.maximum(up, 1e-6), np.maximum(down, 1e-6)])[None, :, hourly]
            # NaN marks forecasts issued without a known width, which were not adapted.
            adapted = np.where(np.isnan(compared.window), np.nan, compared.steering)[None]
            group = group_of[None, hourly]
            if issued is None:
                issued = IssuedForecasts(np.array([now]), new, group, adapted)
            else:
                issued = IssuedForecasts(
                    np.append(issued.time_s, now),
                    np.concatenate([issued.raw, new]),
                    np.concatenate([issued.group, group]),
                    np.concatenate([issued.adapted, adapted]),
                )
        note = f"{raw.note}; interval times {scale.min():.1f} to {scale.max():.1f}"
        forecast = FreeForecast(raw.levels, np.asarray(median + scale * (raw.quantiles_C - median)), note)
        kept = inner if isinstance(inner, MeanState) else None
        return forecast, replace(compared, issued=issued, latest_s=now, n_steps=n, inner=kept)


def _group_of(boundary: Boundary) -> NDArray[np.int8]:
    """Number of the group of each step of a forecast (N,): its lead time, and its kind of sun."""
    n, hour = boundary.n_steps, steps_in(HOUR_S, boundary.step_s)
    lead = np.searchsorted(_LEAD_EDGES_H, np.arange(1, n + 1) * boundary.step_s / HOUR_S - 1e-9)
    sun, before = boundary.solar_W_m2, boundary.solar_W_m2[np.maximum(np.arange(1, n + 1) - hour, 0)]
    shone = np.fmax.accumulate(sun)[1:] >= _SUN_W_M2
    by_day = np.where(sun[1:] > before, _RISING, _FALLING)
    kind = np.where(sun[1:] >= _SUN_W_M2, by_day, np.where(shone, _GONE, _NONE))
    return np.asarray(lead + _LEADS * kind, dtype=np.int8)  # states hold thousands


def _scored(last: CalibratedState, lead_s: Array, free: Array, history: Record) -> CalibratedState:
    """The state after comparing the values since the last call with what forecast them at `lead_s` (K,), s."""
    issued, now = last.issued, float(history.time_s[-1])
    if issued is None:
        return last
    nothing = np.empty((0, lead_s.size))
    scores = last.scores or Scores(np.empty(0), nothing, nothing.astype(np.int8))
    ends = issued.time_s[:, None] + lead_s
    due = (ends > last.latest_s + 0.5) & (ends <= now + 0.5)
    fresh = now - scores.time_s <= _WINDOW_S
    if not due.any() and fresh.all():
        return last
    which, lead = np.nonzero(due)
    median, up, down = issued.raw[which, :, lead].T
    gap = at_instants(ends[due], history.time_s, free, 0.5) - median
    score = np.abs(gap) / np.where(gap >= 0, up, down)
    group = issued.group[which, lead]
    at, adapted = last.window[group], issued.adapted[which, group]
    inside = score <= _width(at, adapted)
    scored = np.isfinite(score + adapted + at)
    steering = last.steering.copy()
    for index in np.unique(group[scored]):
        share = float(inside[scored & (group == index)].mean())
        gain = _STEERING_OF_LEAD[index % _LEADS]
        steering[index] = np.clip(steering[index] + gain * (_INSIDE - share), *_STEERING_RANGE)
    instants, row = np.unique(ends[due], return_inverse=True)
    new, of_new = np.full((instants.size, lead_s.size), np.nan), np.zeros((instants.size, lead_s.size), dtype=np.int8)
    new[row, lead], of_new[row, lead] = score, group
    values, groups = np.concatenate([scores.values[fresh], new]), np.concatenate([scores.group[fresh], of_new])
    return replace(
        last,
        issued=issued.select(np.asarray((ends[:, -1:] > now + 0.5).any(axis=1))),
        scores=Scores(np.concatenate([scores.time_s[fresh], instants]), values, groups),
        steering=steering,
        window=_windows(values, groups),
    )


def _windows(values: Array, groups: NDArray[np.int8]) -> Array:
    """Width of each group (G,) from distances `values` (H, K) in H hours, of the groups `groups` (H, K).

    The fewer hours a group was seen in, the nearer it is to what its lead times have in any sun: NaN where these were
    seen too little.
    """
    known = np.isfinite(values)
    hour = np.broadcast_to(np.arange(len(values))[:, None], values.shape)[known]
    values, groups = values[known], groups[known]
    widths = np.full((_KINDS, _LEADS), np.nan)
    for lead in range(_LEADS):
        of_lead = groups % _LEADS == lead
        if of_lead.sum() < _LEAST_VALUES:
            continue
        any_sun, _ = _log_width(values[of_lead], hour[of_lead])
        for kind in range(_KINDS):
            own = groups == lead + _LEADS * kind
            of_kind, hours = _log_width(values[own], hour[own]) if own.any() else (any_sun, 0)
            widths[kind, lead] = math.exp((hours * of_kind + _SHARED_HOURS * any_sun) / (hours + _SHARED_HOURS))
    return widths.ravel()


def _log_width(values: Array, hour: NDArray[np.intp]) -> tuple[float, int]:
    """Logarithm of the width that holds what a band promises of `values`, and in how many hours, in order, these are.

    The values of an hour, forecast at neighbouring lead times, are nearly one: hours count in the correction for few
    (Angelopoulos and Bates 2023). `np.quantile` takes ten times as long as sorting.
    """
    ordered, hours = np.sort(values), 1 + int(np.count_nonzero(hour[1:] != hour[:-1]))
    place = min(_INSIDE * (1.0 + 1.0 / hours), 1.0) * (ordered.size - 1)
    below = int(place)
    width = ordered[below] + (place - below) * (ordered[min(below + 1, ordered.size - 1)] - ordered[below])
    return math.log(max(float(width), _SCALE_RANGE[0])), hours


def _width(window: Array | float, steering: Array | float) -> Array:
    """Return the factor on the distance of each quantile from the median; 1 with too few values."""
    width = np.clip(window * np.exp(steering), *_SCALE_RANGE)
    return np.where(np.isnan(width), 1.0, width)
