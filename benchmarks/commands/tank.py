"""`tf-mpc bench hot-water`: houses whose heat pump heats rooms or a tank of hot water.

The houses of `bench commands` that take set-points of their rooms. Their tank has a logger of its own: temperature to
half a kelvin and the meter of the heat pump every five minutes; what it is is learned from the 28 days before. Then the
same cold days are lived left alone, with the target of the tank planned and the rooms left to their thermostats, and
with their set-points planned too. The tank is wanted as warm by day as the device keeps it, see `wanted`. Four days
left alone follow and count, as in `bench commands`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from benchmarks.commands.bench import DaysLived, Home, learned, left_alone_C, left_alone_cost, priced
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.commands.tank import TankRecord, TankTarget, learn_tank
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Block, Observation, Record, energy_kWh
from thermoforce_mpc.data.series import means_between
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.plants.rooms import physics
from thermoforce_mpc.plants.rooms.device import TANK_BAND
from thermoforce_mpc.scenario.comfort import TankComfort

Row = dict[str, Any]

# Step of the tank's record, s, resolution of its sensor, K, and days of it.
_TANK_STEP_S, _SENSOR_K, _TANK_DAYS = 300.0, 0.5, 28
_STEP_S, _HORIZON_H = HOUR_S, 24.0
# Draw-off takes a tank below the band before the machine has heated it; what less is wanted at night, K.
_BELOW_BAND_K, _LESS_AT_NIGHT_K = 1.0, 4.0
# A plan may leave rooms or tank outside their bounds by so much more than the house itself, K·h in a week.
_MORE_KH = 0.5


def wanted(home: Home) -> TankComfort:
    """What is wanted of the tank, °C: by day as warm as the device keeps it on its own, at night somewhat less."""
    assert home.plant.device is not None
    least_C = home.plant.device.tank_C - float(home.plant.device.parameters[TANK_BAND]) - _BELOW_BAND_K
    return TankComfort(schedule=f"6:00-23:00 {least_C:.1f}-58, else {least_C - _LESS_AT_NIGHT_K:.1f}-58")


@dataclass(frozen=True)
class LivedWithTank(DaysLived):
    """And K·h below the bounds of rooms and tank."""

    rooms_below_Kh: float
    tank_below_Kh: float


def run_tank_bench(
    *,
    engine: Engine,
    houses: int = 4,
    seed: int = 300,
    days: int = 3,
    rooms: bool = True,
    quick: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """`days` of `houses` drawn from `seed` on; `rooms`: also with their set-points; `quick`: one house for a day."""
    cases = [(seed + k, 1 if quick else days, rooms) for k in range(1 if quick else houses)]

    def told(done: int, row: Row) -> None:
        progress(f"{done} of {len(cases)}: {row['house']} {row['note'] or ''}")

    rows = run_all(run_house, cases, engine, told)
    return results_json("hot-water", rows, targets(rows))


def run_house(case: tuple[int, int, bool]) -> Row:
    """One house: what is learned of it, and days in three ways."""
    seed, days, rooms = case
    home = Home(seed, "set-points")
    row: Row = {"house": home.plant.house.name, "people": home.plant.house.people, "note": ""}
    set_to = home.live(seed)
    try:
        tank = replace(learn_tank(_tank_record(home), _command(), "heat_pump", "tank"), comfort=wanted(home))
        record = without_tank(home.record(900.0), _tank_record(home))
        model = identify(record, config=IdentificationConfig(), layout=home.plant.layout)
        commands = learned(home.record(_STEP_S), "set-points", np.append(set_to, set_to[:, -1:], axis=1), None)
    except DataError as error:
        return row | {"note": f"refused: {str(error)[:200]}"}
    config = MPCConfig(step_s=_STEP_S, horizon_h=_HORIZON_H)
    kept = left_alone_C(copy.deepcopy(home), days)
    own, _ = _days(copy.deepcopy(home), None, days, kept)
    row |= {"days": days, "cost_own": own.cost, "tank_below_own_Kh": own.tank_below_Kh}
    for name in ("tank", "both")[: 1 + rooms]:
        planned = name == "both"
        controller = ThermoForceMPC(model, config, commands=commands if planned else {}, hot_water=tank)
        found, told = _days(copy.deepcopy(home), controller, days, kept, rooms=planned)
        row |= {
            f"saved_{name}": own.saved_by(found),
            f"energy_{name}": found.energy_kWh / own.energy_kWh,
            f"rooms_colder_{name}_Kh": found.rooms_below_Kh - own.rooms_below_Kh,
            f"tank_below_{name}_Kh": found.tank_below_Kh,
            f"changes_a_day_{name}": told["tank_changes"] / days,
            f"solves_{name}": told["solves"],
        }
    return row


def _command() -> TankTarget:
    return TankTarget(kind="tank_target", column="target")


def _tank_record(home: Home) -> TankRecord:
    """What the tank's logger has of the days until now."""
    plant = home.plant
    now_s = float(plant.forecast(_STEP_S, _STEP_S).time_s[0])
    at_s = np.arange(now_s - _TANK_DAYS * DAY_S, now_s + 1.0, _TANK_STEP_S)
    time_s, rows = plant.recorded(float(at_s[0]), float(at_s[-1]))
    target = plant.device.tank_C if plant.device is not None else float("nan")
    return TankRecord(
        time_s=at_s,
        T_C=np.round(np.interp(at_s, time_s, rows[:, physics.TANK]) / _SENSOR_K) * _SENSOR_K,
        T_out_C=np.interp(at_s, time_s, rows[:, physics.OUTDOOR]),
        command=np.full(at_s.size, target),
        power_W=means_between(time_s, rows[1:, physics.POWER], at_s),
        charging=np.full(at_s.size - 1, np.nan),
        clock_s=at_s,
    )


def without_tank(record: Record, tank: TankRecord) -> Record:
    """The record without the power of steps in which the tank was charged, as `read_measurements` has it."""
    share = tank.share_of(record.time_s)
    return replace(record, power_W=np.where(share > 0.02, np.nan, record.power_W))


def _days(
    home: Home, controller: ThermoForceMPC | None, days: int, kept_C: Array, rooms: bool = True
) -> tuple[LivedWithTank, dict[str, float]]:
    """Days left alone, without a `controller`, or under its target and, with `rooms`, set-points; and what it set."""
    plant, state, comfort = home.plant, None, wanted(home)
    plans_tank = controller is not None and controller.hot_water is not None
    cost = energy = below = tank_below = 0.0
    told = {"tank_planned": 0.0, "solves": 0.0, "tank_changes": 0.0}
    last = None
    for k in range(round(days * DAY_S / _STEP_S)):
        ahead = priced(plant.forecast(_HORIZON_H * HOUR_S, _STEP_S))
        kept = kept_C[:, k : k + ahead.time_s.size - 1]
        ahead = replace(ahead, lower_C=np.minimum(ahead.lower_C, np.column_stack([kept[:, :1], kept])))
        turns, target = [Block.native(len(plant.layout.names.actuators), _STEP_S)], None
        if controller is not None:
            record, now = home.record(_STEP_S), (float("nan"), False)
            if plans_tank:
                logged = _tank_record(home)
                now, record = logged.now(), without_tank(record, logged)
            plan = controller.plan(Observation(record, ahead, *now), state)
            state, turns = plan.state, list(plan.blocks) if rooms else turns
            if plan.hot_water is not None:
                target = plan.hot_water.command[0]
                told["tank_planned"] += target is not None
                told["solves"] += plan.hot_water.solves
        plant.tank_target_C = target
        told["tank_changes"] += target != last
        last = target
        for one in turns:
            done, seconds = home.advance(one.command, one.duration_s), one.duration_s
            used = energy_kWh(float(done.power_W[0]), seconds)
            energy, cost = energy + used, cost + used * float(ahead.price_per_kWh[0, 0])
            lower_C = ahead.lower_C[:, :2].min(axis=1)
            below += float(np.maximum(lower_C - done.T_zone_C, 0.0).sum()) * seconds / HOUR_S
        time_s, T_C = plant.tank_C(float(ahead.time_s[0]), float(ahead.time_s[1]))
        wanted_C = comfort.bounds_C(time_s, ("tank",), "monday")[0][0]
        tank_below += float(np.maximum(wanted_C - T_C, 0.0).mean())
    n = days * DAY_S / _STEP_S
    told["solves"] /= n
    plant.tank_target_C = None
    return LivedWithTank(cost, energy, left_alone_cost(home), below, tank_below), told


def targets(rows: list[Row]) -> list[Target]:
    """Cheaper than left alone, at no less comfort of rooms and tank."""
    known = [row for row in rows if not row["note"]]
    out = [Target("share of houses of which nothing could be learned", 1.0 - len(known) / max(len(rows), 1), 0.1)]
    for name in ("tank", "both"):
        of = [row for row in known if f"saved_{name}" in row]
        if not of:
            continue
        colder = [
            max(row[f"rooms_colder_{name}_Kh"], row[f"tank_below_{name}_Kh"] - row["tank_below_own_Kh"])
            * 7.0
            / row["days"]
            for row in of
        ]
        out += [
            Target(
                f"{name}: median share saved", float(np.median([row[f"saved_{name}"] for row in of])), 0.0, "at least"
            ),
            Target(
                f"{name}: share of houses whose rooms or tank are colder by more than 0.5 K·h a week",
                float(np.mean([one > _MORE_KH for one in colder])),
                0.0,
            ),
        ]
    return out
