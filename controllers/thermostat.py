"""On/off thermostat with a dead band and an optional weekday setback (baseline)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from controllers.inputs import checked_state
from thermoforce_mpc.data import DAY_S, HOUR_S, Block, Observation, Plan, PlanStatus
from thermoforce_mpc.scenario.settings import StrictModel


class Setback(StrictModel):
    """Daily period on weekdays during which the machine stays off."""

    from_hour: float = Field(ge=0, le=24, description="hour of day at which the setback begins")
    to_hour: float = Field(
        ge=0, le=24, description="hour of day at which it ends; earlier than from_hour: on the next day"
    )
    weekend_days: tuple[int, ...] = Field((4, 5), description="days of the year modulo 7 without setback (BOPTEST)")

    def active(self, time_s: float) -> bool:
        """Whether `time_s` is within the setback."""
        if int(time_s // DAY_S) % 7 in self.weekend_days:
            return False
        hour = (time_s % DAY_S) / HOUR_S
        if self.from_hour <= self.to_hour:
            return self.from_hour <= hour < self.to_hour
        return hour >= self.from_hour or hour < self.to_hour


class ThermostatConfig(StrictModel):
    """Options of the on/off thermostat. Defaults are the reference thermostat of this test case."""

    setpoint_C: float = Field(21.3, ge=0, le=40, description="centre of the dead band, °C")
    deadband_K: float = Field(0.1, gt=0, le=5, description="half-width of the dead band, K")
    level: float = Field(1.0, gt=0, le=1, description="level while on")
    step_s: float = Field(900.0, ge=60, le=86400, description="control step, s")
    mode: Literal["heating", "cooling"] = Field(
        "heating", description="heating: on below the dead band; cooling: on above it"
    )
    setback: Setback | None = Field(None, description="weekday hours during which the machine stays off; null: none")


@dataclass(frozen=True)
class ThermostatState:
    """Whether the machine is on."""

    on: bool = False


class Thermostat:
    """On/off control of the zone temperature with hysteresis, at one level while on."""

    name = "thermostat"

    def __init__(self, config: ThermostatConfig | None = None) -> None:
        self.config = config or ThermostatConfig()

    @property
    def step_s(self) -> float:
        """Control step, s."""
        return self.config.step_s

    @property
    def horizon_s(self) -> float:
        """One step, s: no forecast is used."""
        return self.config.step_s

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """On below the dead band, off above it (cooling: reversed), unchanged inside; native control if T is missing.

        Raises:
            DataError: `state` is not from a plan of a thermostat.
        """
        c, last = self.config, checked_state(state, ThermostatState) or ThermostatState()
        T = observation.T_zone_C
        if not math.isfinite(T):
            why = "zone temperature missing: native control"
            return Plan((Block(None, self.step_s),), PlanStatus.RULE, why, state=last)
        # Distance from the set-point on the side that needs the machine: below it heating, above it cooling.
        need_K = (c.setpoint_C - T) * (1.0 if c.mode == "heating" else -1.0)
        if c.setback and c.setback.active(observation.time_s):
            on, why = False, "setback"
        elif need_K > c.deadband_K:
            on, why = True, f"{T:.2f} °C is beyond the dead band: on"
        elif need_K < -c.deadband_K:
            on, why = False, f"{T:.2f} °C is beyond the dead band: off"
        else:
            on, why = last.on, f"{T:.2f} °C is inside the dead band: unchanged"
        block = Block(c.level if on else 0.0, self.step_s)
        return Plan((block,), PlanStatus.RULE, why, state=ThermostatState(on))
