"""Prediction errors of plans and free forecasts against later measurements."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Plan
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord


def forecast_errors(result: RunResult, horizons_h: tuple[float, ...] = (1.0, 6.0, 12.0, 24.0)) -> list[dict[str, Any]]:
    """Error of the planned zone temperature at several lead times.

    The error at the first step is a pure prediction error. Beyond it, the error also includes the difference between
    the scored plan and the later plans that were applied.

    Returns:
        One row per zone and lead time with `zone`, `hours`, `bias_K` (planned − measured), `rmse_K`, and the number `n`
        of plans scored.
    """
    measured = {round(step.time_s): step.T_zone_C for step in result.steps}

    def figures(plans: list[tuple[Plan, int, Array]], z: int) -> dict[str, Any]:
        error = np.array([plan.T_zone_C[z, k] - later[z] for plan, k, later in plans])
        finite = error[np.isfinite(error)]  # NaN where the zone's sensor was silent
        if not finite.size:
            return {}
        return {"bias_K": float(np.mean(finite)), "rmse_K": float(np.sqrt(np.mean(finite**2))), "n": finite.size}

    return _scored(result, result.steps, measured, horizons_h, figures)


def free_forecast_scores(
    result: RunResult, horizons_h: tuple[float, ...] = (1.0, 6.0, 24.0), settle_h: float = 48.0
) -> list[dict[str, Any]]:
    """Error of the free forecasts and coverage of their 80 % intervals.

    The reference is the free temperature `T_free_now_C` of the plan made at the forecast's target time, so later
    actions do not affect the score. Plans of the first `settle_h` hours are left out, while corrections adapt.

    Returns:
        One row per zone and lead time with `zone`, `hours`, `mae_K`, `coverage` (share) and the number `n` of forecasts
        scored.
    """
    came = {round(step.time_s): step.plan.T_free_now_C for step in result.steps if step.plan.u.size}
    start_s = result.steps[0].time_s if result.steps else 0.0
    settled = [step for step in result.steps if step.time_s - start_s >= settle_h * HOUR_S]

    def figures(plans: list[tuple[Plan, int, Array]], z: int) -> dict[str, Any]:
        error = np.array([plan.T_free_C[z, k] - later[z] for plan, k, later in plans])
        inside = np.array([plan.T_free_low_C[z, k] <= later[z] <= plan.T_free_high_C[z, k] for plan, k, later in plans])
        finite = np.isfinite(error)  # NaN where the zone's sensor was silent
        if not finite.any():
            return {}
        mae_K = float(np.mean(np.abs(error[finite])))
        return {"mae_K": mae_K, "coverage": float(np.mean(inside[finite])), "n": int(finite.sum())}

    return _scored(result, settled, came, horizons_h, figures)


def _scored(
    result: RunResult,
    steps: Iterable[StepRecord],
    came: Mapping[int, Array],
    horizons_h: tuple[float, ...],
    figures: Callable[[list[tuple[Plan, int, Array]], int], dict[str, Any]],
) -> list[dict[str, Any]]:
    """Rows zone by zone, then by lead time, of the `figures` of a zone: from plans with the number of the step that
    ends so much later, and what `came` then, by time (s).
    """
    steps = list(steps)
    scored: dict[float, list[tuple[Plan, int, Array]]] = {}
    for hours in horizons_h:
        for step in steps:
            k = round(hours * HOUR_S / step.boundary.step_s) - 1
            later = came.get(round(step.time_s + hours * HOUR_S))
            if later is not None and 0 <= k < step.plan.u.shape[-1]:
                scored.setdefault(hours, []).append((step.plan, k, later))
    return [
        {"zone": zone, "hours": hours, **found}
        for z, zone in enumerate(result.names.zones)
        for hours, plans in scored.items()
        if (found := figures(plans, z))
    ]
