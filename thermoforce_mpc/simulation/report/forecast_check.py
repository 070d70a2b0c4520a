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
        One row per zone and lead time with `zone`, `hours`, `bias_K` (planned − measured), `rmse_K`, and the number `n`
        of plans scored.
    """
    measured = {round(step.time_s): step.T_zone_C for step in result.steps}
    rows: dict[tuple[str, float], dict[str, Any]] = {}
    for hours in horizons_h:
        errors = []
        for step in result.steps:
            plan = step.plan
            if not plan.u.size:
                continue
            index = round(hours * HOUR_S / step.boundary.step_s) - 1
            later = measured.get(round(step.time_s + hours * HOUR_S))
            if later is not None and 0 <= index < plan.u.shape[-1]:
                errors.append(plan.T_zone_C[:, index] - later)
        for zone, error in zip(result.names.zones, np.transpose(errors), strict=False):
            finite = error[np.isfinite(error)]  # NaN where the zone's sensor was silent
            if finite.size:
                rmse, bias = float(np.sqrt(np.mean(finite**2))), float(np.mean(finite))
                rows[zone, hours] = {"zone": zone, "hours": hours, "bias_K": bias, "rmse_K": rmse, "n": finite.size}
    return _by_zone(rows, result, horizons_h)


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
    rows: dict[tuple[str, float], dict[str, Any]] = {}
    for hours in horizons_h:
        errors, inside = [], []
        for step in result.steps:
            plan, later = step.plan, came.get(round(step.time_s + hours * HOUR_S))
            index = round(hours * HOUR_S / step.boundary.step_s) - 1
            if later is None or step.time_s - start_s < settle_h * HOUR_S or not 0 <= index < plan.u.shape[-1]:
                continue
            errors.append(np.abs(plan.T_free_C[:, index] - later))
            inside.append((plan.T_free_low_C[:, index] <= later) & (later <= plan.T_free_high_C[:, index]))
        for zone, error, covered in zip(result.names.zones, np.transpose(errors), np.transpose(inside), strict=False):
            finite = np.isfinite(error)  # NaN where the zone's sensor was silent
            if finite.any():
                rows[zone, hours] = {
                    "zone": zone,
                    "hours": hours,
                    "mae_K": float(np.mean(error[finite])),
                    "coverage": float(np.mean(covered[finite])),
                    "n": int(finite.sum()),
                }
    return _by_zone(rows, result, horizons_h)


def _by_zone(
    rows: dict[tuple[str, float], dict[str, Any]], result: RunResult, horizons_h: tuple[float, ...]
) -> list[dict[str, Any]]:
    """The rows zone by zone, then by lead time."""
    return [rows[zone, h] for zone in result.names.zones for h in horizons_h if (zone, h) in rows]
