"""Free-response bench, further parts: intervals over two weeks, resolutions, computing time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.free_response.score import Score, forecast_origins, mae_K, score, window
from benchmarks.free_response.sources import Source, embedded_sources
from thermoforce_mpc.boundary.forecast_error import ForecastError, Level
from thermoforce_mpc.comparison.outcome import Target
from thermoforce_mpc.data import CONDITIONS, DAY_S, HOUR_S
from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.protocols import FreeResponse

Row = dict[str, Any]

_LEVEL: Level = "medium"
_ERROR_SEED = 1
_LEADS_H = (6, 24)
# Hourly forecasts start after two weeks of history; the first two days, the settling time, are not scored.
_START_STEP, _SETTLING_STEPS, _LEAST_STEPS = 14 * 24, 48, 10 * 24
_OFF_BY, _OFF_BY_RISING = 0.03, 0.1
# Irradiance from which there is sun, W/m².
_SUN_W_M2 = 5.0
_BUILDINGS, _REPEATS = 32, 15
_FINE_STEP_S, _LONG_H = 900.0, 48.0


def interval_runs(sources: Sequence[Source], progress: Callable[[str], None]) -> tuple[list[Row], list[Target]]:
    """Coverage of calibrated 80 % intervals of `residual` in runs of two weeks with BOPTEST's medium forecast errors.

    One row per sufficiently long hourly source: coverage over all lead times, 6 h and 24 h ahead, and over the first
    6 h where the sun rises: plans act on these hours, and the sun disturbs them most.
    """
    rows: list[Row] = []
    targets: list[Target] = []
    for source in sources:
        origins = range(_START_STEP, source.free_C.size - source.horizon)
        if source.history.step_s != HOUR_S or len(origins) < _LEAST_STEPS:
            continue
        method = build_free_response("residual")
        inside = score(method, source, origins, ForecastError(_LEVEL, _LEVEL, _ERROR_SEED)).inside[_SETTLING_STEPS:]
        share = float(inside.mean())
        ends = np.array(origins)[_SETTLING_STEPS:, None] + np.arange(1, source.horizon + 1)
        sun = source.history.solar_W_m2
        rising = (sun[ends] >= _SUN_W_M2) & (sun[ends] > sun[ends - 1])
        soon = slice(None), slice(0, _LEADS_H[0])
        held_rising = float(inside[soon][rising[soon]].mean()) if rising[soon].any() else float("nan")
        ahead = {f"held_{hours}h_ahead": float(inside[:, hours - 1].mean()) for hours in _LEADS_H}
        rows.append(
            {"source": source.name, "two weeks": f"{_LEVEL} forecast errors", "forecasts": len(inside), "held": share}
            | ahead
            | {"held_6h_in_rising_sun": held_rising}
        )
        targets.append(Target(f"{source.name}, two weeks: 80 % interval off by", abs(share - 0.8), _OFF_BY))
        if rising[soon].any():
            what = f"{source.name}, two weeks, first 6 h in rising sun: 80 % interval off by"
            targets.append(Target(what, abs(held_rising - 0.8), _OFF_BY_RISING))
        progress(f"{source.name}: two weeks of hourly forecasts")
    for hours in _LEADS_H if rows else ():
        off_by = abs(float(np.mean([row[f"held_{hours}h_ahead"] for row in rows])) - 0.8)
        targets.append(Target(f"mean of {len(rows)} runs, {hours} h ahead: 80 % interval off by", off_by, _OFF_BY))
    return rows, targets


def look_rows(backbone: str, at_most: int) -> list[Row]:
    """Error and coverage over 48 h at 15 min on the embedded plant, for one resolution and for several."""
    sources = embedded_sources(_FINE_STEP_S, _LONG_H)
    day = round(DAY_S / _FINE_STEP_S)
    rows: list[Row] = []
    for resolutions in ("one", "several"):
        method = build_free_response("chronos", backbone=backbone, resolutions=resolutions)
        found = [score(method, source, forecast_origins(source, at_most)) for source in sources]
        row: Row = {"48 h at 15 min, embedded": f"{resolutions} resolution{'s' if resolutions == 'several' else ''}"}
        for label, part in (("first day", slice(0, day)), ("second day", slice(day, None))):
            row[f"error in K, {label}"] = float(np.mean([one.errors_K[:, part].mean() for one in found]))
            row[f"inside 80 %, {label}"] = float(np.mean([one.inside[:, part].mean() for one in found]))
        rows.append(row)
    return rows


def gap_rows(sources: Sequence[Source], methods: Mapping[str, FreeResponse], at_most: int) -> list[Row]:
    """Error over 6 h and 24 h, and coverage, where values were lost: a tenth here and there, and runs of four.

    Means over the sources, beside those without gaps. The last value is always known.
    """
    rows: list[Row] = []
    for name, method in methods.items():
        found: dict[str, list[Score]] = {}
        for source in sources:
            origins = forecast_origins(source, at_most)
            for lost, where in _lost(source.free_C.size).items():
                seen = np.where(where & ~np.isin(np.arange(where.size), origins), np.nan, source.free_C)
                found.setdefault(lost, []).append(score(method, source, origins, seen_C=seen))
        rows += [
            {
                "method": name,
                "values lost": lost,
                **{f"mae_{hours}h_K": float(np.mean([mae_K(one, hours) for one in scores])) for hours in _LEADS_H},
                "coverage_80": float(np.mean([one.inside.mean() for one in scores])),
            }
            for lost, scores in found.items()
        ]
    return rows


def _lost(n: int) -> dict[str, NDArray[np.bool_]]:
    """Which of `n` values are lost, by name."""
    rng = np.random.default_rng(_ERROR_SEED)
    runs = np.zeros(n, dtype=bool)
    for first in np.cumsum(rng.integers(16, 52, size=n // 16)):
        runs[first : first + 4] = True
    return {"none": np.zeros(n, dtype=bool), "a tenth": rng.random(n) < 0.1, "runs of four": runs}


def cost_rows(source: Source, backbone: str) -> list[Row]:
    """Median time of one forecast of 24 h and of 48 h on one thread, and of a batch of many buildings.

    Processor time is given as well, since it is independent of other load on the machine.
    """
    method = ChronosFreeResponse(backbone)
    free, history, boundary, _ = window(source, forecast_origins(source, 1)[0])
    n = source.horizon
    twice: dict[str, Any] = {
        name: np.concatenate([getattr(boundary, name), getattr(boundary, name)[..., 1:]], axis=-1)
        for name in CONDITIONS
        if name != "time_s"
    }
    long = replace(
        boundary,
        **twice,
        time_s=boundary.time_s[0] + boundary.step_s * np.arange(2 * n + 1),
        names=boundary.names,
    )
    one, two = (free, history, boundary), (free, history, long)
    rows = []
    for label, tasks in (
        ("24 h", [one]),
        ("48 h", [two]),
        (f"24 h of {_BUILDINGS} buildings at once", [one] * _BUILDINGS),
    ):
        method.forecast_many(tasks)
        wall, processor = [], []
        for _ in range(_REPEATS):
            began, worked = time.perf_counter(), time.thread_time()
            method.forecast_many(tasks)
            wall.append((time.perf_counter() - began) * 1e3)
            processor.append((time.thread_time() - worked) * 1e3)
        middle = float(np.median(processor))
        rows.append(
            {
                "forecast": label,
                "ms": float(np.median(wall)),
                "processor_ms": middle,
                "processor_ms_per_building": middle / len(tasks),
            }
        )
    return rows
