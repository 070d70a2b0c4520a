"""`tf-mpc bench saving --mode worth`: what `tf-mpc worth` says that plans would have saved, beside what they save.

A drawn house of rooms lives by its own thermostats; heat is not measured. From four weeks of it a model is identified,
and the days after are lived through again by `worth`. The truth is the house itself, run through these days once more
under the same controller, asked for the same comfort: what it then costs, with two days of its own control after it for
what is stored.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from benchmarks.effects.operated import as_homes_measure
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Observation, Period, Plan
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.experiment.worth import Raised, as_comfortable, worth
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.plants.rooms import HouseOfRooms, house_of_rooms
from thermoforce_mpc.protocols import Controller

Row = dict[str, Any]

ROOMS = 3
# Days that a model is identified from, that are lived through again, and after which what is stored has gone.
BEFORE_DAYS, _AFTER_DAYS = 28, 2
_STARTS = (36, 64, 330)
_PRICE, _HORIZON_H = "highly_dynamic", 24.0
_HOLDS = 0.85


@dataclass(frozen=True)
class WorthCase:
    """House `number` of a population, how many days of it and drawn houses; `gate`: whether a model must be competent.

    Without the gate plans act on whatever was identified, so that the band is judged for all houses.
    """

    seed: int
    number: int
    days: int
    houses: int
    gate: bool


def run_would_save_bench(
    *,
    engine: Engine,
    n: int = 20,
    seed: int = 7,
    days: int = 3,
    houses: int = 6,
    gate: bool = False,
    quick: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Run the houses 0 to `n` − 1 of population `seed`; `quick`: one house, one day."""
    cases = [WorthCase(seed, k, 1 if quick else days, 2 if quick else houses, gate) for k in range(1 if quick else n)]

    def told(done: int, row: Row) -> None:
        band = "refused" if row["refused"] else f"{row['saved']:+.2f} ({row['low']:+.2f} to {row['high']:+.2f})"
        progress(f"{done} of {len(cases)}: {row['house']}: {band}, true {row['true']}")

    rows = run_all(run_worth_case, cases, engine, told)
    return results_json("saving", rows, worth_targets(rows))


def run_worth_case(case: WorthCase) -> Row:
    """One house: what is said and what is true."""
    name = f"house:{ROOMS}rooms:{1000 * case.seed + case.number}"
    plant = house_of_rooms(name, people=1000 * case.seed + case.number)
    start_s = _STARTS[case.number % len(_STARTS)] * DAY_S
    row: Row = {"house": plant.house.name, "refused": "", **dict.fromkeys(_FIGURES)}
    scored_s, warmup_s = case.days * DAY_S, BEFORE_DAYS * DAY_S
    plant.reset(start_s - warmup_s, 0.0, _PRICE)
    conditions = plant.forecast(warmup_s + scored_s, HOUR_S)
    plant.reset(start_s + scored_s, warmup_s + scored_s, _PRICE)
    record = as_homes_measure(plant.past(900.0))
    record = record.last(round((warmup_s + scored_s) / 900.0))
    before = record.slice(0, round(warmup_s / 900.0))
    try:
        config = IdentificationConfig(modulation="linear", sun_on_sensor=False)
        model = identify(before, layout=plant.layout, config=config)
        # Levels are held, as valves do that are set by hand.
        settings = {"step_s": HOUR_S, "horizon_h": _HORIZON_H, "gate": {"enabled": case.gate}}
        controller = ThermoForceMPC(model, MPCConfig.model_validate(settings))
        error = ForecastError("medium", "medium", case.number)
        hourly = record.resample(4)
        of_record = _at(conditions, hourly.time_s)
        found = worth(
            model, hourly, of_record, controller,
            start_s=start_s, days=case.days, draws=case.houses, error=error, seed=case.number,
        )  # fmt: skip
    except DataError as refused:
        return row | {"refused": str(refused)[:200]}
    own = _lived(plant, start_s, warmup_s, scored_s, None)
    asked = Raised(found.raised_K).of_bounds(as_comfortable(of_record, hourly))
    planned = _lived(plant, start_s, warmup_s, scored_s, _Asked(controller, asked))
    true = own[0] - planned[0]
    return row | {
        "competent": sum(not card.unfit for card in model.cards),
        "saved": found.saved,
        "low": found.low,
        "high": found.high,
        "true": round(true, 3),
        "cost_was": found.cost_was,
        "true_cost_was": own[0],
        "outside_Kh": found.outside_Kh,
        "true_outside_Kh": planned[1],
        "outside_was_Kh": found.outside_was_Kh,
        "holds": bool(found.low <= true <= found.high),
    }


_FIGURES = ("saved", "low", "high", "true", "holds")


class _Asked:
    """A controller that is asked for other bounds than its plant's: those of `asked`, as long as these are known."""

    def __init__(self, controller: ThermoForceMPC, asked: Boundary) -> None:
        self._controller, self._asked = controller, asked
        self.name, self.step_s, self.horizon_s = controller.name, controller.step_s, controller.horizon_s

    def plan(self, observation: Observation, state: object = None) -> Plan:
        boundary, asked = observation.boundary, self._asked
        row = np.round((boundary.time_s - asked.time_s[0]) / asked.step_s).astype(np.intp)
        known, row = row < asked.time_s.size, np.minimum(row, asked.time_s.size - 1)
        bounds = {
            name: np.where(known, getattr(asked, name)[:, row], getattr(boundary, name))
            for name in ("lower_C", "upper_C")
        }
        return self._controller.plan(replace(observation, boundary=replace(boundary, **bounds)), state)


def _at(conditions: Boundary, time_s: Array) -> Boundary:
    """Bounds and prices at the boundaries of a record, which begins where they do or a step later."""
    first = round((time_s[0] - conditions.time_s[0]) / conditions.step_s)
    at = slice(first, first + time_s.size)
    values = {name: getattr(conditions, name)[..., at] for name in _CONDITIONS}
    return replace(conditions, **values)


_CONDITIONS = (
    "time_s", "T_out_C", "solar_W_m2", "occupancy", "lower_C", "upper_C", "price_per_kWh", "emission_kg_per_kWh",
    "heating_price_per_kWh",
)  # fmt: skip


def _lived(
    plant: HouseOfRooms, start_s: float, warmup_s: float, scored_s: float, controller: Controller | None
) -> tuple[float, float]:
    """Cost of the days, and of those after by the house's own control; K·h outside the bounds in all rooms."""
    if controller is None:
        plant.reset(start_s, warmup_s, _PRICE)
        plant.advance(None, scored_s)
    else:
        run_closed_loop(plant, controller, Period("worth", start_s, scored_s, warmup_s), _PRICE)
    kpis = plant.kpis()
    outside_Kh = sum(value for name, value in kpis.items() if name.startswith("tdis_tot["))
    plant.advance(None, _AFTER_DAYS * DAY_S)
    cost = plant.kpis()["cost_tot"] * plant.house.floor_area_m2
    return float(cost), float(outside_Kh)


def worth_targets(rows: list[Row]) -> list[Target]:
    """Bands hold, and how wide they are."""
    known = [row for row in rows if not row["refused"]]
    held = float(np.mean([row["holds"] for row in known])) if known else float("nan")
    widths = [(row["high"] - row["low"]) / 2.0 / max(row["cost_was"], 1e-9) for row in known] or [float("nan")]
    return [
        Target(f"worth: share of {len(known)} houses whose 90 % band holds the true saving", held, _HOLDS, "at least"),
        Target(f"worth: houses answered, of {len(rows)}", len(known), 0.9 * len(rows), "at least"),
        Target("worth: half-width of the band over the cost, median", float(np.median(widths)), 0.15),
    ]
