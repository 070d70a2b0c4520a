"""PI control of the zone temperature with anti-windup and optimal start (baseline).

The set-point is the lower comfort bound plus an offset (cooling: the upper bound minus it). A tighter bound is followed
a lead time in advance, as by an optimal-start function. The integral is held while it would drive the output further
into saturation (conditional integration; Åström and Hägglund, Advanced
PID Control, 2006, section 3.5).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydantic import Field

from controllers.actuation.actuator import Actuation, ActuationConfig, ActuationState
from controllers.actuation.actuators import Actuators
from controllers.checks import ControllerConfigError, check_later, checked_state
from thermoforce_mpc.data import HOUR_S, Layout, Observation, Plan, PlanStatus
from thermoforce_mpc.data.clock import PLAN_STEP_S
from thermoforce_mpc.scenario.comfort import THERMOSTAT_INSIDE_K, Comfort
from thermoforce_mpc.scenario.settings import StrictModel
from thermoforce_mpc.scenario.testcase import TestCase


class PIConfig(StrictModel):
    """Options of the PI controller."""

    # Full output at 1 K: half the band of 2 K in which valves of radiators are rated (EN 215).
    kp: float = Field(1.0, gt=0, le=100, description="proportional gain, level per kelvin")
    # The hours in which a heated floor answers; by judgement, with BOPTEST's heat pump (2026-11-21).
    ti_s: float = Field(10800.0, ge=60, description="integral time, s")
    offset_K: float = Field(
        THERMOSTAT_INSIDE_K,
        ge=-5,
        le=10,
        description="set-point above the lower comfort bound (cooling: below the upper), K",
    )
    # By judgement: what a heated floor needs to be ahead of a bound that tightens, as that of BOPTEST's heat pump
    # (2026-11-21).
    lead_h: float = Field(
        2.0, ge=0, le=24, description="lead time with which a tighter bound is followed in advance, h"
    )
    # Half of `lowest_level`: rounded to the nearer of off and that.
    off_below: float = Field(0.15, ge=0, lt=1, description="output below which the machine is off, share of full")
    actuation: ActuationConfig = ActuationConfig()
    step_s: float = Field(PLAN_STEP_S, ge=300, le=86400, description="control step, s")
    mode: Literal["heating", "cooling"] = Field(
        "heating", description="heating follows the lower comfort bound, cooling the upper"
    )


@dataclass(frozen=True)
class PIState:
    """Of each actuator (A,): integral, share of full output, and state of the machine; time of the last update, s."""

    integral: tuple[float, ...]
    time_s: float | None = None
    actuation: tuple[ActuationState, ...] | None = None

    @property
    def rows(self) -> dict[str, int]:
        """How many actuators it is of."""
        return {"actuators": len(self.integral)}


def pi_for(testcase: TestCase, comfort: Comfort | None, options: Mapping[str, Any]) -> dict[str, Any]:
    """Defaults of its options for a test case, see `Entry.suited`; raises as `check_layout`."""
    check_layout(testcase.layout)
    return {"mode": "cooling" if testcase.layout.mode(0) == "cooling" else "heating"}


def check_layout(layout: Layout) -> None:
    """Raise `ControllerConfigError` where one actuator heats and cools: the law would only ever heat by it."""
    for actuator, u_min in zip(layout.names.actuators, layout.u_min, strict=True):
        if u_min < 0.0:
            raise ControllerConfigError(
                f"controller.name: pi does not heat and cool by the room set-points of {actuator}; use thermostat"
            )


class PIController:
    """PI controller of each zone on its comfort bound; by default one zone with one actuator of the option `mode`.

    Raises:
        ControllerConfigError: the actuation does not fit the step, or an actuator heats and cools.
    """

    name = "pi"

    def __init__(self, config: PIConfig | None = None, layout: Layout | None = None) -> None:
        self.config = config or PIConfig()
        self.step_s = self.config.step_s
        # Lead time rounded up to whole steps, at least one.
        self.horizon_s = max(1, math.ceil(self.config.lead_h * HOUR_S / self.step_s)) * self.step_s
        self.layout = layout or Layout.single(self.config.mode)
        check_layout(self.layout)
        self._actuators = Actuators(self.layout, [Actuation(self.config.actuation) for _ in self.layout.home])
        self._actuators.check_step(self.config.step_s)

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """One step of the PI law; native control while the zone temperature or the bounds are missing.

        Raises `DataError` where `state` is not from a plan of a PI controller, or from a later one, or the boundary
        forecast does not begin now.
        """
        observation.check_begin()
        names = self.layout.names
        last = checked_state(state, PIState, names) or PIState((0.0,) * len(names.actuators))
        check_later(last.time_s, observation.time_s)
        until_s = None if last.time_s is None else last.time_s + self.step_s
        machines = self._actuators.now(last.actuation, observation.history, until_s)
        elapsed_s = 0.0 if last.time_s is None else min(observation.time_s - last.time_s, 2 * self.step_s)
        demands: list[float | None] = []
        integrals, reasons = [], []
        for a in range(len(names.actuators)):
            share, integral, why = self._apply_law(a, observation, last.integral[a], elapsed_s)
            demands.append(None if share is None else share * self._actuators.each[a].highest)
            integrals.append(integral)
            reasons.append(names.of_actuator(a, why))
        realised = self._actuators.realise(demands, self.step_s, machines)
        reasons += [f"{names.actuators[a]}: excluded by {names.actuators[by]}" for a, by in realised.excluded.items()]
        # Under native control of all, the law has not been applied.
        time_s = last.time_s if all(demand is None for demand in demands) else observation.time_s
        after = PIState(tuple(integrals), time_s, realised.states)
        return Plan(realised.together(), PlanStatus.RULE, "; ".join(reasons), names=names, state=after)

    def _apply_law(
        self, a: int, observation: Observation, last_integral: float, elapsed_s: float
    ) -> tuple[float | None, float, str]:
        """Share of full output of actuator `a` (None: native control), its integral, and why."""
        c = self.config
        T, target = float(observation.T_zone_C[self.layout.home[a]]), self._target_C(observation, a)
        if not (math.isfinite(T) and math.isfinite(target)):
            missing = "comfort bound" if math.isfinite(T) else "zone temperature"
            return None, last_integral, f"{missing} missing: native control"
        error_K = (target - T) * self.layout.signs[a]
        integral = last_integral + c.kp * error_K * elapsed_s / c.ti_s
        output = c.kp * error_K + integral
        # Anti-windup: do not integrate further into saturation.
        if not ((0.0 < output < 1.0) or (output >= 1.0 and error_K < 0) or (output <= 0.0 and error_K > 0)):
            integral = last_integral
        share = min(max(c.kp * error_K + integral, 0.0), 1.0)
        share = 0.0 if share < c.off_below else share
        return share, integral, f"{error_K:+.2f} K from {target:.2f} °C, integral {integral:.2f}: {share:.2f} of full"

    def _target_C(self, observation: Observation, a: int) -> float:
        """Set-point: tightest bound of the home zone within the lead time, with the offset, °C."""
        c, boundary, z = self.config, observation.boundary, self.layout.home[a]
        ahead = min(math.floor(c.lead_h * HOUR_S / self.step_s + 1e-9), boundary.n_steps)
        if self.layout.signs[a] > 0:
            return float(np.max(boundary.lower_C[z, : ahead + 1])) + c.offset_K
        return float(np.min(boundary.upper_C[z, : ahead + 1])) - c.offset_K
