"""Random offices in `tf-mpc bench buildings`: is a band that begins at 6:00 reached in time, and at what cost?

Offices are light, of several zones, and stand unused at night (`plants.rooms.house.OFFICE`). Beside the default
configuration run thermostats whose machine is off from the end of the office hours until 6:00 or some hours before: one
starts at 6:00, one two hours earlier, and one as early as it needs to be as comfortable as the controller.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from controllers.registry import build_controller
from thermoforce_mpc.comparison.outcome import Target
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.experiment.equal_comfort import ALLOWED_KH
from thermoforce_mpc.experiment.identifying import chosen_of, identification_task, run_identification
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.model.screening import limits_of
from thermoforce_mpc.plants.drawn_houses import WEEKS
from thermoforce_mpc.plants.people import OFFICE_HOURS
from thermoforce_mpc.plants.rooms import HouseOfRooms, house_of_rooms
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.testcase import TestCase

CONTROLLER, THERMOSTAT, NATIVE = "thermoforce_mpc", "thermostat", "native"
# Hours before 6:00 at which a thermostat starts; the first is the setback's, the second two hours earlier.
_LEADS_H = (0, 2, 3, 4, 5, 6)
# A thermostat on the wall reacts within minutes. At the package's default step of 15 min it overshoots in light houses,
# costs more and is less comfortable: too easy a baseline.
THERMOSTAT_STEP_S = 300.0
_ROOMS = (3, 5)
# Targets: discomfort over that of the setback that ends at 6:00, and cost over that of one two hours earlier.
_DISCOMFORT, _COST = 0.1, 1.0

Kpis = Mapping[str, float]
Row = dict[str, Any]


@dataclass(frozen=True)
class OfficeCase:
    """One office and week: its name, see `house_of_rooms`."""

    name: str
    week: str


@dataclass(frozen=True)
class OfficeOutcome:
    """KPIs of the controller, of native control, and of thermostats by their lead, h.

    `statuses`: plans of the controller by status; `failed`: the reason where there is one.
    """

    case: OfficeCase
    words: str
    ours: Kpis
    native: Kpis
    thermostats: Mapping[int, Kpis]
    statuses: Mapping[str, int]
    failed: str = ""
    seconds: float = 0.0

    @property
    def as_comfortable(self) -> int | None:
        """Lead of the cheapest thermostat whose discomfort is at most ours + 0.1 K·h, h; None where there is none."""
        enough = [h for h, kpis in self.thermostats.items() if kpis["tdis_tot"] <= self.ours["tdis_tot"] + ALLOWED_KH]
        return min(enough, key=lambda h: self.thermostats[h]["cost_tot"], default=None)

    @property
    def saving(self) -> float:
        """Cost saved at equal comfort, as a share; NaN where no thermostat is as comfortable."""
        lead = None if self.failed else self.as_comfortable
        return float("nan") if lead is None else 1.0 - self.ours["cost_tot"] / self.thermostats[lead]["cost_tot"]

    def row(self) -> Row:
        """Table row: cost EUR/m² and discomfort K·h."""
        row: Row = {"office": self.case.name, "week": self.case.week.removesuffix("_week"), "in words": self.words}
        if self.failed:
            return row | {CONTROLLER: self.failed}
        lead = self.as_comfortable
        return row | {
            CONTROLLER: _figures(self.ours),
            "thermostat from 6:00": _figures(self.thermostats[0]),
            "from 4:00": _figures(self.thermostats[2]),
            "as comfortable": "–" if lead is None else f"{_figures(self.thermostats[lead])} from {6 - lead}:00",
            "saving": f"{self.saving:.1%}" if np.isfinite(self.saving) else "–",
            NATIVE: _figures(self.native),
            "plans": ", ".join(f"{name} {n}" for name, n in self.statuses.items() if n),
        }


def run_offices(
    offices: int, seed: int, engine: Engine, progress: Callable[[str], None], keep: Path | None = None
) -> list[OfficeOutcome]:
    """Run offices of a population `seed` on both weeks; outcomes in their order. Finished ones are kept in `keep`."""
    rooms = np.random.default_rng([seed, 7]).integers(_ROOMS[0], _ROOMS[1] + 1, offices)
    cases = [
        OfficeCase(f"office:{n}rooms:{100 * seed + index}", week) for index, n in enumerate(rooms) for week in WEEKS
    ]

    def on_done(n: int, value: Mapping[str, Any]) -> None:
        outcome = outcome_of(value)
        row = outcome.row()
        figures = f"{row[CONTROLLER]}, saving {row['saving']}" if not outcome.failed else f"FAILED, {outcome.failed}"
        progress(f"[{n}/{len(cases)}] {outcome.case.name}, {outcome.case.week}, {outcome.seconds:.0f} s: {figures}")

    return [outcome_of(value) for value in run_all(run_as_json, cases, engine, on_done, keep)]


def run_as_json(case: OfficeCase) -> dict[str, Any]:
    """`run_office` as JSON, see `outcome_of`."""
    value = asdict(run_office(case))
    return value | {"thermostats": {str(lead_h): kpis for lead_h, kpis in value["thermostats"].items()}}


def outcome_of(value: Mapping[str, Any]) -> OfficeOutcome:
    """The outcome that `run_as_json` wrote."""
    thermostats = {int(lead_h): kpis for lead_h, kpis in value["thermostats"].items()}
    return OfficeOutcome(**{**value, "thermostats": thermostats, "case": OfficeCase(**value["case"])})


def run_office(case: OfficeCase) -> OfficeOutcome:
    """Probe, identify and run the controller, then what stands beside it; a failure is recorded."""
    began, plant, testcase = time.perf_counter(), house_of_rooms(case.name), load_testcase(case.name)
    try:
        try:
            scenario = Scenario(testcase=case.name, period=case.week)
            model: Any = run_identification(identification_task(scenario, chosen_of(scenario, testcase)), plant)
        except DataError as error:
            model = str(error)
        ours = _follow(plant, testcase, case.week, CONTROLLER, {}, model)
        native = _follow(plant, testcase, case.week, NATIVE, {})
        thermostats = {
            lead: _follow(plant, testcase, case.week, THERMOSTAT, _setback(plant, lead)).kpis for lead in _LEADS_H
        }
    except Exception as error:  # recorded as failure of this case; the others continue
        failed = f"{type(error).__name__}: {error}"
        return OfficeOutcome(case, plant.house.words, {}, {}, {}, {}, failed, time.perf_counter() - began)
    return OfficeOutcome(
        case,
        plant.house.words,
        ours.kpis,
        native.kpis,
        thermostats,
        ours.fallback_levels(),
        seconds=time.perf_counter() - began,
    )


def office_targets(outcomes: Sequence[OfficeOutcome]) -> list[Target]:
    """Discomfort against the setback from 6:00, cost against that from 4:00, and saving at equal comfort."""
    done = [o for o in outcomes if not o.failed]
    missed = sum(o.ours["tdis_tot"] > _DISCOMFORT * o.thermostats[0]["tdis_tot"] for o in done)
    costs = [o.ours["cost_tot"] / o.thermostats[2]["cost_tot"] for o in done]
    colder = median([o.thermostats[2]["tdis_tot"] - o.ours["tdis_tot"] for o in done])
    savings = [o.saving for o in done if np.isfinite(o.saving)]
    return [
        Target("office weeks that failed", float(len(outcomes) - len(done)), 0.0),
        Target("office weeks with more than a tenth of the discomfort of a setback until 6:00", float(missed), 0.0),
        Target(
            f"offices: median cost over that of a setback until 4:00, which leaves {colder:.1f} K·h more (median)",
            median(costs),
            _COST,
        ),
        Target(f"offices: median saving at equal comfort, {len(savings)} weeks", median(savings), 0.0, "at least"),
    ]


def median(values: Sequence[float]) -> float:
    """Median of some values, NaN of none."""
    return statistics.median(values) if values else float("nan")


def _follow(
    plant: HouseOfRooms, testcase: TestCase, week: str, name: str, options: Mapping[str, Any], model: Any = None
) -> RunResult:
    controller = build_controller(name, options, testcase, model)
    allowed, u_min = limits_of(controller, testcase.area_m2), testcase.layout.u_min
    return run_closed_loop(plant, controller, plant.period(week), allowed=allowed, u_min=u_min)


def _setback(plant: HouseOfRooms, lead_h: int) -> dict[str, Any]:
    """Options of a thermostat that is off from the end of the office hours to `lead_h` before they begin."""
    begin, end = OFFICE_HOURS
    return {
        "setpoints_C": dict(zip(plant.actuators, plant.thermostat_C.tolist(), strict=True)),
        "step_s": THERMOSTAT_STEP_S,
        "setback": {"from_hour": end, "to_hour": begin - lead_h, "weekend_days": ()},
    }


def _figures(kpis: Kpis) -> str:
    return f"{kpis['cost_tot']:.3f} / {kpis['tdis_tot']:.2f}"
