"""On/off thermostat with a dead band and an optional weekday setback (baseline)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from controllers.checks import check_names, checked_state
from thermoforce_mpc.data import DAY_S, HOUR_S, Block, Layout, Observation, Plan, PlanStatus
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
    setpoints_C: dict[str, float] = Field(
        default_factory=dict,
        description="centre of the dead band of single actuators, by name, °C; `setpoint_C` otherwise",
    )
    cooling_setpoint_C: float = Field(
        23.7, ge=0, le=40, description="set-point of cooling where the plant's own loops heat and cool a zone, °C"
    )
    deadband_K: float = Field(0.1, gt=0, le=5, description="half-width of the dead band, K")
    level: float = Field(1.0, gt=0, le=1, description="level while on")
    step_s: float = Field(900.0, ge=60, le=86400, description="control step, s")
    mode: Literal["heating", "cooling"] = Field(
        "heating", description="heating: on below the dead band; cooling: on above it; counts for one actuator"
    )
    setback: Setback | None = Field(None, description="weekday hours during which the machine stays off; null: none")


@dataclass(frozen=True)
class ThermostatState:
    """Whether each actuator is on (A,)."""

    on: tuple[bool, ...]

    @property
    def rows(self) -> dict[str, int]:
        """How many actuators it is of."""
        return {"actuators": len(self.on)}


class Thermostat:
    """On/off control of each zone's temperature with hysteresis, at one level while on.

    By default one zone with one actuator of the option `mode`. Raises `ControllerConfigError` where a set-point is of
    an actuator that there is not.
    """

    name = "thermostat"

    def __init__(self, config: ThermostatConfig | None = None, layout: Layout | None = None) -> None:
        self.config = config or ThermostatConfig()
        self.step_s = self.horizon_s = self.config.step_s  # no forecast is used
        self.layout = layout or Layout.single(self.config.mode)
        check_names("setpoints_C", self.config.setpoints_C, "actuator", self.layout.names.actuators)

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """On below the dead band, off above it (cooling: reversed), unchanged inside; native control if T is missing.

        Where the plant's own loops heat and cool a zone, they keep the two set-points. Raises `DataError` where `state`
        is not from a plan of a thermostat.
        """
        names = self.layout.names
        last = checked_state(state, ThermostatState, names) or ThermostatState((False,) * len(names.actuators))
        levels: list[float | None] = []
        bands: list[tuple[float, float] | None] = [None] * len(names.actuators)
        on, reasons = [], []
        for a, actuator in enumerate(names.actuators):
            if self.layout.lowest[a] < 0.0:
                bands[a] = low, high = self._setpoint_C(a), self.config.cooling_setpoint_C
                levels.append(0.0)
                on.append(False)
                reasons.append(f"{actuator}: loops keep {low:g} to {high:g} °C")
                continue
            T_zone_C = float(observation.T_zone_C[self.layout.home[a]])
            is_on, why = self._switch(a, T_zone_C, observation.time_s, last.on[a])
            levels.append(None if is_on is None else self.config.level * is_on)
            on.append(last.on[a] if is_on is None else is_on)
            reasons.append(names.of_actuator(a, why))
        wanted = [None if level is None else level * (1 + was) for level, was in zip(levels, last.on, strict=True)]
        for a, by in self.layout.excluded(wanted).items():
            levels[a] = None if levels[by] is None else 0.0
            on[a] = False
            reasons.append(f"{names.actuators[a]}: excluded by {names.actuators[by]}")
        block = Block(levels, self.step_s, bands)
        return Plan((block,), PlanStatus.RULE, "; ".join(reasons), names=names, state=ThermostatState(tuple(on)))

    def _switch(self, a: int, T_zone_C: float, time_s: float, was_on: bool) -> tuple[bool | None, str]:
        c = self.config
        if not math.isfinite(T_zone_C):
            return None, "zone temperature missing: native control"
        # Distance from the set-point on the side that needs the machine: below it heating, above it cooling.
        need_K = (self._setpoint_C(a) - T_zone_C) * self.layout.signs[a]
        if c.setback and c.setback.active(time_s):
            return False, "setback"
        if need_K > c.deadband_K:
            return True, f"{T_zone_C:.2f} °C is beyond the dead band: on"
        if need_K < -c.deadband_K:
            return False, f"{T_zone_C:.2f} °C is beyond the dead band: off"
        return was_on, f"{T_zone_C:.2f} °C is inside the dead band: unchanged"

    def _setpoint_C(self, a: int) -> float:
        return self.config.setpoints_C.get(self.layout.names.actuators[a], self.config.setpoint_C)
