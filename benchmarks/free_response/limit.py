"""Limit of linear weather corrections: share of the frozen forecaster's error that they could remove.

If `residual` is hardly better than the backbone alone, either its use of the weather is poor or the weather explains
little. To distinguish the two, the errors of the backbone are regressed, for each record and lead time, on the weather
of the forecast hours relative to the recent past, and on the corrections by the candidates of `residual`. The in-sample
fit is a bound: no fixed linear correction of this kind from past data is better (strictly for the squared error, nearly
so for the absolute error). The fit cross-validated by blocks of time estimates what months of data could achieve.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.free_response.score import forecast_origins, window
from benchmarks.free_response.sources import Source
from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.model.free_response.checks import LEVELS
from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse
from thermoforce_mpc.model.free_response.residual import ResidualFreeResponse

_LEADS_H = (6, 24)
_ORIGINS, _LEAST_ORIGINS = 150, 100
_BATCH = 32
# Weather is compared with the same hours of the given numbers of days before.
_DAYS_BEFORE = 3
_LATEST_H, _SEEN_H = 3, 6
_BLOCKS = 5
# Ridge weights per origin for features of unit variance; the in-sample one only keeps the equations regular.
_RIDGE, _RIDGE_IN_SAMPLE = 0.1, 1e-6


def limit_rows(
    sources: Sequence[Source], backbone: str, progress: Callable[[str], None], *, most_origins: int = _ORIGINS
) -> list[dict[str, Any]]:
    """Share of the backbone's mean absolute error that is removed, one row per group for 6 h and 24 h ahead.

    Columns: regression on the weather ahead, regression on the candidates of `residual` as well (each in sample and
    cross-validated), and `residual` itself from the same origins, at most `most_origins` a record. Records with fewer
    than 100 origins are left out and reported to `progress`.

    Raises:
        DataError, BackboneError: see `ResidualFreeResponse` and `load_backbone`.
    """
    chronos = ChronosFreeResponse(backbone)
    found: dict[tuple[str, int], list[Array]] = {}
    counted: dict[str, int] = {}
    for source in sources:
        origins = np.array(forecast_origins(source, most_origins))
        if origins.size < _LEAST_ORIGINS:
            progress(f"{source.name}: left out of the limit of weather: only {origins.size} origins")
            continue
        counted[source.group] = counted.get(source.group, 0) + origins.size
        # Only `residual` itself needs the trials; its candidates have no state.
        candidates, mixed, truth = _forecasts(source, origins, ResidualFreeResponse(chronos))
        errors = truth - candidates[:, 0]
        for hours in _LEADS_H:
            n = round(hours * HOUR_S / source.history.step_s)
            weather = weather_features(source, origins, n)
            both = np.concatenate([weather, candidates[:, 1:, :n] - candidates[:, :1, :n]], axis=1)
            left = [errors[:, :n], (truth - mixed)[:, :n]]
            for features in (weather, both):
                left += [in_sample(errors[:, :n], features), cross_validated(errors[:, :n], features, origins, n)]
            found.setdefault((source.group, hours), []).append(np.array([np.abs(e).mean() for e in left]))
        progress(f"{source.name}: limit of weather from {origins.size} origins")
    rows = []
    for (group, hours), sizes in found.items():
        alone, residual, *regressions = np.mean(sizes, axis=0)
        weather_in, weather_out, both_in, both_out = (1.0 - float(size / alone) for size in regressions)
        rows.append(
            {
                "group": group,
                "share of the backbone's error removed": f"first {hours} h",
                "by weather ahead, in sample": weather_in,
                "cross-validated": weather_out,
                "by candidates too, in sample": both_in,
                "cross-validated too": both_out,
                "by residual": 1.0 - float(residual / alone),
                "instants": counted[group],
            }
        )
    return rows


def weather_features(source: Source, origins: Array, n: int) -> Array:
    """Changes of the weather in the `n` steps after each origin relative to earlier days, shape (origins, 10, n).

    For outdoor temperature and for sunlight: differences of the mean up to each lead time, and of the mean over the
    3 h before it, to the same hours of the day before and to the mean of three days before; and the difference of
    the last 6 h before the origin to the day before, to which the series has hardly responded yet.
    """
    step_s = source.history.step_s
    day, latest, seen = (round(span / step_s) for span in (DAY_S, _LATEST_H * HOUR_S, _SEEN_H * HOUR_S))
    lead = np.arange(1, n + 1)
    ahead, past = origins[:, None] + lead, origins[:, None] - np.arange(seen)
    features = []
    for drive in (source.history.T_out_C, source.history.solar_W_m2):
        before = [drive[ahead - k * day] for k in range(1, _DAYS_BEFORE + 1)]
        for usual in (before[0], np.mean(before, axis=0)):
            total = np.cumsum(drive[ahead] - usual, axis=1)
            earlier = np.pad(total, ((0, 0), (latest, 0)))[:, :n]
            features += [total / lead, (total - earlier) / np.minimum(lead, latest)]
        change = (drive[past] - drive[past - day]).mean(axis=1)
        features.append(np.repeat(change[:, None], n, axis=1))
    return np.stack(features, axis=1)


def in_sample(errors: Array, features: Array) -> Array:
    """Residuals (T, N) of regressions of `errors` (T, N) on `features` (T, p, N), one per lead time."""
    return _left(errors, features, np.ones(len(errors), bool), np.ones(len(errors), bool), _RIDGE_IN_SAMPLE)


def cross_validated(errors: Array, features: Array, origins: Array, n: int) -> Array:
    """As `in_sample`, but cross-validated: each fifth of the time and everything overlapping it is held out in turn."""
    left = np.empty_like(errors)
    block = np.arange(origins.size) * _BLOCKS // origins.size
    for number in range(_BLOCKS):
        tested = block == number
        apart = np.abs(origins[:, None] - origins[tested][None]).min(axis=1) >= n
        left[tested] = _left(errors, features, apart, tested, _RIDGE)
    return left


def _left(errors: Array, features: Array, fitted: Array, tested: Array, ridge: float) -> Array:
    """Errors at the origins `tested` (T,) minus their prediction by regressions on the origins `fitted` (T,)."""
    middle, spread = features[fitted].mean(axis=0), np.maximum(features[fitted].std(axis=0), 1e-9)
    scaled = np.moveaxis((features - middle) / spread, 2, 0)
    scaled = np.concatenate([scaled, np.ones((*scaled.shape[:2], 1))], axis=2)
    known, target = scaled[:, fitted], errors[fitted].T[:, :, None]
    turned = known.transpose(0, 2, 1)
    weights = np.linalg.solve(
        turned @ known + ridge * np.count_nonzero(fitted) * np.eye(scaled.shape[2]), turned @ target
    )
    return np.asarray(errors[tested] - (scaled[:, tested] @ weights)[:, :, 0].T)


def _forecasts(source: Source, origins: Array, method: ResidualFreeResponse) -> tuple[Array, Array, Array]:
    """Medians of the candidates (T, 3, N) and of `method` (T, N), and measured values (T, N), °C."""
    tasks = [window(source, int(origin)) for origin in origins]
    medians = []
    for first in range(0, len(tasks), _BATCH):
        found, _ = method.candidates(
            [(free, history, ahead) for free, history, ahead, _ in tasks[first : first + _BATCH]]
        )
        medians += [quantiles[:, LEVELS.size // 2] for quantiles in found]
    mixed, state = [], None
    for free, history, ahead, _ in tasks:
        forecast, state = method.follow(free, history, ahead, state)
        mixed.append(forecast.median_C)
    return np.array(medians), np.array(mixed), np.array([truth for *_, truth in tasks])
