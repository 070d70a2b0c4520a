"""Were the plans' predictions true? Plans are compared with what the plant then did, as far as plans were followed."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermoforce_mpc.closed_loop import RunResult
from thermoforce_mpc.types import HOUR_S


def forecast_errors(result: RunResult, horizons_h: tuple[float, ...] = (1.0, 6.0, 12.0, 24.0)) -> list[dict[str, Any]]:
    """Error of the planned zone temperature at several horizons.

    Beyond the first step later plans deviate from the plan scored here, so the error holds both the forecast's
    error and that deviation; the first step is a pure forecast error.

    Returns:
        One row per horizon with `hours`, `bias_K` (planned − measured), `rmse_K`, and the number `n` of plans scored.
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
