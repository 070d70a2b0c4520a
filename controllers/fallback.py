"""What acts when a plan cannot be made: the previous plan one step on, then an on/off rule, then native control."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from thermoforce_mpc.data import HOUR_S, Block, Observation, Plan, PlanStatus
from thermoforce_mpc.scenario.settings import StrictModel


class FallbackConfig(StrictModel):
    """Options of the fallback policy."""

    follow_steps: int = Field(3, ge=0, description="how many steps a previous plan is followed without a new one")
    trust_K: float = Field(1.0, gt=0, description="a previous plan is dropped when its prediction is off by more, K")
    setpoint_above_bound_K: float = Field(0.3, description="rule: set-point above the lower bound of the next hours, K")
    look_ahead_h: float = Field(3.0, ge=0, description="rule: how far ahead the highest lower bound is looked for, h")


class FallbackPolicy:
    """Remembers the last good plan and says what to do when there is no new one."""

    def __init__(self, config: FallbackConfig, step_s: float, level: float, mode: str) -> None:
        self.config, self.step_s, self.level, self.mode = config, step_s, level, mode
        self._plan: Plan | None = None
        self._made_at_s = -math.inf

    def remember(self, plan: Plan, time_s: float) -> None:
        """Keep a good plan as the first level."""
        self._plan, self._made_at_s = plan, time_s

    def level_to_follow(self, observation: Observation) -> float | None:
        """The level the last good plan intended for now, or None when it is too old or its prediction was far off."""
        if self._plan is None:
            return None
        age = round((observation.time_s - self._made_at_s) / self.step_s)
        if not 1 <= age <= min(self.config.follow_steps, self._plan.u.size - 1):
            return None
        # A silent sensor says nothing about the plan; a wrong prediction does.
        off_by = abs(observation.T_zone_C - self._plan.T_zone_C[age - 1])
        if math.isfinite(off_by) and off_by > self.config.trust_K:
            return None
        return float(self._plan.u[age])

    def rule(self, observation: Observation, reason: str) -> Plan:
        """An on/off rule around the comfort bounds of the next hours; native control while the sensor is silent."""
        ahead = observation.boundary.time_s <= observation.time_s + self.config.look_ahead_h * HOUR_S
        if self.mode == "heating":
            setpoint = float(np.max(observation.boundary.lower_C[ahead])) + self.config.setpoint_above_bound_K
        else:
            setpoint = float(np.min(observation.boundary.upper_C[ahead])) - self.config.setpoint_above_bound_K
        if not (math.isfinite(setpoint) and math.isfinite(observation.T_zone_C)):
            why = f"{reason}; zone temperature or bounds missing: native control"
            return Plan((Block(None, self.step_s),), PlanStatus.THERMOSTAT, why)
        need_K = (setpoint - observation.T_zone_C) * (1.0 if self.mode == "heating" else -1.0)
        on = need_K > 0
        why = f"{reason}; {observation.T_zone_C:.2f} °C against {setpoint:.2f} °C: {'on' if on else 'off'}"
        return Plan((Block(self.level if on else 0.0, self.step_s),), PlanStatus.THERMOSTAT, why)
