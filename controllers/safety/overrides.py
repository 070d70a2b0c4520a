"""What overrules a plan: the competence gate (docs/how-it-works/competence.md) before, the comfort guard after it."""

from __future__ import annotations

import math

from pydantic import Field

from thermoforce_mpc.data import Observation
from thermoforce_mpc.model.competence import Competence
from thermoforce_mpc.scenario.settings import StrictModel


class GuardConfig(StrictModel):
    """Options of the comfort guard."""

    enabled: bool = Field(True, description="override a plan while the zone is far outside the comfort band")
    margin_K: float = Field(1.0, gt=0, le=10, description="distance from the band at which the guard acts, K")


def guard_level(
    config: GuardConfig, observation: Observation, *, u: float, highest: float, sign: int, zone: int = 0
) -> tuple[float, str] | None:
    """Return the level that brings the zone back, and why; None while the plan may act.

    Args:
        config: options.
        observation: zone temperature and comfort bounds now.
        u: planned level of this step, in [0, `highest`].
        highest: highest level that may be planned.
        sign: +1 heating, −1 cooling.
        zone: number of the zone that the actuator serves.
    """
    T, bounds = float(observation.T_zone_C[zone]), observation.boundary
    lower, upper = float(bounds.lower_C[zone, 0]), float(bounds.upper_C[zone, 0])
    if not config.enabled or not all(map(math.isfinite, (T, lower, upper))):
        return None
    below, above = lower - T, T - upper
    if max(below, above) <= config.margin_K:
        return None
    needed = below > above if sign > 0 else above > below
    level = highest if needed else 0.0
    if math.isclose(u, level, abs_tol=1e-3):
        return None
    side = f"{below:.2f} K below" if below > above else f"{above:.2f} K above"
    return level, f"guard: {T:.2f} °C is {side} the comfort band at a planned level of {u:.2f}: {level:.2f} instead"


class GateConfig(StrictModel):
    """Options of the competence gate."""

    enabled: bool = Field(True, description="do not act on a model whose held-out data condemn it")


def gate_reason(config: GateConfig, competence: Competence | None) -> str | None:
    """Return why a controller must not act on a model of this verdict; None where it may, or was not judged."""
    if not config.enabled or competence is None or competence.competent:
        return None
    return f"gate: the model is {competence.in_words()}"
