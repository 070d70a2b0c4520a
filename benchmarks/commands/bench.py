"""`tf-mpc bench commands`: houses whose heat pump and valves only take commands, controlled by them.

A drawn house of rooms has a heat pump behind its own controller: heating curve and hysteresis, minimum times,
defrosting, hot water that comes first, on the same meter (`thermoforce_mpc.plants.rooms.device`). It is set in one of
six ways: by the rooms' set-points (thermostats), by that of one thermostat in the largest room, which switches all of
the house, or, where the rooms follow the water and thermostats only keep them from becoming too warm, by the curve's
offset, by SG-Ready, by the flow temperature or by an enable contact. It lives for 30 days, the last three of them with
polite trials: another value of the command for some hours. Heat is not metered. From this record a model and the maps
are learned; then cold days are run twice, left alone and by planned commands, at a dynamic tariff, and the house of
set-points once more with valves that take levels directly, beside which the other ways of the same house stand too. No
room is asked to be warmer than its own thermostat keeps it, so that comfort is equal where a machine is too small. What
the first plan of each day said that it would save is compared with what it saves: the house as it stands then is lived
through the plan's horizon twice, by all its commands and left alone. That is done with thermostats as they are and with
some that are off by a tenth of a kelvin, and the mean counts: a thermostat that switches every seven hours is at
another turn after two days, which costs more or less by chance (house 9725 left alone after a plan by SG-Ready and
without one: 10.9 and 11.6 kWh in two days, 16.7 and 16.7 in three, 2026-11-30). Four days left alone follow each, and
count: what heat that is left or missing in house and tank is worth, the house says itself. A price for it does not: at
the mean cost of the rooms' heat, which holds hot water and standby, four plans of 9508 by SG-Ready saved 57 % of what
it cost left alone, and 26 % with those days (2026-11-29).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.commands.command import Command
from thermoforce_mpc.commands.contacts import Enable, SGReady
from thermoforce_mpc.commands.heating_curve import CurveOffset, FlowTemperature
from thermoforce_mpc.commands.loop import CommandRecord, LearnedCommand, check_told, learn_command, on_one_water
from thermoforce_mpc.commands.setpoint import Setpoint
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import (
    DAY_S,
    HOUR_S,
    Array,
    Block,
    Boundary,
    HeldCommand,
    Observation,
    Plan,
    Record,
    energy_kWh,
)
from thermoforce_mpc.data.series import step_means
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.loop.closed_loop import advanced
from thermoforce_mpc.plants.rooms import house_of_rooms
from thermoforce_mpc.plants.rooms.device import NORMAL, draw_device
from thermoforce_mpc.plants.rooms.house import curve_supply_C
from thermoforce_mpc.plants.rooms.plant import native_setpoints_C

Row = dict[str, Any]

ROOMS = 3
KINDS = ("set-points", "curve offset", "SG-Ready", "flow temperature", "enable", "set-point of the house")
# Ways in which thermostats keep the rooms.
_THERMOSTATS = (KINDS[0], KINDS[5])
# Those that are run where none are named: each costs a house a month of record and its days, some minutes of a core.
USUAL_KINDS = KINDS[:3]
# Day of the year on which control begins; ordinary operation and polite trials before it, days.
_START, _ORDINARY, _TRIALS = 36, 27, 3
# Trials: a temperature or an offset that is higher or lower by so much, K, or another state, each for so long, h.
_AWAY: dict[str, tuple[tuple[float, ...], int]] = {
    "set-points": ((-1.0, 0.0, 1.0), 4),
    "curve offset": ((-3.0, 0.0, 3.0), 4),
    "SG-Ready": ((1.0, 2.0, 3.0), 2),
    "flow temperature": ((-3.0, 0.0, 3.0), 4),
    "enable": ((0.0, 1.0, 1.0), 2),
    "set-point of the house": ((-1.0, 0.0, 1.0), 4),
}
# Where rooms follow the curve, thermostats stand above what they keep elsewhere, K, and the curve is moved by at most
# so much until the neediest room is as warm as there, looked at over so many days, with so many halvings.
_ABOVE_K, _LOWEST_CURVE_K, _CURVE_DAYS, _HALVINGS = 0.5, -10.0, 6, 5
# What is set at the machine when it is left alone, where that is always the same; least and most flow temperature, °C:
# what the water of drawn houses is within, whose circuits keep limits of their own.
_USUAL, _FLOW_C = {"curve offset": 0.0, "SG-Ready": float(NORMAL), "enable": 1.0}, (20.0, 60.0)
_STEP_S, _HORIZON_H, _PART_S = HOUR_S, 24.0, 900.0
# How long a house is left alone after a plan or days of them, s: a plan of 9725 by SG-Ready saved .51 of 1.23 with two
# days, .34 with three, .32 with four and .30 with seven, one of 9712 by set-points .70, .71, .66 and .69 of 5.11
# (2026-11-30). Houses in which a plan is judged, and by how much their thermostats differ, K: as much as their sensors.
_AFTER_S = 4.0 * DAY_S
_COPIES, _APART_K = 4, 0.1
# A plan may leave rooms outside their bounds by so much more than the house itself, K·h in a week.
_MORE_KH = 0.5
# When a tank is charged is chance, and no room is warm meanwhile: the house left alone is lived again with its tank's
# target moved by so much, K, in the first hours. With a tank 2 or 4 K off at the beginning house 9712 is 1.8 to 3.2 K·h
# a week colder than it was (by plans of SG-Ready 1.4 to 2.4), 9717 up to 0.6, 9703 and 9719 not at all (2026-11-30).
_MOVED_K, _MOVED_H = (-4.0, -2.0, 2.0, 4.0), 6
# Costs that differ by less, as a share, are equal; what is said where no model may act.
_EQUAL, _NO_MODEL = 1e-6, "left alone: no model may act"


@dataclass(frozen=True)
class DaysLived:
    """What days cost, in currency, and their energy, kWh; `after`: the cost of those after them, `left_alone_cost`."""

    cost: float
    energy_kWh: float
    after: float

    def saved_by(self, other: DaysLived) -> float:
        """Share of the cost that `other` saves, with what it saves or costs in the days after."""
        return (self.cost + self.after - other.cost - other.after) / self.cost


@dataclass(frozen=True)
class Lived(DaysLived):
    """And K·h below and above the bounds of all rooms."""

    below_Kh: float
    above_Kh: float


def run_commands_bench(
    *,
    engine: Engine,
    houses: int = 6,
    seed: int = 100,
    days: int = 7,
    kinds: Sequence[str] = USUAL_KINDS,
    quick: bool = False,
    keep: Path | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """`days` of `houses` drawn from `seed` on, set in each way of `kinds`; `quick`: one house for two days.

    Finished cases are kept in the folder `keep`, so that a run that was cut off goes on.
    """
    cases = [(seed + k, kind, 2 if quick else days) for k in range(1 if quick else houses) for kind in kinds]

    def told(done: int, row: Row) -> None:
        progress(f"{done} of {len(cases)}: {row['house']} by {row['by']} {row['note'] or ''}")

    rows = with_direct(run_all(run_house, cases, engine, told, keep))
    return results_json("commands", rows, targets(rows))


def with_direct(rows: Sequence[Row]) -> list[Row]:
    """`rows` with what levels of its valves save in the same house where set-points are not what is set.

    That is a share of what the house costs with its thermostats: levels of valves are the same whatever is set.
    """
    direct = {row["house"]: row["saved_direct"] for row in rows if row.get("saved_direct") is not None}
    return [row | {"saved_direct": direct.get(row["house"])} if "saved" in row else row for row in rows]


def run_house(case: tuple[int, str, int]) -> Row:
    """One house: the record, the model, and days as it is left alone and with planned commands."""
    seed, kind, days = case
    home = Home(seed, kind)
    row: Row = {"house": home.plant.house.name, "by": kind, "note": ""}
    set_to = home.live(seed)
    try:
        model = identify(home.record(900.0), config=IdentificationConfig(), layout=home.plant.layout)
        over_K = None if kind == "set-points" else home.water_over_rooms_K(_STEP_S)
        set_to = np.append(set_to, set_to[:, -1:], axis=1)
        commands = learned(home.record(_STEP_S), kind, set_to, over_K, home.plant.reference)
    except DataError as error:
        return row | {"note": f"refused: {str(error)[:200]}"}
    fit = [card.competence is not None and card.competence.competent for card in model.cards]
    row |= {
        "competent": f"{sum(fit)} of {len(fit)}",
        "map_r2": float(np.mean([one.loop.r2 for one in commands.values()])),
    }
    config = MPCConfig(step_s=_STEP_S, horizon_h=_HORIZON_H)
    kept_C = left_alone_C(copy.deepcopy(home), days)
    own, _ = _days(copy.deepcopy(home), None, days, kept_C)
    direct = None
    if kind == "set-points":
        direct, _ = _days(copy.deepcopy(home), ThermoForceMPC(model, config), days, kept_C, levels=True)
    by_chance = [_days(copy.deepcopy(home), None, days, kept_C, moved_K=moved_K)[0].below_Kh for moved_K in _MOVED_K]
    planned, said = _days(home, ThermoForceMPC(model, config, commands=commands), days, kept_C)
    if said["not_acting"] == 24.0 * days:
        row["note"] = _NO_MODEL
    return row | {
        # Per week, more than left alone.
        "colder_Kh": (planned.below_Kh - own.below_Kh) * 7.0 / days,
        "colder_by_chance_Kh": (float(np.mean(by_chance)) - own.below_Kh) * 7.0 / days,
        "cost_own": own.cost,
        "cost_planned": planned.cost,
        "cost_direct": direct and direct.cost,
        "saved": own.saved_by(planned),
        "saved_direct": direct and own.saved_by(direct),
        "energy_own_kWh": own.energy_kWh,
        "energy_planned_kWh": planned.energy_kWh,
        "below_own_Kh": own.below_Kh,
        "below_planned_Kh": planned.below_Kh,
        "below_direct_Kh": direct and direct.below_Kh,
        "above_own_Kh": own.above_Kh,
        "above_planned_Kh": planned.above_Kh,
        "days": days,
        "changes_a_day": said["changes"] / days,
        "not_planned": said["not_planned"] / days / 24.0,
        "not_acting": said["not_acting"] / days / 24.0,
        # Of the first plans of all days, as shares of what the house costs over their horizons when it is left alone.
        "said": said["said"] / max(said["cost_alone"], 1e-9),
        "came_true": said["came_true"] / max(said["cost_alone"], 1e-9),
        "in_band": said["in_band"] / max(said["judged"], 1.0),
        "band": said["band"] / max(said["cost_alone"], 1e-9),
        "judged": said["judged"],
    }


class Home:
    """A drawn house behind its heat pump's controller, and what is set there: the commands of `kind`."""

    def __init__(self, seed: int, kind: str) -> None:
        self.kind, self.plant = kind, house_of_rooms(f"house:{ROOMS}rooms:{seed}")
        # The room of the thermostat of the house, where it has one.
        self._lead: int | None = None
        self.plant.device = draw_device(self.plant.house)
        self._curve_K, self._over_K = 0.0, np.ones(ROOMS)
        # By how much its thermostats are off (Z,), K.
        self.dials_K = np.zeros(ROOMS)
        if kind == "set-point of the house":
            self._lead = int(np.argmax([room.area_m2 for room in self.plant.house.rooms]))
            self.plant.reference = self.plant.zones[self._lead]
        if kind not in _THERMOSTATS:
            self._curve_K = self._tuned_curve_K()

    def own_setpoints_C(self, time_s: Array) -> Array:
        """What the thermostats are set to when they are left alone, (Z, n), °C."""
        if self.kind not in _THERMOSTATS:
            return self._wanted_C(time_s) + _ABOVE_K
        return self._in_all_rooms(native_setpoints_C(self.plant.house, time_s))

    def _in_all_rooms(self, of_rooms: Array) -> Array:
        """What thermostats of the rooms (Z, ...) have, in each that of the house where it has one."""
        return of_rooms if self._lead is None else np.repeat(of_rooms[self._lead : self._lead + 1], ROOMS, axis=0)

    def _wanted_C(self, time_s: Array) -> Array:
        """What thermostats of its own would keep rooms at while they are used (Z, n), °C."""
        return np.repeat(self._most_C[:, None], time_s.size, axis=1)

    @cached_property
    def _most_C(self) -> Array:
        """The highest set-point of a week that people have in each room (Z,), °C."""
        week_s = DAY_S * _START + HOUR_S * np.arange(7 * 24.0)
        return np.asarray(native_setpoints_C(self.plant.house, week_s).max(axis=1))

    def usual(self, time_s: Array) -> Array:
        """What the commands are when they are left alone (Z, n)."""
        if self.kind in _THERMOSTATS:
            return self.own_setpoints_C(time_s)
        of_machine = self._flow_C(time_s) if self.kind == "flow temperature" else _USUAL[self.kind]
        return of_machine * np.ones((ROOMS, time_s.size))

    def _flow_C(self, time_s: Array) -> Array:
        """Whole °C that the warmest circuit's heating curve asks for at `time_s` (n,)."""
        house = self.plant.house
        asked_C = [
            [
                curve_supply_C(c.design_C, c.exponent, c.shift_K + self._curve_K, c.limit_C, house.design_out_C, T_C)
                for c in (house.curves[room.emitter] for room in house.rooms)
            ]
            for T_C in self.plant.weather.at("T_dry_C", time_s).tolist()
        ]
        return np.round(np.max(asked_C, axis=1)).clip(*_FLOW_C)

    def advance(self, command: tuple[Any, ...], seconds: float) -> Any:
        """Let it live under commands, None: what is usual."""
        now = np.array([self.plant.forecast(_STEP_S, _STEP_S).time_s[0]])
        told = [usual if one is None else one for one, usual in zip(command, self.usual(now)[:, 0], strict=True)]
        setpoints_C = self.own_setpoints_C(now)[:, 0].tolist()
        self.plant.curve_offset_K, self.plant.contact = self._curve_K, NORMAL
        if self.kind in _THERMOSTATS:
            setpoints_C = told
        elif self.kind == "curve offset":
            self.plant.curve_offset_K += told[0]
        elif self.kind == "flow temperature":
            self.plant.curve_offset_K, self.plant.flow_target_C = 0.0, told[0]
        elif self.kind == "enable":
            self.plant.is_enabled = told[0] >= 0.5
        else:
            self.plant.contact = round(told[0])
        set_C = np.asarray(setpoints_C) + self._in_all_rooms(self.dials_K)
        return self.plant.advance(None, seconds, tuple(set_C.tolist()))

    def move_tank(self, more_K: float) -> None:
        """Its tank is charged to `more_K` above its device's target from now on; 0: to that."""
        assert self.plant.device is not None  # `__init__` gives it one
        self.plant.tank_target_C = self.plant.device.tank_C + more_K if more_K else None

    def live(self, seed: int) -> Array:
        """Let it live left alone, at last with trials; what its commands were in all hours (Z, n)."""
        self.plant.reset((_START - _ORDINARY - _TRIALS) * DAY_S, DAY_S)
        rng, away = np.random.default_rng(seed), np.zeros(ROOMS)
        values, hold_h = _AWAY[self.kind]
        n = round((_ORDINARY + _TRIALS) * 24)
        out = np.empty((ROOMS, n))
        for k in range(n):
            now = np.array([self.plant.forecast(_STEP_S, _STEP_S).time_s[0]])
            told = self.usual(now)[:, 0]
            if k >= _ORDINARY * 24:
                if k % hold_h == 0:
                    away = rng.choice(values, ROOMS if self.kind == "set-points" else 1) * np.ones(ROOMS)
                told = away if self.kind in ("SG-Ready", "enable") else told + away
            self.advance(tuple(told.tolist()), HOUR_S)
            out[:, k] = told
        if self.kind != "set-points":
            over = self.water_over_rooms_K(HOUR_S)
            self._over_K = np.maximum(np.nanpercentile(over, 99.0, axis=1), 1.0)
        return out

    def record(self, step_s: float) -> Record:
        """What a home's logger has: no heat; level is valve times water over room but with a thermostat in each."""
        record = self.plant.past(step_s)
        u = record.u
        if self.kind != "set-points":
            u = np.clip(u * self.water_over_rooms_K(step_s) / self._over_K[:, None], 0.0, 1.0)
        return replace(record, u=u, heat_W=np.full_like(record.heat_W, np.nan))

    def water_over_rooms_K(self, step_s: float) -> Array:
        """What the water of each circuit, behind its mixer, is above its room (Z, n), K."""
        record = self.plant.past(step_s)
        T_C = step_means(record.T_zone_C)
        return np.maximum(self.plant.flow_C(record.time_s) - T_C, 0.0)

    def _tuned_curve_K(self) -> float:
        """The shift of the curve with which the neediest room is as warm as with a thermostat of its own."""
        low, high = _LOWEST_CURVE_K, 2.0
        begin_s = (_START - _CURVE_DAYS) * DAY_S
        for _ in range(_HALVINGS):
            self._curve_K = 0.5 * (low + high)
            self.plant.reset(begin_s, DAY_S)
            for _ in range(round(_CURVE_DAYS * 4)):
                self.advance((None,) * ROOMS, 6 * HOUR_S)
            record = self.plant.past(HOUR_S)
            last = slice(-24 * (_CURVE_DAYS - 2), None)
            over_K = (record.T_zone_C - self._wanted_C(record.time_s))[:, last].mean(axis=1)
            low, high = (low, self._curve_K) if float(over_K.min()) > 0.0 else (self._curve_K, high)
        return self._curve_K


def learned(
    record: Record, kind: str, set_to: Array, over_K: Array | None, reference: str | None = None
) -> dict[str, LearnedCommand]:
    """The commands of a house, by name of the valve, from a record and what was set at its last boundaries (Z, m).

    `over_K` (Z, n): what the water is above the rooms; None where levels are not made of it. `reference`: the room of
    the thermostat of the house, where it has one.
    """
    out: dict[str, LearnedCommand] = {}
    record, shared = record.last(set_to.shape[1] - 1), kind != "set-points"
    names = record.names.actuators
    over = [None if over_K is None else over_K[a, -record.n_steps :] for a in range(len(names))]
    each = {name: CommandRecord(set_to[a], set_to[a, :-1], over_K=over[a]) for a, name in enumerate(names)}
    if shared:
        each = on_one_water(each, dict(zip(names, record.u, strict=True)))
    for a, (name, was) in enumerate(each.items()):
        room = a if reference is None else record.names.zones.index(reference)
        signals = record.T_zone_C[room], record.T_out_C, record.u[a], record.time_s
        command = _command(kind, name, reference)
        out[name] = learn_command(command, was, *signals, f"{kind} of {name}", may_be_untold=True)
        if room != a:
            out[name] = replace(out[name], reference=record.names.zones[room])
        if shared:
            out[name] = replace(out[name], machine="heat_pump", record=record, set_to=was.mean)
            if kind in _USUAL:  # what else it is the record tells
                out[name] = replace(out[name], usual=np.full_like(out[name].usual, _USUAL[kind]))
    check_told(out.values())
    return out


def _command(kind: str, name: str, reference: str | None) -> Command:
    if kind in _THERMOSTATS:
        return Setpoint(kind="setpoint", column=name if reference is None else "setpoint", reference=reference)
    if kind == "curve offset":
        return CurveOffset(kind="curve_offset", column="offset")
    if kind == "flow temperature":
        return FlowTemperature(kind="flow_temperature", column="flow", minimum=_FLOW_C[0], maximum=_FLOW_C[1])
    if kind == "enable":
        return Enable(kind="enable", column="enabled")
    return SGReady(kind="sg_ready", column="contact")


def left_alone_C(home: Home, days: int) -> Array:
    """Temperatures of the rooms at the ends of all hours of `days` and one horizon more, left alone, (Z, n), °C."""
    hours = round(24 * days + _HORIZON_H) + 1
    return np.stack([home.advance((None,) * ROOMS, HOUR_S).T_zone_C for _ in range(hours)], axis=1)


def _days(
    home: Home,
    controller: ThermoForceMPC | None,
    days: int,
    kept_C: Array,
    *,
    levels: bool = False,
    moved_K: float = 0.0,
) -> tuple[Lived, dict[str, float]]:
    """Days under planned commands (or levels), or left alone without a `controller`; and what the plans said.

    At equal comfort: no room is asked to be warmer than it is when left alone (`kept_C`, see `left_alone_C`).
    `moved_K`: of the tank's target in the first hours.
    """
    plant = home.plant
    state = None
    keys = ("said", "came_true", "cost_alone", "in_band", "band", "judged", "changes", "not_planned", "not_acting")
    said = dict.fromkeys(keys, 0.0)
    cost = energy = below = above = 0.0
    before: tuple[Any, ...] = ()
    for k in range(round(days * DAY_S / _STEP_S)):
        ahead = priced(plant.forecast(_HORIZON_H * HOUR_S, _STEP_S))
        kept = kept_C[:, k : k + ahead.time_s.size - 1]
        ahead = replace(ahead, lower_C=np.minimum(ahead.lower_C, np.column_stack([kept[:, :1], kept])))
        blocks: tuple[Block, ...] = (Block.native(ROOMS, _STEP_S),)
        if controller is not None:
            plan = controller.plan(Observation(home.record(_STEP_S), ahead), state)
            state, blocks = plan.state, plan.blocks
            said["not_planned"] += all(one is None for one in blocks[0].told)
            said["not_acting"] += plan.saving is None
            if k % 24 == 0 and not levels and plan.saving is not None and plan.saving.gain > 0.0:
                saved, cost_alone = came_true(home, plan, ahead)
                said["said"] += plan.saving.saved
                said["came_true"] += saved
                said["cost_alone"] += cost_alone
                said["in_band"] += plan.saving.low <= saved <= plan.saving.high
                said["band"] += plan.saving.high - plan.saving.low
                said["judged"] += 1.0
        home.move_tank(moved_K if k < _MOVED_H else 0.0)
        for now in blocks:
            done = advanced(plant, now) if levels else home.advance(now.command, now.duration_s)
            seconds = now.duration_s
            if controller is not None:
                told = now.command if home.kind == "set-points" else now.command[:1]
                said["changes"] += sum(a != b for a, b in zip(told, before, strict=True)) if before else 0.0
                before = told
            used = energy_kWh(float(done.power_W[0]), seconds)
            energy, cost = energy + used, cost + used * float(ahead.price_per_kWh[0, 0])
            # The bounds of the hour; of its end, a room that others set back may already be let cool.
            below += float(np.maximum(ahead.lower_C[:, :2].min(axis=1) - done.T_zone_C, 0.0).sum()) * seconds / HOUR_S
            above += float(np.maximum(done.T_zone_C - ahead.upper_C[:, :2].max(axis=1), 0.0).sum()) * seconds / HOUR_S
    return Lived(cost, energy, left_alone_cost(home), below, above), said


def left_alone_cost(home: Home) -> float:
    """What the four days from now on cost when the house is left alone, currency; `home` lives through them."""
    cost, begin_s = 0.0, float(home.plant.forecast(_STEP_S, _STEP_S).time_s[0])
    at_s = np.arange(begin_s, begin_s + _AFTER_S - 1.0, _STEP_S)
    for price in price_per_kWh(at_s).tolist():
        cost += energy_kWh(float(home.advance((None,) * ROOMS, _STEP_S).power_W[0]), _STEP_S) * price
    return cost


def came_true(home: Home, plan: Plan, ahead: Boundary) -> tuple[float, float]:
    """What all commands of a plan save from now on, and what its horizon costs when the house is left alone, currency.

    With the days after it, see `left_alone_cost`; the mean of houses whose thermostats differ by `_APART_K`.
    """
    rng = np.random.default_rng(round(ahead.time_s[0]))
    cost, after = np.zeros((_COPIES, 2)), np.zeros((_COPIES, 2))
    for k in range(_COPIES):
        dials_K = rng.normal(0.0, _APART_K if k else 0.0, ROOMS)
        for i, planned in enumerate((True, False)):
            lived = copy.deepcopy(home)
            lived.dials_K = dials_K
            for at_s in np.arange(ahead.time_s[0], ahead.time_s[-1] - 1.0, _PART_S).tolist():
                told = (_told(of, at_s) if planned else None for of in plan.settings)
                done = lived.advance(tuple(told), _PART_S)
                at = int(np.searchsorted(ahead.time_s, at_s, side="right")) - 1
                cost[k, i] += energy_kWh(float(done.power_W[0]), _PART_S) * float(ahead.price_per_kWh[0, at])
            after[k, i] = left_alone_cost(lived)
    planned_cost, alone = cost.mean(axis=0)
    return float(alone - planned_cost + after[:, 1].mean() - after[:, 0].mean()), float(alone)


def _told(commands: Sequence[HeldCommand], at_s: float) -> float | None:
    return next((one.value for one in commands if one.start_s <= at_s < one.end_s), None)


def priced(ahead: Boundary) -> Boundary:
    """A forecast with the prices of `price_per_kWh`."""
    return ahead.at_prices(np.atleast_2d(price_per_kWh(ahead.time_s)))


def price_per_kWh(time_s: Array) -> Array:
    """A day-ahead price of two peaks, 0.12 to 0.36 per kWh."""
    hour = time_s / HOUR_S % 24.0
    peaks = 0.14 * np.exp(-(((hour - 8.0) / 2.0) ** 2)) + 0.18 * np.exp(-(((hour - 18.5) / 2.2) ** 2))
    return np.asarray(0.18 + peaks - 0.06 * np.exp(-(((hour - 13.0) / 2.0) ** 2)))


def targets(rows: list[Row]) -> list[Target]:
    """Cheaper at equal comfort in nine of ten houses, by each kind; median savings, by commands and by levels."""
    out: list[Target] = []
    for kind in (one for one in KINDS if any(row["by"] == one for row in rows)):
        of_kind = [row for row in rows if row["by"] == kind]
        known = [row for row in of_kind if "saved" in row]
        # A house left alone, or of which nothing was learned, is none that is cheaper.
        cheaper = sum(row["saved"] > _EQUAL for row in known) / max(len(of_kind), 1)
        alone = np.mean([float(row["note"] == _NO_MODEL) for row in of_kind] or [1.0])
        more_Kh = [row["colder_Kh"] - row["colder_by_chance_Kh"] for row in known]
        colder = np.mean([float(more > _MORE_KH) for more in more_Kh] or [1.0])
        median = float(np.median([row["saved"] for row in known] or [np.nan]))
        direct = [row["saved_direct"] for row in known if row["saved_direct"] is not None]
        out += [
            Target(
                f"{kind}: share of houses of which nothing could be learned",
                1.0 - len(known) / max(len(of_kind), 1),
                0.1,
            ),
            Target(f"{kind}: share of houses left alone, since no model may act", float(alone), 0.1),
            Target(f"{kind}: share of houses that cost less than left alone", float(cheaper), 0.9, "at least"),
            Target(
                f"{kind}: share of houses that are colder by more than 0.5 K·h a week than by chance",
                float(colder),
                0.0,
            ),
            Target(f"{kind}: median share saved", median, 0.0, "at least"),
            Target(
                f"{kind}: median share saved by levels of the valves of the same houses",
                float(np.median(direct or [np.nan])),
                0.0,
                "at least",
            ),
        ]
    judged = [row for row in rows if row.get("judged")]
    plans = max(sum(row["judged"] for row in judged), 1.0)
    held = sum(row["in_band"] * row["judged"] for row in judged) / plans
    width = float(np.median([row["band"] for row in judged] or [np.nan]))
    return [
        *out,
        Target("share of plans whose saving lay in the 90 % band that they gave", held, 0.85, "at least"),
        # A band that holds everything helps nobody: its width stands beside it.
        Target("median width of these bands, as a share of the cost left alone", width, 0.15),
    ]
