"""On/off thermostat with a dead band and an optional weekday setback (baseline)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import Field

from controllers.checks import check_names, checked_state
from thermoforce_mpc.data import DAY_S, Block, Layout, Observation, Plan, PlanStatus
from thermoforce_mpc.data.clock import PLAN_STEP_S, hour_of_day
from thermoforce_mpc.scenario.comfort import THERMOSTAT_INSIDE_K, Comfort
from thermoforce_mpc.scenario.settings import StrictModel
from thermoforce_mpc.scenario.testcase import TestCase


class Setback(StrictModel):
    """Daily period on weekdays during which the machine stays off."""

    from_hour: float = Field(ge=0, le=24, description="hour of day at which the setback begins")
    to_hour: float = Field(
        ge=0, le=24, description="hour of day at which it ends; earlier than from_hour: on the next day"
    )
    # Of BOPTEST's schedules, since these have no other.
    weekend_days: tuple[int, ...] = Field((4, 5), description="days of the year modulo 7 without setback (BOPTEST)")

    def active(self, time_s: float) -> bool:
        """Whether `time_s` is within the setback."""
        if int(time_s // DAY_S) % 7 in self.weekend_days:
            return False
        hour = float(hour_of_day(time_s))
        if self.from_hour <= self.to_hour:
            return self.from_hour <= hour < self.to_hour
        return hour >= self.from_hour or hour < self.to_hour


class ThermostatConfig(StrictModel):
    """Options of the on/off thermostat. Defaults are the reference thermostat of this test case."""

    # As far inside BOPTEST's bounds of 21 and 24 °C as `THERMOSTAT_INSIDE_K`.
    setpoint_C: float = Field(21.3, ge=0, le=40, description="centre of the dead band, °C")
    setpoints_C: dict[str, float] = Field(
        default_factory=dict,
        description="centre of the dead band of single actuators, by name, °C; `setpoint_C` otherwise",
    )
    # See `setpoint_C`.
    cooling_setpoint_C: float = Field(
        23.7, ge=0, le=40, description="set-point of cooling where the plant's own loops heat and cool a zone, °C"
    )
    # A sensor's step to either side (`SENSOR_STEP_K` of `data.limits`): less would be its rounding.
    deadband_K: float = Field(0.1, gt=0, le=5, description="half-width of the dead band, K")
    level: float = Field(1.0, gt=0, le=1, description="level while on")
    step_s: float = Field(PLAN_STEP_S, ge=60, le=86400, description="control step, s")
    min_on_s: float = Field(0.0, ge=0, le=86400, description="shortest time for which a machine stays on, s")
    min_off_s: float = Field(0.0, ge=0, le=86400, description="shortest time for which it stays off, s")
    mode: Literal["heating", "cooling"] = Field(
        "heating", description="heating: on below the dead band; cooling: on above it; counts for one actuator"
    )
    setback: Setback | None = Field(None, description="weekday hours during which the machine stays off; null: none")

    @property
    def in_words(self) -> str:
        """What it keeps, and when."""
        of_each = ", ".join(f"{setpoint:g} °C at {name}" for name, setpoint in self.setpoints_C.items())
        kept = f"keeps {of_each or f'{self.setpoint_C:g} °C'} (± {self.deadband_K:g} K)"
        if self.setback is None:
            return f"{kept} day and night, whatever the comfort bounds are"
        return f"{kept}, off from {self.setback.from_hour:g} to {self.setback.to_hour:g} h on weekdays"


def thermostat_for(testcase: TestCase, comfort: Comfort | None, options: Mapping[str, Any]) -> dict[str, Any]:
    """Defaults of its options for a test case, see `Entry.suited`.

    Without set-points of its own it keeps those of the `comfort` bounds, where there are any.
    """
    points, layout = testcase.points, testcase.layout
    defaults: dict[str, Any] = {"mode": "cooling" if layout.mode(0) == "cooling" else "heating"}
    set_points = {
        actuator: zone.thermostat_C
        for actuator, home in zip(layout.names.actuators, layout.home, strict=True)
        if (zone := points.zones[home]).thermostat_C is not None
    }
    if testcase.thermostat_C is not None:
        defaults["setpoint_C"] = testcase.thermostat_C
    elif set_points:
        defaults["setpoints_C"] = set_points
    if comfort and not options.keys() & {"setpoint_C", "setpoints_C"}:
        defaults |= _set_points(comfort, layout)
    return defaults


def _set_points(comfort: Comfort, layout: Layout) -> dict[str, Any]:
    """Set-points inside the strictest bounds of each zone: a thermostat cannot heat ahead of a bound that rises."""
    bounds_C = comfort.strictest_C(layout.names.zones)
    heating = [round(lower + THERMOSTAT_INSIDE_K, 2) for lower, _ in bounds_C]
    cooling = [round(upper - THERMOSTAT_INSIDE_K, 2) for _, upper in bounds_C]
    acting = zip(layout.names.actuators, layout.home, layout.signs, strict=True)
    set_points = {name: (heating if sign > 0 else cooling)[home] for name, home, sign in acting}
    return {"setpoints_C": set_points, "cooling_setpoint_C": max(*heating, min(cooling))}


def shifted(config: ThermostatConfig, layout: Layout, shift_K: float) -> ThermostatConfig:
    """Options whose zones are kept so much warmer where they are heated, and cooler where they are cooled."""
    set_points = {
        name: config.setpoints_C.get(name, config.setpoint_C) + sign * shift_K
        for name, sign in zip(layout.names.actuators, layout.signs, strict=True)
    }
    cooling_C = config.cooling_setpoint_C - shift_K
    return config.model_copy(update={"setpoints_C": set_points, "cooling_setpoint_C": cooling_C})


@dataclass(frozen=True)
class ThermostatState:
    """Whether each actuator is on (A,), and when it was last switched (A,), s; empty: long ago."""

    on: tuple[bool, ...]
    since_s: tuple[float, ...] = ()

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
            if self.layout.u_min[a] < 0.0:
                bands[a] = low, high = self._setpoint_C(a), self.config.cooling_setpoint_C
                levels.append(0.0)
                on.append(False)
                reasons.append(f"{actuator}: loops keep {low:g} to {high:g} °C")
                continue
            T_zone_C = float(observation.T_zone_C[self.layout.home[a]])
            held_s = observation.time_s - last.since_s[a] if last.since_s else math.inf
            is_on, why = self._switch(a, T_zone_C, observation.time_s, last.on[a], held_s)
            levels.append(None if is_on is None else self.config.level * is_on)
            on.append(last.on[a] if is_on is None else is_on)
            reasons.append(names.of_actuator(a, why))
        wanted = [None if level is None else level * (1 + was) for level, was in zip(levels, last.on, strict=True)]
        for a, by in self.layout.excluded(wanted).items():
            levels[a] = None if levels[by] is None else 0.0
            on[a] = False
            reasons.append(f"{names.actuators[a]}: excluded by {names.actuators[by]}")
        block = Block(levels, self.step_s, bands)
        before_s = last.since_s or (-math.inf,) * len(on)
        since_s = tuple(
            before if now == was else observation.time_s for before, now, was in zip(before_s, on, last.on, strict=True)
        )
        kept = ThermostatState(tuple(on), since_s)
        return Plan((block,), PlanStatus.RULE, "; ".join(reasons), names=names, state=kept)

    def _switch(self, a: int, T_zone_C: float, time_s: float, was_on: bool, held_s: float) -> tuple[bool | None, str]:
        """Whether actuator `a`, as it has been for `held_s`, is on, and why."""
        wanted, why = self._wanted(a, T_zone_C, time_s, was_on)
        shortest_s = self.config.min_on_s if was_on else self.config.min_off_s
        if wanted is None or wanted == was_on or held_s >= shortest_s - 1.0:
            return wanted, why
        return was_on, f"{why}; stays {'on' if was_on else 'off'} for {shortest_s:g} s"

    def _wanted(self, a: int, T_zone_C: float, time_s: float, was_on: bool) -> tuple[bool | None, str]:
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
