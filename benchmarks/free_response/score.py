"""Scoring of one method on one source: forecast origins, data available at each, errors and coverage."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.free_response.sources import Source
from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.data import Array, Boundary, Record
from thermoforce_mpc.model.free_response.following import follow
from thermoforce_mpc.protocols import FreeResponse

_LEAST_KNOWN_SHARE = 0.9
_LOW, _HIGH = 0, -1  # rows of the 0.1 and 0.9 quantiles


@dataclass(frozen=True)
class Score:
    """Scores of one method on one source.

    Absolute errors (origins, N), K; whether inside the 80 % interval (origins, N); mean pinball loss, K; median time
    of a forecast, ms.
    """

    errors_K: Array
    inside: Array
    pinball_K: float
    milliseconds: float


def forecast_origins(source: Source, at_most: int) -> list[int]:
    """Forecast origins, evenly spread over the record, with almost gapless context and a gapless day ahead."""
    free, n = source.free_C, source.horizon
    known = np.isfinite(free)
    weather = np.isfinite(source.history.T_out_C) & np.isfinite(source.history.solar_W_m2)
    possible = [
        t
        for t in range(source.least_context_steps, free.size - n)
        if known[t - 2 * n - 1 : t + n + 1].all()
        and known[max(0, t - source.context_steps) : t].mean() >= _LEAST_KNOWN_SHARE
        and weather[max(0, t - source.context_steps) : t + n + 1].all()
    ]
    if len(possible) <= at_most:
        return possible
    return [possible[i] for i in np.linspace(0, len(possible) - 1, at_most).round().astype(int)]


def window(source: Source, origin: int, error: ForecastError | None = None) -> tuple[Array, Record, Boundary, Array]:
    """Control-free history up to `origin`, record with its weather, weather ahead, and following temperatures (N,), °C.

    With `error` (hourly sources only) the weather ahead is a forecast with such errors.
    """
    n, first = source.horizon, max(0, origin - source.context_steps)
    whole = source.history
    past = slice(first, origin + 1)
    acting = np.full(origin - first, np.nan)
    history = Record(
        whole.time_s[past], source.free_C[past], whole.T_out_C[past], whole.solar_W_m2[past], acting, acting, acting
    )
    boundary = Boundary.measured(whole.slice(origin, origin + n))
    if error is not None:
        T_out, solar = error.apply(
            boundary.time_s,
            lambda at_s: np.interp(at_s, whole.time_s, whole.T_out_C),
            lambda at_s: np.interp(at_s, whole.time_s, whole.solar_W_m2),
        )
        boundary = replace(boundary, T_out_C=T_out, solar_W_m2=solar)
    return source.free_C[past], history, boundary, source.free_C[origin + 1 : origin + n + 1]


def score(
    method: FreeResponse,
    source: Source,
    origins: Sequence[int],
    error: ForecastError | None = None,
    seen_C: Array | None = None,
) -> Score:
    """Forecast from every origin and compare with the measured values; `seen_C`: what the method sees of `free_C`."""
    seen = source if seen_C is None else replace(source, free_C=seen_C)
    errors, inside, pinball, seconds = [], [], [], []
    state: object = None
    for origin in origins:
        _, _, boundary, truth = window(source, origin, error)
        free, history, _, _ = window(seen, origin)
        began = time.perf_counter()
        forecast, state = follow(method, free, history, boundary, state)
        seconds.append(time.perf_counter() - began)
        errors.append(np.abs(truth - forecast.median_C))
        inside.append((truth >= forecast.quantiles_C[_LOW]) & (truth <= forecast.quantiles_C[_HIGH]))
        gap = truth - forecast.quantiles_C
        level = np.asarray(forecast.levels)[:, None]
        pinball.append(np.maximum(level * gap, (level - 1.0) * gap).mean())
    return Score(np.array(errors), np.array(inside), float(np.mean(pinball)), float(np.median(seconds)) * 1e3)


def mae_K(found: Score, hours: float) -> float:
    """Mean absolute error over the first `hours` of a forecast of 24 h."""
    steps = round(found.errors_K.shape[1] * hours / 24)
    return float(found.errors_K[:, :steps].mean())
