"""How much of what could be known each method knows: its share of the oracle's gain over `linear_weather`.

The oracle's error in a free run is zero, so the share is 1 − MAE / MAE of `linear_weather`: 1 is all there is to gain,
below 0 a loss. Scored from the same origins for every length of history, so that only what is known differs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.free_response.score import forecast_origins, mae_K, score
from benchmarks.free_response.sources import Source
from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.protocols import FreeResponse

HISTORIES_D = (1, 3, 14)
REFERENCE, LIMIT = "linear_weather", "oracle"
_ERRORS = {"perfect": None, "medium errors": ForecastError("medium", "medium", 1)}
_LEADS_H = (6, 24)


def share_rows(
    sources: Sequence[Source],
    methods: Mapping[str, FreeResponse],
    at_most: int,
    progress: Callable[[str], None] = lambda _line: None,
) -> list[dict[str, Any]]:
    """Error and share of each method, one row per group of sources, days of history and weather; the oracle among them.

    Args:
        sources: control-free records; those too short for the longest history are left out.
        methods: by name, `REFERENCE` among them; one that a history is too short for is left out there.
        at_most: origins of a record.
        progress: callback for progress lines.
    """
    rows: list[dict[str, Any]] = []
    for group in dict.fromkeys(source.group for source in sources):
        longest = [_with_history(source, max(HISTORIES_D)) for source in sources if source.group == group]
        origins = {source.name: forecast_origins(source, at_most) for source in longest}
        scored = [source for source in longest if origins[source.name]]
        for weather, error in _ERRORS.items() if scored else ():
            if error is not None and any(source.history.step_s != HOUR_S for source in scored):
                continue  # forecast errors are defined by the hour
            for days in HISTORIES_D:
                found = _errors_K([(_seen(s, days), origins[s.name]) for s in scored], methods, error)
                case = {"sources": group, "history": f"{days} d", "weather": weather}
                rows += [case | row for row in _rows(found)]
            progress(f"{group}, {weather}: share of the oracle's gain from {sum(map(len, origins.values()))} origins")
    return rows


def _with_history(source: Source, days: int) -> Source:
    return replace(_seen(source, days), least_context_steps=_steps(source, days))


def _seen(source: Source, days: int) -> Source:
    return replace(source, context_steps=_steps(source, days))


def _steps(source: Source, days: int) -> int:
    return round(days * DAY_S / source.history.step_s)


def _errors_K(
    sources: Sequence[tuple[Source, Sequence[int]]], methods: Mapping[str, FreeResponse], error: ForecastError | None
) -> dict[str, list[float]]:
    """Mean absolute error of each method at the leads, mean over sources, K; without those that lack history."""
    found: dict[str, list[float]] = {LIMIT: [0.0] * len(_LEADS_H)}
    for name, method in methods.items():
        try:
            scores = [score(method, source, origins, error) for source, origins in sources]
        except DataError:
            continue
        found[name] = [float(np.mean([mae_K(one, hours) for one in scores])) for hours in _LEADS_H]
    return found


def _rows(found: Mapping[str, Sequence[float]]) -> list[dict[str, Any]]:
    rows = []
    for name, errors_K in found.items():
        row: dict[str, Any] = {"free response": name}
        for hours, mae, reference in zip(_LEADS_H, errors_K, found[REFERENCE], strict=True):
            row |= {f"mae_{hours}h_K": mae, f"share_{hours}h": 1.0 - mae / reference}
        rows.append(row)
    return rows
