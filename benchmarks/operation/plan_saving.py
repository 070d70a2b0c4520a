"""`tf-mpc bench saving --mode plan`: what `tf-mpc plan` says that a plan in levels saves, beside what it saves.

A drawn house of rooms lives by its own thermostats for four weeks; heat is not measured. On the days after, each
day's plan is lived in the house itself, its valves held at its levels, and two days of its own control after it for
what is stored; and the same days by its own control alone. Weather is known ahead, people are not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from benchmarks.effects.operated import as_homes_measure
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Observation, energy_kWh
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.experiment.left_alone import saving_of_levels
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.plants.rooms import HouseOfRooms, house_of_rooms

Row = dict[str, Any]

ROOMS = (3, 4, 5)
"""Rooms of the houses, one after another."""
BEFORE_DAYS = 28
_STARTS, _AFTER_DAYS = (36, 60, 330, 48), 2
_PRICE, _HORIZON_H = "highly_dynamic", 24
_HOLDS, _WIDTH = 0.85, 0.2


@dataclass(frozen=True)
class PlanCase:
    """House `number` of a population, and on how many days it is planned."""

    seed: int
    number: int
    days: int


def run_plan_saving_bench(
    *,
    engine: Engine,
    n: int = 8,
    seed: int = 7,
    days: int = 3,
    quick: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Run the houses 0 to `n` − 1 of population `seed`; `quick`: one house, one day."""
    cases = [PlanCase(seed, k, 1 if quick else days) for k in range(1 if quick else n)]

    def told(done: int, rows: list[Row]) -> None:
        said = [row["refused"] or f"{row['saved']:+.2f} ({row['low']:+.2f} to {row['high']:+.2f})" for row in rows]
        true = [row["true"] for row in rows]
        progress(f"{done} of {len(cases)}: {rows[0]['house']}: {'; '.join(said)}, true {true}")

    rows = [row for found in run_all(run_plan_case, cases, engine, told) for row in found]
    return results_json("saving", rows, plan_targets(rows))


def run_plan_case(case: PlanCase) -> list[Row]:
    """One house: what is said and what is true of the plan of each day."""
    seed = 1000 * case.seed + case.number
    plant = house_of_rooms(f"house:{ROOMS[case.number % len(ROOMS)]}rooms:{seed}", people=seed)
    plant.reset(_STARTS[case.number % len(_STARTS)] * DAY_S, BEFORE_DAYS * DAY_S, _PRICE)
    before = as_homes_measure(plant.past(900.0).last(round(BEFORE_DAYS * DAY_S / 900.0)))
    row: Row = {"house": plant.house.name, "refused": "", **dict.fromkeys(_FIGURES)}
    try:
        config = IdentificationConfig(modulation="linear", sun_on_sensor=False)
        model = identify(before, layout=plant.layout, config=config)
    except DataError as refused:
        return [row | {"refused": str(refused)[:200]}]
    # Plans act on whatever was identified, so that the band is judged for all houses.
    off = {"enabled": False}
    settings = {"step_s": HOUR_S, "horizon_h": float(_HORIZON_H), "gate": off, "watch": off}
    controller = ThermoForceMPC(model, MPCConfig.model_validate(settings))
    rows = []
    for _ in range(case.days):
        history = as_homes_measure(plant.past(HOUR_S)).last(BEFORE_DAYS * 24)
        ahead = plant.forecast((_HORIZON_H + 24 * _AFTER_DAYS) * HOUR_S, HOUR_S)
        now, price = ahead.head(_HORIZON_H), ahead.price_per_kWh[0, :-1]
        plan = controller.plan(Observation(history, now))
        begin = plant.snapshot()
        own, of_day = lived(plant, None, price)
        after = row
        try:
            said = saving_of_levels(model, history, now, plan)
            plant.restore(begin)
            planned, _ = lived(plant, np.clip(plan.u, 0.0, 1.0), price)
            true = own - planned
            after = row | {
                "saved": said.saved,
                "low": said.low,
                "high": said.high,
                "true": round(true, 3),
                "cost_alone": said.cost_alone,
                "true_cost_alone": of_day,
                "holds": bool(said.low <= true <= said.high),
            }
        except DataError as refused:
            after = row | {"refused": str(refused)[:200]}
        rows.append(after)
        plant.restore(begin)
        plant.advance(None, DAY_S)
    return rows


_FIGURES = ("saved", "low", "high", "true", "holds")


def lived(plant: HouseOfRooms, u: Array | None, price: Array) -> tuple[float, float]:
    """Cost of a day at levels `u` (A, N), or by its own control, with the days after it, and that of the day alone."""
    if u is None:
        plant.advance(None, _HORIZON_H * HOUR_S)
    else:
        for levels in u.T:
            plant.advance(tuple(levels.tolist()), HOUR_S)
    plant.advance(None, _AFTER_DAYS * DAY_S)
    power_W = plant.past(HOUR_S).last(price.size).power_W[0]
    cost = energy_kWh(power_W, HOUR_S) * price
    return float(cost.sum()), float(cost[:_HORIZON_H].sum())


def plan_targets(rows: list[Row]) -> list[Target]:
    """Bands hold, how wide they are, and how often something is said."""
    known = [row for row in rows if not row["refused"]]
    held = float(np.mean([row["holds"] for row in known])) if known else float("nan")
    widths = [(row["high"] - row["low"]) / 2.0 / max(row["true_cost_alone"], 1e-9) for row in known] or [float("nan")]
    return [
        Target(f"plan: share of {len(known)} plans whose 90 % band holds the true saving", held, _HOLDS, "at least"),
        Target(f"plan: plans with a saving, of {len(rows)}", len(known), 0.5 * len(rows), "at least"),
        Target(
            "plan: half-width of the band over the cost of the day left alone, median", float(np.median(widths)), _WIDTH
        ),
    ]
