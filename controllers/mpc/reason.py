"""Why a plan is what it is, in one sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.data import HOUR_S, Array, FreeForecast, Plan

# A bound nearer than this is reported as binding, K.
_BINDING_K = 0.02


def reason_of(
    problem: MPCProblem, zones: Sequence[str], T_zone_C: Array, slack_K: Array, forecast: FreeForecast
) -> str:
    """Which bound is binding, where and when, and the width of the forecast's 80 % band there.

    Args:
        problem: the instance, Z zones over N steps.
        zones: their names (Z,).
        T_zone_C: planned temperatures (Z, N), °C.
        slack_K: planned violations (Z, N), K.
        forecast: free response of all zones.
    """
    band = forecast.quantile_C(0.9) - forecast.quantile_C(0.1)
    lower_C, upper_C = problem.lower_C, problem.upper_C
    z, when = (int(i) for i in np.unravel_index(int(np.argmax(slack_K)), slack_K.shape))
    if slack_K[z, when] > 1e-3:
        side = "below" if T_zone_C[z, when] < lower_C[z, when] else "above"
        what = f"{slack_K[z, when]:.2f} K {side} the comfort band cannot be avoided economically"
    else:
        gap = np.minimum(T_zone_C - lower_C, upper_C - T_zone_C)
        # The first binding bound, not the tightest: it determines the plan of the next hours.
        near = gap <= max(_BINDING_K, float(gap.min()))
        when = int(np.argmax(near.any(axis=0)))
        z = int(np.argmax(near[:, when]))
        if gap[z, when] > _BINDING_K:
            nearest = f"comfort is not binding within the horizon (nearest {gap[z, when]:.2f} K{_of(zones, z)})"
            return f"{nearest}; free forecast: {forecast.note}"
        low = T_zone_C[z, when] - lower_C[z, when] <= upper_C[z, when] - T_zone_C[z, when]
        bound_C = (lower_C if low else upper_C)[z, when]
        what = f"{'lower' if low else 'upper'} bound with its margin, {bound_C:.2f} °C, binds"
    hours = (when + 1) * problem.step_s / HOUR_S
    where = _of(zones, z)
    return f"{what}{where} in {hours:g} h (80 % band of the free forecast there: {band[z, when]:.2f} K)"


def with_news(plan: Plan, *news: str) -> Plan:
    """The plan that also says what was learned in its step."""
    said = "; ".join(filter(None, news))
    if not said:
        return plan
    return replace(plan, news="; ".join(filter(None, (said, plan.news))), why=f"{said}; {plan.why}")


def _of(zones: Sequence[str], z: int) -> str:
    return "" if len(zones) == 1 else f" in {zones[z]}"
