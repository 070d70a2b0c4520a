"""TSFM + covariates: ridge regression of the forecast residual on control and weather, optionally with an AR term.

Four feature sets: covariates as they are or as differences from the day before (since a forecaster continues the daily
course); instantaneous only (the usual method) or also through first-order lags (since a building responds over hours).
Feature set and ridge weight are chosen on validation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.interventions.dataset import Window
from benchmarks.interventions.methods.base import Training, best
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Record
from thermoforce_mpc.protocols import FreeResponse

_LAGS_H = (0.5, 2.0, 8.0)
# Feature sets by name: (differences from the day before, lags).
KINDS: dict[str, tuple[bool, tuple[float, ...]]] = {
    "instant covariates": (False, ()),
    "lagged covariates": (False, _LAGS_H),
    "instant changes since the day before": (True, ()),
    "lagged changes since the day before": (True, _LAGS_H),
}
_AR_LAGS_H = (0.5, 2.0, 8.0)
RIDGES = (1e-4, 1e-2, 1.0, 1e2, 1e4)
# Stride between the origins of the training forecasts, steps of 15 min.
_STRIDE = 3
_SUN_UNIT_W_M2 = 300.0
_OUTDOOR_UNIT_K = 10.0


@dataclass(frozen=True)
class _Case:
    """One training forecast: history, weather of the horizon, actions, measured and forecast temperature (N,)."""

    history: Record
    boundary: Boundary
    u: Array
    measured_C: Array
    forecast_C: Array


class CovariateForecast:
    """`Predictor`: forecast of T plus a linear correction by the features."""

    def __init__(self, free_response: FreeResponse, kind: str, autoregressive: bool, weights: Array, note: str) -> None:
        self._free_response, self._kind, self._ar = free_response, kind, autoregressive
        self._weights, self.note = weights, note

    def respond(self, window: Window, u: Array) -> Array:
        """See `Predictor.respond`."""
        history, boundary = window.history, window.boundary
        median = self._free_response.forecast(history.T_zone_C[0], history, boundary).median_C
        return np.stack(
            [median + covariate_features(history, boundary, row, self._kind, self._ar) @ self._weights for row in u]
        )


def build_covariates(training: Training, free_response: FreeResponse, *, autoregressive: bool) -> CovariateForecast:
    """Fit on both runs of the probe; choose feature set and ridge weight by the effect on the validation windows."""
    horizon = training.validation[0].factual.n_steps
    cases = [c for run in training.runs() for c in _cases(run, training.probe.history.n_steps, horizon, free_response)]
    target = np.concatenate([c.measured_C - c.forecast_C for c in cases])
    candidates = {}
    for kind in KINDS:
        design = np.concatenate([covariate_features(c.history, c.boundary, c.u, kind, autoregressive) for c in cases])
        scale = np.maximum(design.std(axis=0), 1e-9)
        gram = (design / scale).T @ (design / scale)
        right = (design / scale).T @ target
        for ridge in RIDGES:
            weights = np.linalg.solve(gram + ridge * np.eye(gram.shape[0]), right) / scale
            name = f"{kind}, ridge {ridge:g}"
            candidates[name] = CovariateForecast(free_response, kind, autoregressive, weights, name)
    return candidates[best(candidates, training.validation)]


def _cases(run: Record, first: int, horizon: int, free_response: FreeResponse) -> Sequence[_Case]:
    """Forecasts from origins on the probe days, each from the data available at its origin."""
    cases = []
    for origin in range(first, run.n_steps - horizon + 1, _STRIDE):
        history, ahead = run.slice(0, origin), run.slice(origin, origin + horizon)
        boundary = Boundary.measured(ahead)
        forecast = free_response.forecast(history.T_zone_C[0], history, boundary).median_C
        cases.append(_Case(history, boundary, ahead.u[0], ahead.T_zone_C[0, 1:], forecast))
    return cases


def covariate_features(history: Record, boundary: Boundary, u: Array, kind: str, autoregressive: bool) -> Array:
    """Features of the N steps, shape (N, p): covariates, instantaneous and lagged; decaying AR terms; constant 1."""
    differs, lags_h = KINDS[kind]
    n, step_s = u.size, boundary.step_s
    per_day = round(DAY_S / step_s)
    # Difference of step k of the horizon to the same step a day earlier.
    day_before = slice(history.n_steps - per_day, history.n_steps - per_day + n)
    sampled_before = slice(history.n_steps - per_day + 1, history.n_steps - per_day + n + 1)
    ahead = [u, boundary.T_out_C[1:] / _OUTDOOR_UNIT_K, boundary.solar_W_m2[1:] / _SUN_UNIT_W_M2]
    before = [
        history.u[0, day_before],
        history.T_out_C[sampled_before] / _OUTDOOR_UNIT_K,
        history.solar_W_m2[sampled_before] / _SUN_UNIT_W_M2,
    ]
    covariates = np.stack(ahead, axis=1) - (np.stack(before, axis=1) if differs else 0.0)
    columns = [covariates]
    for tau in lags_h:
        pole = np.exp(-step_s / HOUR_S / tau)
        columns.append(lfilter([1.0 - pole], [1.0, -pole], covariates, axis=0))
    if autoregressive:
        hours = np.arange(1, n + 1) * step_s / HOUR_S
        T = history.T_zone_C[0]
        for deviation in (T[-1] - T[-1 - per_day], T[-1] - T[-5]):
            columns.append(np.stack([deviation * np.exp(-hours / tau) for tau in _AR_LAGS_H], axis=1))
    return np.concatenate([*columns, np.ones((n, 1))], axis=1)
