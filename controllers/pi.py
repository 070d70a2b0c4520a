"""PI control of the zone temperature with anti-windup: what a well-kept building has, tunable, to be beaten.

Setpoint tracking with a schedule known in advance: the reference is the lower comfort bound (cooling: the upper one)
plus an offset, and a rise of the bound is anticipated by a lead time, as an optimal-start function does. The integral
is held while it would drive the output further into saturation (conditional integration; Åström and Hägglund, Advanced
PID Control, 2006, section 3.5).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from thermoforce_mpc.data import HOUR_S, Block, Observation, Plan, PlanStatus
from thermoforce_mpc.scenario.settings import StrictModel


class PIConfig(StrictModel):
    """Options of the PI controller."""

    kp: float = Field(1.0, gt=0, le=100, description="proportional gain, level per kelvin")
    ti_s: float = Field(10800.0, ge=60, description="integral time, s")
    offset_K: float = Field(
        0.3, ge=-5, le=10, description="set-point above the lower comfort bound (cooling: below the upper), K"
    )
    lead_h: float = Field(2.0, ge=0, le=24, description="a tighter bound is followed this long before it comes, h")
    off_below: float = Field(0.15, ge=0, lt=1, description="output below this share switches the machine off")
    lowest_level: float = Field(0.0, ge=0, le=1, description="modulating: a running machine is at least at this level")
    actuation: Literal["modulating", "duty"] = Field(
        "duty", description="modulating: the level is held; duty: on at `level` for the asked share of a step"
    )
    level: float = Field(1.0, gt=0, le=1, description="highest level; in duty the level while on")
    step_s: float = Field(900.0, ge=300, le=86400, description="how often the controller looks, s")
    mode: Literal["heating", "cooling"] = Field("heating", description="which bound is followed")

    @model_validator(mode="after")
    def _levels_in_order(self) -> PIConfig:
        if self.lowest_level > self.level:
            raise ValueError(f"lowest_level {self.lowest_level:g} is above level {self.level:g}")
        return self


class PIController:
    """Follows the comfort bound with a PI law; keeps the integral between calls."""

    name = "pi"

    def __init__(self, config: PIConfig | None = None) -> None:
        self.config = config or PIConfig()
        self._integral = 0.0
        self._last_s: float | None = None

    @property
    def step_s(self) -> float:
        """How long a plan is followed, s."""
        return self.config.step_s

    @property
    def horizon_s(self) -> float:
        """As far as bounds are anticipated, at least one step, s."""
        steps = max(1, math.ceil(self.config.lead_h * HOUR_S / self.step_s))
        return steps * self.step_s

    def plan(self, observation: Observation) -> Plan:
        """One step of the PI law; native control while the sensor is silent."""
        c = self.config
        T = observation.T_zone_C
        if not math.isfinite(T):
            return Plan((Block(None, self.step_s),), PlanStatus.RULE, "zone temperature missing: native control")
        target = self._target_C(observation)
        error_K = (target - T) * (1.0 if c.mode == "heating" else -1.0)
        elapsed_s = 0.0 if self._last_s is None else min(observation.time_s - self._last_s, 2 * self.step_s)
        self._last_s = observation.time_s
        integral = self._integral + c.kp * error_K * elapsed_s / c.ti_s
        asked = c.kp * error_K + integral
        # Anti-windup: what would only deepen saturation is not integrated.
        if (0.0 < asked < 1.0) or (asked >= 1.0 and error_K < 0) or (asked <= 0.0 and error_K > 0):
            self._integral = integral
        share = min(max(c.kp * error_K + self._integral, 0.0), 1.0)
        share = 0.0 if share < c.off_below else share
        why = f"{error_K:+.2f} K from {target:.2f} °C, integral {self._integral:.2f}: {share:.2f} of full"
        return Plan(self._blocks(share), PlanStatus.RULE, why)

    def _target_C(self, observation: Observation) -> float:
        """The tightest bound from now until the lead time is over, with the offset, °C."""
        c, boundary = self.config, observation.boundary
        ahead = min(math.floor(c.lead_h * HOUR_S / self.step_s + 1e-9), boundary.lower_C.size - 1)
        if c.mode == "heating":
            return float(np.max(boundary.lower_C[: ahead + 1])) + c.offset_K
        return float(np.min(boundary.upper_C[: ahead + 1])) - c.offset_K

    def _blocks(self, share: float) -> tuple[Block, ...]:
        c = self.config
        if share == 0.0:
            return (Block(0.0, self.step_s),)
        if c.actuation == "modulating":
            return (Block(max(share * c.level, c.lowest_level), self.step_s),)
        # Whole minutes: on first, so that the heat comes before the next look.
        on_s = min(max(round(share * self.step_s / 60.0) * 60.0, 60.0), self.step_s)
        on = Block(c.level, on_s)
        return (on,) if on_s >= self.step_s else (on, Block(0.0, self.step_s - on_s))
