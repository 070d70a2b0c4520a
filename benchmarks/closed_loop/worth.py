"""`tf-mpc bench worth`: what a free response is worth in closed loop, between linear weather and the true future.

The heat pump case and generated houses with people whom nobody announces: one model per building and window, then the
default controller with each free response and each length of history. The oracle (`free_response.oracle`) is the limit
of forecasts; plans still err in the effect of what they do, so a run with it may even lose. The watch is off: it hands
control to the plant's own where a free response keeps its band worse than promised, and no plan would be compared.
What is compared is what the controller minimises: energy cost, and discomfort at its default weight.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from benchmarks.free_response.oracle import oracles
from controllers.mpc.config import MPCConfig, ObjectiveConfig
from controllers.mpc.controller import ThermoForceMPC
from controllers.registry import controller_config
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.experiment.experiment import scored_period
from thermoforce_mpc.experiment.identifying import chosen_of, identification_task, model_for
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.model.free_response.registry import find_free_response
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.drawn_houses import WEEKS
from thermoforce_mpc.plants.registry import build_plant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.testcase import TestCase

HEAT_PUMP = "bestest_hydronic_heat_pump"
REFERENCE, DEFAULT, LIMIT = "linear_weather", "default", "oracle"
# Seed of the people, and of the population of houses; no training data knows either.
PEOPLE, POPULATION = 7, 2044
# The window and tariff in which forecasts once did harm.
SHARP = ("108", "highly_dynamic")
_CONTROLLER = "thermoforce_mpc"
_WEIGHT_PER_M2 = ObjectiveConfig().comfort_weight_per_m2
# Cost of a window that hardly heats: smaller ones are no measure of a difference.
_LEAST_COST_PER_M2 = 1e-3
# Goals of the default against linear weather: share of the oracle's gain, and what is lost nowhere.
_SHARE, _DEARER, _LESS_COMFORT_KH = 0.5, 0.003, 0.1

Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A building in one window.

    `people`: their seed, None where they keep to the schedule; `history_d`: days of the record that the controller
    gets, or up to one more; `free_responses`: registered names, `NAME:BACKBONE`, `default`, or `oracle`.
    """

    testcase: str
    window: str
    price: str
    people: int | None
    uncertainty: str
    days: float
    history_d: tuple[int, ...]
    free_responses: tuple[str, ...]


def run_worth_bench(
    *,
    windows: Sequence[str] = ("16", "44", "108"),
    houses: int = 4,
    days: float = 7.0,
    history_d: Sequence[int] = (1, 3),
    methods: Sequence[str] = (DEFAULT,),
    uncertainty: str = "none",
    engine: Engine,
    keep: Path | None = None,
    progress: Callable[[str], None] = lambda _line: None,
) -> Row:
    """Run every free response on every building and window, `REFERENCE`, `DEFAULT` and `LIMIT` always.

    Args:
        windows: start days of the heat pump case.
        houses: number of generated houses, two weeks each.
        days: scored days of a window.
        history_d: lengths of history, days.
        methods: further free responses, see `Case`.
        uncertainty: level of weather forecast errors in the heat pump case.
        engine: where the cases are run; the result does not depend on it.
        keep: folder in which finished cases are kept; a run that was cut off goes on from there.
        progress: callback for progress lines.
    """
    for name in methods:
        if name not in (DEFAULT, LIMIT):
            find_free_response(name.partition(":")[0])
    named = tuple(dict.fromkeys((REFERENCE, DEFAULT, *methods, LIMIT)))

    def case(testcase: str, window: str, price: str, people: int | None, errors: str = "none") -> Case:
        return Case(testcase, window, price, people, errors, days, tuple(history_d), named)

    cases = [case(HEAT_PUMP, window, "constant", PEOPLE, uncertainty) for window in windows]
    cases += [case(HEAT_PUMP, *SHARP, people, uncertainty) for people in (PEOPLE, None)]
    for index in range(houses):
        cases += [case(f"generated:{POPULATION}:{index}", week, "constant", PEOPLE) for week in WEEKS]

    def told(done: int, rows: list[Row]) -> None:
        progress(f"[{done}/{len(cases)}] " + (rows[0]["refused"] or f"{len(rows)} runs"))

    runs = [row for rows in run_all(run_case, cases, engine, told, keep) for row in rows]
    rows = with_shares([row for row in runs if not row["refused"]])
    refused = [{key: row[key] for key in ("building", "window", "refused")} for row in runs if row["refused"]]
    return results_json("worth", [*table(rows), *summary(rows), *refused], targets(rows))


def run_case(case: Case) -> list[Row]:
    """Run a case: a row per length of history and free response, or one that says why identification refused."""
    scenario = Scenario.model_validate(
        {
            "testcase": case.testcase,
            "plant": {"people": case.people, "forecast_uncertainty": case.uncertainty},
            "period": case.window,
            "days": case.days,
            "price": case.price,
        }
    )
    testcase = load_testcase(case.testcase)
    about = {"building": case.testcase, "window": case.window, "price": case.price, "people": case.people is not None}
    with closing(build_plant(scenario.plant, testcase, scenario.seed)) as plant:
        window = scored_period(plant, scenario.period, scenario.days)
        try:
            model = model_for(identification_task(scenario, chosen_of(scenario, testcase)), plant)
        except DataError as error:
            return [about | {"refused": str(error)}]
        rows = []
        for history_d in case.history_d:
            for name in case.free_responses:
                controller = controller_with(name, testcase, model, plant)
                run = run_closed_loop(plant, controller, window, case.price, record_days=float(history_d))
                rows.append(about | {"refused": "", "history": f"{history_d} d", "free response": name} | _scores(run))
        return rows


def controller_with(name: str, testcase: TestCase, model: ThermalModel, plant: Plant) -> ThermoForceMPC:
    """The default controller of `plant` without its watch and with the free response `name`, see `Case`."""
    method, _, backbone = name.partition(":")
    chosen: Row = {"name": method, "options": {"backbone": backbone} if backbone else {}}
    # Nothing may take the place of the truth, however strange it looks.
    option = {DEFAULT: {}, LIMIT: {"substitutes": False}}.get(name, chosen)
    options: Row = {"watch": {"enabled": False}} | ({"free_response": option} if option else {})
    config = controller_config(_CONTROLLER, options, testcase)
    assert isinstance(config, MPCConfig)
    return ThermoForceMPC(model, config, free_response=oracles(plant, model.operator) if name == LIMIT else None)


def _scores(run: RunResult) -> Row:
    """Cost per m², discomfort, what they are worth together, steps without a solution, and the time of a step."""
    cost, discomfort_Kh = run.kpis["cost_tot"], run.kpis["tdis_tot"]
    return {
        "cost": cost,
        "discomfort_Kh": discomfort_Kh,
        "both": cost + _WEIGHT_PER_M2 * discomfort_Kh,
        "not_solved": sum(n for status, n in run.fallback_levels().items() if status not in _SOUND),
        "step_ms": 1e3 * float(np.median([step.plan_seconds for step in run.steps])),
    }


_SOUND = ("solved", "bridged", "rule")
_WHERE = ("building", "window", "price", "people", "history")


def with_shares(runs: Sequence[Row]) -> list[Row]:
    """The runs, each with what it loses or gains against linear weather, and what the oracle gains there."""
    places = [tuple(row[key] for key in _WHERE) for row in runs]
    found = {(place, row["free response"]): row for place, row in zip(places, runs, strict=True)}
    rows = []
    for place, row in zip(places, runs, strict=True):
        reference, limit = found[place, REFERENCE], found[place, LIMIT]
        rows.append(
            {key: row[key] for key in (*_WHERE, "free response", "cost", "discomfort_Kh", "both")}
            | {
                "dearer": (row["cost"] - reference["cost"]) / max(reference["cost"], _LEAST_COST_PER_M2),
                "more_Kh": row["discomfort_Kh"] - reference["discomfort_Kh"],
                "gain": reference["both"] - row["both"],
                "oracle_gain": reference["both"] - limit["both"],
                "not_solved": row["not_solved"],
                "step_ms": row["step_ms"],
            }
        )
    return rows


def table(rows: Sequence[Row]) -> list[Row]:
    """A row per case and history: cost and discomfort of each free response, and its share of the oracle's gain."""
    lines: dict[tuple[Any, ...], Row] = {}
    for row in rows:
        line = lines.setdefault(tuple(row[key] for key in _WHERE), {key: row[key] for key in _WHERE})
        line[row["free response"]] = f"{row['cost']:.4f} / {row['discomfort_Kh']:.2f}"
        if row["free response"] not in (REFERENCE, LIMIT):
            line[f"{row['free response']}, share"] = _over([row])["share"]
    return list(lines.values())


def summary(rows: Sequence[Row]) -> list[Row]:
    """A row per free response and history: its gain over linear weather as a share of the oracle's, over all cases."""
    found = []
    for history in dict.fromkeys(row["history"] for row in rows):
        for name in dict.fromkeys(row["free response"] for row in rows):
            mine = [row for row in rows if (row["history"], row["free response"]) == (history, name)]
            found.append({"history": history, "free response": name, "cases": len(mine)} | _over(mine))
    return found


def targets(rows: Sequence[Row]) -> list[Target]:
    """Goals of the default against linear weather."""
    mine = [row for row in rows if row["free response"] == DEFAULT]
    if not mine:
        return []
    over = _over(mine)
    return [
        Target("default: share of the oracle's gain over linear weather", _number(over["share"]), _SHARE, "at least"),
        Target("default: cost above that with linear weather, worst case", over["dearer_worst"], _DEARER),
        Target("default: discomfort above, worst case, K·h", over["more_Kh_worst"], _LESS_COMFORT_KH),
    ]


def _number(share: float | None) -> float:
    return float("nan") if share is None else share


def _over(rows: Sequence[Row]) -> Row:
    """Sums and worst cases of rows of one free response; no share where the oracle gains nothing."""
    limit = sum(row["oracle_gain"] for row in rows)
    return {
        "share": sum(row["gain"] for row in rows) / limit if limit > 0.0 else None,
        "dearer_worst": max(row["dearer"] for row in rows),
        "more_Kh_worst": max(row["more_Kh"] for row in rows),
        "not_solved": sum(row["not_solved"] for row in rows),
        "step_ms": float(np.median([row["step_ms"] for row in rows])),
    }
