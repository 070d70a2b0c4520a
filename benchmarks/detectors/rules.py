"""Every rule that changes what the controller does because of what it believes of the plant, and when it claims that.

A claim is what the rule says or does where it believes in a fault: on a clean plant each is false, with three
exceptions. A shared machine may have given all that it can (valves of a drawn house take 1.6 times its heat). Sensors
of drawn houses are late by up to a quarter of an hour: it is false to say that one is more than twice as late as it is.
And the guard acts on what is read, which is true: it is wrong only where the week would have been better without it, as
a plan may rightly leave a room cold before a day of sun. What is learned continuously and claims nothing (margins,
offset, the return of a model that was adapted while the watch stood back) is counted with the rule that it belongs to.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Layout, PlanStatus
from thermoforce_mpc.live.windows import steep_falls
from thermoforce_mpc.loop.closed_loop import RunResult
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.rooms.house import DrawnHouse, full_capacity_W

_UNUSED, _STEP_S = "unused_capacity", 900.0
# Share of a shared machine from which what is left unused is a claim.
_LEFT = 0.02
# Share of its capacity from which a heat pump gave all of it in a block.
_ALL = 0.98


@dataclass(frozen=True)
class ControlledWeek:
    """A week of the controller: the model it was built with (or why there was none), the run, and doubts of units.

    `actuation`: how it runs the machine and why, in words; `fixed`: whether that has a fixed loss indeed.
    """

    model: ThermalModel | str
    result: RunResult
    doubts: tuple[str, ...] = ()
    actuation: str = ""
    fixed: bool = False

    @property
    def first_s(self) -> float:
        """When it began, s since 1 January."""
        return self.result.steps[0].time_s

    def day(self, time_s: float) -> str:
        """A time of the run, for people."""
        return f"day {(time_s - self.first_s) / DAY_S:.2f}"

    def news(self, *words: str) -> list[str]:
        """News of plans that hold one of `words`."""
        told = [(step.time_s, part) for step in self.result.steps for part in step.plan.news.split("; ")]
        return [f"{self.day(time_s)}: {part}" for time_s, part in told if any(word in part for word in words)]

    def notes(self, *words: str) -> list[str]:
        """Notes of the model's cards that hold one of `words`."""
        if isinstance(self.model, str):
            return []
        notes = dict.fromkeys(note for card in self.model.cards for note in card.notes)
        return [f"card: {note}" for note in notes if any(word in note for word in words)]

    def spells(self, status: PlanStatus) -> list[str]:
        """Stretches of steps in which `status` acted at an actuator, each by its first reason."""
        found, before = [], False
        for step in self.result.steps:
            acts = status in step.acting
            if acts and not before:
                found.append(f"{self.day(step.time_s)}: {step.plan.why[:160]}")
            before = acts
        return found

    def reasons(self, *words: str) -> list[str]:
        """Stretches of steps whose reason holds one of `words`."""
        found, before = [], False
        for step in self.result.steps:
            holds = any(word in step.plan.why for word in words)
            if holds and not before:
                found.append(f"{self.day(step.time_s)}: {step.plan.why[:160]}")
            before = holds
        return found

    def steep_falls(self) -> list[str]:
        """Falls of a room that would count as an open window at a real building."""
        layout = getattr(self.model, "layout", None)
        samples = [one for step in self.result.steps for one in step.samples]
        if layout is None or not samples:
            return []
        ends_s = np.array([self.first_s, *(one.start_s + one.duration_s for one in samples)])
        grid_s = np.arange(ends_s[0], ends_s[-1] + 1.0, _STEP_S)

        def sampled(values: Sequence[float]) -> Array:
            return np.interp(grid_s, ends_s, values)

        T_out_C = sampled([samples[0].T_out_C, *(one.T_out_C for one in samples)])
        levels = np.nan_to_num([one.u_measured for one in samples]).T * np.array(layout.signs)[:, None]
        given = np.cumsum(np.diff(ends_s) * levels, axis=1)
        u = np.array([np.diff(sampled([0.0, *row])) / _STEP_S for row in given])
        found = []
        for z, zone in enumerate(layout.names.zones):
            T_C = sampled([self.result.steps[0].T_zone_C[z], *(one.T_zone_C[z] for one in samples)])
            steep, _ = steep_falls(T_C, T_out_C, u[list(layout.actuators_of(z))], _STEP_S)
            found += [f"{self.day(grid_s[k])}: {zone} fell {T_C[k] - T_C[k + 1]:.2f} K" for k in np.flatnonzero(steep)]
        return found

    def claimed_lag_s(self) -> float:
        """How late the latest zone sensor is said to be, s; 0 where none is."""
        late = () if isinstance(self.model, str) else self.model.late_sensors
        return max((found.lag_s for found in late if found is not None), default=0.0)

    def gave_all(self, house: DrawnHouse) -> bool:
        """Whether the heat pump of a house of rooms gave all that it can in some block."""
        pump = house.heat_pump

        def most_W(T_out_C: float) -> float:
            return full_capacity_W(pump.capacity_W, pump.capacity_per_K, house.design_out_C, T_out_C)

        samples = (one for step in self.result.steps for one in step.samples)
        return any(float(np.sum(one.heat_W)) > _ALL * most_W(one.T_out_C) for one in samples)

    def left_unused(self) -> list[str]:
        """The first step with a share of a shared machine that plans leave unused."""
        layout = getattr(self.model, "layout", None)
        shared = [m for m in range(len(layout.names.machines)) if len(layout.fed_by(m)) > 1] if layout else []
        for step in self.result.steps:
            unused = step.plan.margins.get(_UNUSED)
            share = max((float(unused[m]) for m in shared), default=0.0) if unused is not None else 0.0
            if share > _LEFT:
                return [f"{self.day(step.time_s)}: {share:.0%} of a machine is left unused"]
        return []


@dataclass(frozen=True)
class Detector:
    """A rule: what it `changes`, its `claims` in a run, and the options without it.

    `controller`: of the controller, `shared`: instead of these where actuators share a machine, `identification`: of
    the identification. `live`: it acts in `thermoforce_mpc/live` alone, where the plant says so. Without any it cannot
    be turned off, or only says something. `on_readings`: it believes in no fault, only in what is read; on a clean
    plant it is wrong where the week would have been better without it.
    """

    name: str
    changes: str
    claims: Callable[[ControlledWeek], list[str]]
    controller: Mapping[str, Any] = field(default_factory=dict)
    shared: Mapping[str, Any] = field(default_factory=dict)
    identification: Mapping[str, Any] = field(default_factory=dict)
    on_readings: bool = False
    live: bool = False

    @property
    def can_be_off(self) -> bool:
        """Whether there is a run without it."""
        return bool(self.controller or self.identification or self.live)

    def options(self, layout: Layout) -> Mapping[str, Any]:
        """The controller's options without it, for actuators as `layout` has them."""
        shares = any(len(fed) > 1 for fed in layout.actuators_of_machines)
        return self.shared if shares and self.shared else self.controller


RULES: tuple[Detector, ...] = (
    Detector(
        "sun on a sensor",
        "readings, in identification and control; length of the probing",
        lambda ran: ran.notes("stands in the sun") + ran.news("sun on the zone sensor", "stands in the sun"),
        identification={"sun_on_sensor": False},
    ),
    Detector(
        "late sensor",
        "readings of a room that is heated, in identification and control",
        lambda ran: ran.notes("the zone sensor reads the room"),
        identification={"late_sensor": False},
    ),
    Detector(
        "air through windows",
        "steps that explain no effect, and what forecasts expect of such steps",
        lambda ran: ran.notes("air came in"),
        identification={"air_through_windows": False},
    ),
    Detector(
        "hours of the day",
        "hours that plans do without, or in which acting does less; what the watch expects; hours that probing tries",
        lambda ran: [
            told
            for words in ("whatever is asked for", "of what it does else")
            for told in ran.notes(words) + ran.news(words)
        ],
        controller={"watch": {"blocked_hours": False}},
    ),
    Detector(
        "other load",
        "power and heat that laws are fitted to; what the watch takes for a fault of the machine",
        lambda ran: ran.notes("the meter holds another load") + ran.news("another load, no fault"),
        identification={"foreign_loads": False},
    ),
    Detector(
        "fixed part",
        "blocks at one level instead of levels that are held",
        lambda ran: [ran.actuation] if "fixed part" in ran.actuation and "blocks" in ran.actuation else [],
        controller={"actuation": {"mode": "modulating"}},
        shared={"actuation": {"mode": "modulating", "lowest_level": 0.0}},
    ),
    Detector(
        "shared machine at its limit",
        "share of a machine's capacity that plans leave unused",
        ControlledWeek.left_unused,
        controller={"unused_capacity": False},
    ),
    Detector(
        "watch",
        "who acts: native control or the rule; afterwards an adapted model",
        lambda ran: ran.spells(PlanStatus.WATCH),
        controller={"watch": {"enabled": False}},
    ),
    Detector(
        "rule's levels",
        "levels of a plan: the on/off rule's",
        lambda ran: ran.reasons("the on/off rule's levels act"),
    ),
    Detector(
        "gate",
        "who acts, for the whole run",
        lambda ran: [ran.model] if isinstance(ran.model, str) else ran.spells(PlanStatus.GATE)[:1],
        controller={"gate": {"enabled": False}},
    ),
    Detector(
        "guard",
        "full level or off",
        lambda ran: ran.spells(PlanStatus.GUARD),
        controller={"guard": {"enabled": False}},
        on_readings=True,
    ),
    Detector(
        "zone sensor",
        "readings that are not believed",
        lambda ran: ran.reasons("zone temperature", "zone sensor does", "reading of the zone"),
        controller={"sensor": {"enabled": False}},
    ),
    Detector(
        "meters and weather sensors",
        "readings that are not believed",
        lambda ran: ran.reasons("rejected", "not believed", "stuck"),
        controller={"meter": {"enabled": False}},
    ),
    Detector("units", "nothing: it says so", lambda ran: list(ran.doubts)),
    # A week of a clean plant goes on as if it had not claimed anything.
    Detector(
        "open window",
        "bounds and readings of a room, for half an hour at a time",
        ControlledWeek.steep_falls,
        live=True,
    ),
)
"""All of them, in the order of a step."""
