"""What ThermoForce is compared with: persistence, the raw forecaster, grey boxes, the forecaster with covariates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.factual.homes import Prepared
from benchmarks.interventions.methods.covariates import KINDS, RIDGES, covariate_features
from benchmarks.interventions.methods.grey_box import (
    fit_one_step,
    fit_rollouts,
    rollout,
    weather_columns,
)
from thermoforce_mpc.data import Array, Boundary, Record
from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse

_LAGS = (1, 1)
# Stride between the origins of the covariates' training forecasts, steps, and the least number of them.
_STRIDE, _LEAST_CASES = 3, 4


@dataclass(frozen=True)
class GreyBoxFit:
    """Weights a, g, c, d, e of paper eq:arx."""

    weights: Array
    meter: str
    note: str


def context_of(home: Prepared, series: Array, origin: int, most: int) -> tuple[Array, Record]:
    """The last `most` values of `series` (n + 1,) up to `origin`, and their record."""
    first = max(0, origin - most + 1)
    return series[first : origin + 1], home.record.slice(first, origin)


def forecasts(
    home: Prepared, backbone: ChronosFreeResponse, series: Array, origins: Sequence[int], horizon: int, most: int
) -> Array:
    """Median forecasts of `series` from `origins` by the frozen model, (origins, horizon), °C."""
    tasks = [
        (*context_of(home, series, o, most), Boundary.measured(home.record.slice(o, o + horizon))) for o in origins
    ]  # fmt: skip
    return np.array([answer.median_C for answer in backbone.forecast_many(tasks)])


def persistence(home: Prepared, origins: Sequence[int], horizon: int) -> Array:
    """The last measured temperature, (origins, horizon), °C."""
    return np.repeat(home.truth_C[list(origins)][:, None], horizon, axis=1)


def grey_boxes(home: Prepared, days: int, horizon: int) -> list[GreyBoxFit]:
    """Fits of paper eq:arx to the last `days` days of the fit part: one-step errors, and rollouts over `horizon`."""
    start, stop = home.budget(days)
    fits = []
    for meter in home.levels:
        pieces = _pieces(home.with_level(meter).slice(start, stop), horizon)
        if not pieces:
            continue
        one_step = fit_one_step(pieces, _LAGS)
        fits.append(GreyBoxFit(one_step, meter, f"{meter}, one-step errors"))
        fits.append(GreyBoxFit(fit_rollouts(pieces, _LAGS, one_step, horizon), meter, f"{meter}, rollout errors"))
    return fits


def simulate(home: Prepared, fit: GreyBoxFit, origins: Sequence[int], horizon: int, *, persisted: bool) -> Array:
    """Rollouts of a grey box with the measured weather, or with that of the origin `persisted`; (origins, N), °C."""
    at = np.array(origins)[:, None] + np.arange(horizon)
    columns = weather_columns(home.record.T_out_C, home.record.solar_W_m2)
    held = np.maximum(np.array(origins) - 1, 0)[:, None].repeat(horizon, axis=1)
    u = home.levels[fit.meter][at]
    T0 = home.truth_C[list(origins)][:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        return rollout(fit.weights, _LAGS, T0, u, columns[held if persisted else at])


@dataclass(frozen=True)
class CovariateFit:
    """Ridge weights of the correction of a forecast by covariates."""

    meter: str
    kind: str
    autoregressive: bool
    weights: Array
    note: str


def covariate_fit(
    home: Prepared, backbone: ChronosFreeResponse, days: int, most: int, raw: Array, *, autoregressive: bool
) -> CovariateFit | None:
    """The forecaster with covariates, fitted within the budget; None where it is too short to fit.

    Feature set and ridge weight are those with the lowest error on the validation part, whose raw forecasts are `raw`
    (origins, N).
    """
    horizon = raw.shape[1]
    start, stop = home.budget(days)
    origins = [
        o
        for o in range(max(start, home.steps_per_day), stop - horizon + 1, _STRIDE)
        if home.usable[o : o + horizon].all() and np.isfinite(home.truth_C[o : o + horizon + 1]).all()
    ]
    if len(origins) < _LEAST_CASES:
        return None
    forecast = forecasts(home, backbone, home.record.T_zone_C[0], origins, horizon, most)
    target = (truth_of(home, origins, horizon) - forecast).ravel()
    checked = home.origins(home.validation, horizon)
    measured = truth_of(home, checked, horizon)
    best, least = None, np.inf
    for meter in home.levels:
        for kind in KINDS:
            design = np.concatenate(_designs(home, meter, origins, horizon, kind, autoregressive))
            held_out = _designs(home, meter, checked, horizon, kind, autoregressive)
            scale = np.maximum(design.std(axis=0), 1e-9)
            gram, right = (design / scale).T @ (design / scale), (design / scale).T @ target
            for ridge in RIDGES:
                weights = np.linalg.solve(gram + ridge * np.eye(gram.shape[0]), right) / scale
                error = rmse_K(raw + held_out @ weights - measured)
                if error < least:
                    note = f"{meter}, {kind}, ridge {ridge:g}"
                    best, least = CovariateFit(meter, kind, autoregressive, weights, note), error
    return best


def truth_of(home: Prepared, origins: Sequence[int], horizon: int) -> Array:
    """Measured temperatures after each origin, (origins, N), °C, NaN where there was none."""
    return np.array([home.truth_C[o + 1 : o + horizon + 1] for o in origins])


def rmse_K(errors: Array) -> float:
    """Root mean square over all that is known, K; infinite for a forecast that diverged."""
    with np.errstate(over="ignore", invalid="ignore"):
        value = float(np.sqrt(np.nanmean(np.square(errors))))
    return value if np.isfinite(value) else float("inf")


def corrected(home: Prepared, fit: CovariateFit, raw: Array, origins: Sequence[int]) -> Array:
    """The raw forecasts (origins, N) with the correction, °C; the weather ahead is the measured one (oracle)."""
    return np.asarray(
        raw + _designs(home, fit.meter, origins, raw.shape[1], fit.kind, fit.autoregressive) @ fit.weights
    )


def _designs(
    home: Prepared, meter: str, origins: Sequence[int], horizon: int, kind: str, autoregressive: bool
) -> Array:
    """Features (origins, N, p)."""
    return np.array([_features(home, meter, o, horizon, kind, autoregressive) for o in origins])


def _features(home: Prepared, meter: str, origin: int, horizon: int, kind: str, autoregressive: bool) -> Array:
    record = home.with_level(meter)
    history = record.slice(max(0, origin - 2 * home.steps_per_day), origin)
    boundary: Boundary = Boundary.measured(record.slice(origin, origin + horizon))
    u = record.u[0, origin : origin + horizon]
    # A value that was not measured has no influence.
    return np.nan_to_num(covariate_features(history, boundary, u, kind, autoregressive))


def _pieces(run: Record, horizon: int) -> list[Record]:
    """The stretches of `run` without a gap in the temperature that are longer than the horizon."""
    known = np.isfinite(run.T_zone_C[0])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    return [run.slice(a, b - 1) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - 1 - a > horizon]
