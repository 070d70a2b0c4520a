"""PI control of the zone temperature with anti-windup and optimal start (baseline).

The set-point is the lower comfort bound plus an offset (cooling: the upper bound minus it). A tighter bound is followed
a lead time in advance, as by an optimal-start function. The integral is held while it would drive the output further
into saturation (conditional integration; Åström and Hägglund, Advanced
PID Control, 2006, section 3.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import Field

from controllers.actuation import Actuation, ActuationConfig, ActuationState
from controllers.inputs import checked_state
from thermoforce_mpc.data import HOUR_S, Observation, Plan, PlanStatus
from thermoforce_mpc.scenario.settings import StrictModel


class PIConfig(StrictModel):
    """Options of the PI controller."""

    kp: float = Field(1.0, gt=0, le=100, description="proportional gain, level per kelvin")
    ti_s: float = Field(10800.0, ge=60, description="integral time, s")
    offset_K: float = Field(
        0.3, ge=-5, le=10, description="set-point above the lower comfort bound (cooling: below the upper), K"
    )
    lead_h: float = Field(
        2.0, ge=0, le=24, description="lead time with which a tighter bound is followed in advance, h"
    )
    off_below: float = Field(0.15, ge=0, lt=1, description="output below which the machine is off, share of full")
    actuation: ActuationConfig = ActuationConfig()
    step_s: float = Field(900.0, ge=300, le=86400, description="control step, s")
    mode: Literal["heating", "cooling"] = Field(
        "heating", description="heating follows the lower comfort bound, cooling the upper"
    )


@dataclass(frozen=True)
class PIState:
    """Integral, share of full output; time of its last update, s; state of the machine."""

    integral: float = 0.0
    time_s: float | None = None
    actuation: ActuationState | None = None


class PIController:
    """PI controller on the comfort bound.

    Raises:
        ControllerConfigError: the actuation does not fit the step.
    """

    name = "pi"

    def __init__(self, config: PIConfig | None = None) -> None:
        self.config = config or PIConfig()
        self._actuation = Actuation(self.config.actuation)
        self._actuation.check_step(self.config.step_s)

    @property
    def step_s(self) -> float:
        """Control step, s."""
        return self.config.step_s

    @property
    def horizon_s(self) -> float:
        """Lead time rounded up to whole steps, at least one, s."""
        steps = max(1, math.ceil(self.config.lead_h * HOUR_S / self.step_s))
        return steps * self.step_s

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """One step of the PI law; native control while the zone temperature or the bounds are missing.

        Raises:
            DataError: `state` is not from a plan of a PI controller.
        """
        c, last = self.config, checked_state(state, PIState) or PIState()
        machine = self._actuation.now(last.actuation, observation.history)
        T, target = observation.T_zone_C, self._target_C(observation)
        if not (math.isfinite(T) and math.isfinite(target)):
            what = "comfort bound" if math.isfinite(T) else "zone temperature"
            blocks, machine = self._actuation.realise(None, self.step_s, machine)
            why = f"{what} missing: native control"
            return Plan(blocks, PlanStatus.RULE, why, state=replace(last, actuation=machine))
        error_K = (target - T) * (1.0 if c.mode == "heating" else -1.0)
        elapsed_s = 0.0 if last.time_s is None else min(observation.time_s - last.time_s, 2 * self.step_s)
        integral = last.integral + c.kp * error_K * elapsed_s / c.ti_s
        asked = c.kp * error_K + integral
        # Anti-windup: do not integrate further into saturation.
        if not ((0.0 < asked < 1.0) or (asked >= 1.0 and error_K < 0) or (asked <= 0.0 and error_K > 0)):
            integral = last.integral
        share = min(max(c.kp * error_K + integral, 0.0), 1.0)
        share = 0.0 if share < c.off_below else share
        blocks, machine = self._actuation.realise(share * self._actuation.highest, self.step_s, machine)
        why = f"{error_K:+.2f} K from {target:.2f} °C, integral {integral:.2f}: {share:.2f} of full"
        return Plan(blocks, PlanStatus.RULE, why, state=PIState(integral, observation.time_s, machine))

    def _target_C(self, observation: Observation) -> float:
        """Set-point: tightest bound within the lead time, with the offset, °C."""
        c, boundary = self.config, observation.boundary
        ahead = min(math.floor(c.lead_h * HOUR_S / self.step_s + 1e-9), boundary.lower_C.size - 1)
        if c.mode == "heating":
            return float(np.max(boundary.lower_C[: ahead + 1])) + c.offset_K
        return float(np.min(boundary.upper_C[: ahead + 1])) - c.offset_K
