"""Prediction errors of plans and free forecasts against later measurements."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.simulation.closed_loop import RunResult


def forecast_errors(result: RunResult, horizons_h: tuple[float, ...] = (1.0, 6.0, 12.0, 24.0)) -> list[dict[str, Any]]:
    """Error of the planned zone temperature at several lead times.

    The error at the first step is a pure prediction error. Beyond it, the error also includes the difference between
    the scored plan and the later plans that were applied.

    Returns:
        One row per lead time with `hours`, `bias_K` (planned − measured), `rmse_K`, and the number `n` of plans scored.
    """
    measured = {round(step.time_s): step.T_zone_C for step in result.steps}
    rows = []
    for hours in horizons_h:
        errors = []
        for step in result.steps:
            plan = step.plan
            if not plan.u.size:
                continue
            index = round(hours * HOUR_S / step.boundary.step_s) - 1
            later = measured.get(round(step.time_s + hours * HOUR_S))
            if later is not None and 0 <= index < plan.u.size:
                errors.append(float(plan.T_zone_C[index]) - later)
        if errors:
            error = np.array(errors)
            rmse = float(np.sqrt(np.nanmean(error**2)))
            rows.append({"hours": hours, "bias_K": float(np.nanmean(error)), "rmse_K": rmse, "n": len(errors)})
    return rows


def free_forecast_scores(
    result: RunResult, horizons_h: tuple[float, ...] = (1.0, 6.0, 24.0), settle_h: float = 48.0
) -> list[dict[str, Any]]:
    """Error of the free forecasts and coverage of their 80 % intervals.

    The reference is the free temperature `T_free_now_C` of the plan made at the forecast's target time, so later
    actions do not affect the score. Plans of the first `settle_h` hours are left out, while corrections adapt.

    Returns:
        One row per lead time with `hours`, `mae_K`, `coverage` (share) and the number `n` of forecasts scored.
    """
    came = {round(step.time_s): step.plan.T_free_now_C for step in result.steps if step.plan.u.size}
    start_s = result.steps[0].time_s if result.steps else 0.0
    rows = []
    for hours in horizons_h:
        errors, inside = [], []
        for step in result.steps:
            plan, later = step.plan, came.get(round(step.time_s + hours * HOUR_S), np.nan)
            index = round(hours * HOUR_S / step.boundary.step_s) - 1
            if step.time_s - start_s < settle_h * HOUR_S or not 0 <= index < plan.u.size or not np.isfinite(later):
                continue
            errors.append(abs(plan.T_free_C[index] - later))
            inside.append(plan.T_free_low_C[index] <= later <= plan.T_free_high_C[index])
        if errors:
            rows.append(
                {
                    "hours": hours,
                    "mae_K": float(np.mean(errors)),
                    "coverage": float(np.mean(inside)),
                    "n": len(errors),
                }
            )
    return rows
