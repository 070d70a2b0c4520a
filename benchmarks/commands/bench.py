"""`tf-mpc bench commands`: houses whose heat pump and valves only take set-points, controlled by them.

A drawn house of rooms has a heat pump on a heating curve and a thermostat with hysteresis in each room. It is run by
its own set-points, with a few days of polite trials (another set-point in a room for some hours). From this record a
model and the maps from set-point to level are learned; then a week is run twice, by the house's own set-points and by
planned ones, at a dynamic tariff, and once more with valves that take levels directly, by the same model: what is
lost by commands. What each plan said that it would save is compared with what all of them saved.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.commands.loop import CommandRecord, LearnedCommand, learn_command
from thermoforce_mpc.commands.setpoint import Setpoint
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S, J_PER_KWH, Array, Boundary, Observation, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.loop.closed_loop import advanced
from thermoforce_mpc.plants.rooms import HouseOfRooms, house_of_rooms
from thermoforce_mpc.plants.rooms.schedule import native_setpoints_C

Row = dict[str, Any]

ROOMS = 3
# Day of the year on which control begins; ordinary operation and polite trials before it, and control, days.
_START, _ORDINARY, _TRIALS, _DAYS = 36, 25, 3, 7
# Trials: a set-point that is higher or lower by so much, K, for so long, h.
_AWAY_K, _TRIAL_H = (-1.0, 0.0, 1.0), 4
_STEP_S, _HORIZON_H = HOUR_S, 24.0
# A plan may leave rooms outside their bounds by so much more than the house itself, K·h in a week.
_MORE_KH = 0.5


@dataclass(frozen=True)
class WeekOfHouse:
    """What a week cost, in currency, its energy, kWh, and K·h below and above the bounds of all rooms."""

    cost: float
    energy_kWh: float
    below_Kh: float
    above_Kh: float


def run_commands_bench(
    *,
    engine: Engine,
    houses: int = 6,
    seed: int = 100,
    quick: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Weeks of `houses` drawn from `seed` on; `quick`: one house for two days."""
    cases = [(seed + k, 2 if quick else _DAYS) for k in range(1 if quick else houses)]

    def told(done: int, row: Row) -> None:
        progress(f"{done} of {len(cases)}: {row['house']} {row['note'] or ''}")

    rows = run_all(run_house, cases, engine, told)
    return results_json("commands", rows, targets(rows))


def run_house(case: tuple[int, int]) -> Row:
    """One house: the record, the model, and a week with its own and with planned set-points."""
    seed, days = case
    plant = house_of_rooms(f"house:{ROOMS}rooms:{seed}")
    row: Row = {"house": plant.house.name, "note": ""}
    setpoints = _lived(plant, seed)
    record = plant.past(_STEP_S)
    usual = np.append(setpoints, setpoints[:, -1:], axis=1)
    try:
        model = identify(plant.past(900.0), config=IdentificationConfig(), layout=plant.layout)
        commands = learned(record, usual)
    except DataError as error:
        return row | {"note": f"refused: {str(error)[:200]}"}
    fit = [card.competence is not None and card.competence.competent for card in model.cards]
    row |= {
        "competent": f"{sum(fit)} of {len(fit)}",
        "map_r2": float(np.mean([one.loop.r2 for one in commands.values()])),
    }
    config = MPCConfig(step_s=_STEP_S, horizon_h=_HORIZON_H, gate={"enabled": any(fit)})
    own, _ = _week(copy.deepcopy(plant), None, days)
    direct, _ = _week(copy.deepcopy(plant), ThermoForceMPC(model, config), days)
    planned, said = _week(plant, ThermoForceMPC(model, config, commands=commands), days)
    return row | {
        "cost_own": own.cost,
        "cost_planned": planned.cost,
        "cost_direct": direct.cost,
        "saved": 1.0 - planned.cost / own.cost,
        "saved_direct": 1.0 - direct.cost / own.cost,
        "energy_own_kWh": own.energy_kWh,
        "energy_planned_kWh": planned.energy_kWh,
        "below_own_Kh": own.below_Kh,
        "below_planned_Kh": planned.below_Kh,
        "below_direct_Kh": direct.below_Kh,
        "above_own_Kh": own.above_Kh,
        "above_planned_Kh": planned.above_Kh,
        "changes_a_day": said["changes"] / days / ROOMS,
        "said": said["saved"] / max(said["cost_alone"], 1e-9),
    }


def learned(record: Record, setpoints_C: Array) -> dict[str, LearnedCommand]:
    """The commands of the rooms' thermostats, by name, from a record and set-points at its boundaries (Z, n + 1)."""
    out = {}
    for a, name in enumerate(record.names.actuators):
        was = CommandRecord(setpoints_C[a], setpoints_C[a, :-1])
        command = Setpoint(kind="setpoint", column=name)
        out[name] = learn_command(
            command, was, record.T_zone_C[a], record.T_out_C, record.u[a], record.time_s, f"set-point of {name}"
        )
    return out


def _lived(plant: HouseOfRooms, seed: int) -> Array:
    """Let a house live by its own set-points, at last with trials; the set-points of all hours (Z, n), °C."""
    begin_s = (_START - _ORDINARY - _TRIALS) * DAY_S
    plant.reset((_START - _TRIALS) * DAY_S, _ORDINARY * DAY_S)
    hours: Array = begin_s + HOUR_S * np.arange(round((_ORDINARY + _TRIALS) * 24), dtype=np.float64)
    setpoints = native_setpoints_C(plant.house, hours)
    rng, away = np.random.default_rng(seed), np.zeros(len(setpoints))
    for k in range(_ORDINARY * 24, hours.size):
        if k % _TRIAL_H == 0:
            away = rng.choice(_AWAY_K, len(setpoints))
        setpoints[:, k] += away
        plant.advance(None, HOUR_S, tuple(setpoints[:, k].tolist()))
    return setpoints


def _week(plant: HouseOfRooms, controller: ThermoForceMPC | None, days: int) -> tuple[WeekOfHouse, dict[str, float]]:
    """A week under planned set-points, or under its own without a `controller`; and what the plans said."""
    state, said = None, {"saved": 0.0, "cost_alone": 0.0, "changes": 0.0}
    cost = energy = below = above = 0.0
    before: tuple[Any, ...] = ()
    for k in range(round(days * DAY_S / _STEP_S)):
        ahead = priced(plant.forecast(_HORIZON_H * HOUR_S, _STEP_S))
        blocks = None
        if controller is not None:
            plan = controller.plan(Observation(plant.past(_STEP_S), ahead), state)
            state, blocks = plan.state, plan.blocks
            if k % 24 == 0 and plan.saving is not None:
                said["saved"] += plan.saving.saved
                said["cost_alone"] += plan.saving.cost_alone
        for now in blocks or (None,):
            done = plant.advance(None, _STEP_S) if now is None else advanced(plant, now)
            seconds = _STEP_S if now is None else now.duration_s
            if now is not None:
                said["changes"] += sum(a != b for a, b in zip(now.command, before, strict=True)) if before else 0.0
                before = now.command
            used = float(done.power_W[0]) * seconds / J_PER_KWH
            bounds = plant.forecast(_STEP_S, _STEP_S)
            energy, cost = energy + used, cost + used * float(ahead.price_per_kWh[0, 0])
            below += float(np.maximum(bounds.lower_C[:, 0] - done.T_zone_C, 0.0).sum()) * seconds / HOUR_S
            above += float(np.maximum(done.T_zone_C - bounds.upper_C[:, 0], 0.0).sum()) * seconds / HOUR_S
    return WeekOfHouse(cost, energy, below, above), said


def priced(ahead: Boundary) -> Boundary:
    """A forecast with a day-ahead price of two peaks, 0.12 to 0.36 per kWh."""
    hour = ahead.time_s / HOUR_S % 24.0
    peaks = 0.14 * np.exp(-(((hour - 8.0) / 2.0) ** 2)) + 0.18 * np.exp(-(((hour - 18.5) / 2.2) ** 2))
    price = 0.18 + peaks - 0.06 * np.exp(-(((hour - 13.0) / 2.0) ** 2))
    return ahead.at_prices(np.atleast_2d(price))


def targets(rows: list[Row]) -> list[Target]:
    """Cheaper at equal comfort in nine of ten houses; median savings, by commands and by levels."""
    known = [row for row in rows if not row["note"]]
    dearer = np.mean([row["saved"] <= 0.0 for row in known] or [1.0])
    colder = np.mean([row["below_planned_Kh"] - row["below_own_Kh"] > _MORE_KH for row in known] or [1.0])
    return [
        Target("share of houses of which nothing could be learned", 1.0 - len(known) / max(len(rows), 1), 0.1),
        Target("share of houses that cost more than by their own set-points", float(dearer), 0.1),
        Target("share of houses that are colder by more than 0.5 K·h a week", float(colder), 0.0),
        *(
            Target(
                f"median share saved by {what}",
                float(np.median([row[key] for row in known] or [np.nan])),
                0.0,
                "at least",
            )
            for what, key in (("set-points", "saved"), ("levels of the valves themselves", "saved_direct"))
        ),
    ]
