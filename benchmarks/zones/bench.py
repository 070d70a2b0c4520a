"""`tf-mpc bench zones`: the default configuration on buildings of several zones, beside two baselines and two rivals.

The rivals show what treating the zones together is worth: the same controller whose zones were identified without
effects across them, and one controller per zone (`zones.apart`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from benchmarks.closed_loop.boptest import verdict_in_words
from benchmarks.zones.apart import OnePerZone
from benchmarks.zones.effects import PairScore, score_pairs, within_limits, worst
from benchmarks.zones.scaling import BesideDoMpc, beside_do_mpc, exponent, solve_times
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import ConfigError, DataError, ThermoForceError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.experiment.experiment import Experiment, scored_period
from thermoforce_mpc.experiment.identifying import chosen_of, identification_task, run_identification
from thermoforce_mpc.experiment.run import run
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.registry import build_plant
from thermoforce_mpc.plants.rooms.plant import HouseOfRooms
from thermoforce_mpc.plants.testcases import load_scenario

CONTROLLER, BASELINES = "thermoforce_mpc", ("native", "thermostat")
# The same controller with zones identified without effects across them, and one controller per zone.
WITHOUT, PER_ZONE = "without cross-effects", "one per zone"
# Windows by building: two cold and a mild one; the office, which is cooled too, has a hot one.
HOUSE, OFFICE, APARTMENT = "house:5rooms", "energyplus:small_office", "twozone_apartment_hydronic"
_WINDOWS = {
    HOUSE: ("cold_week", "24", "sunny_week"),
    OFFICE: ("peak_heat_day", "cold_day", "mix_day", "peak_cool_day"),
    APARTMENT: ("peak_heat_day", "typical_heat_day"),
}
_DAYS = {HOUSE: 7.0, OFFICE: 7.0, APARTMENT: 14.0}
_QUICK_DAYS = 2.0
# Days of probing: all of them, whatever the verdict.
_PROBING_DAYS = 3.0
# Discomfort that counts as none, K·h per zone, and goals of the solve time: exponent, and ms for five zones.
_COMFORTABLE_Kh, _LINEAR, _FIVE_ZONES_MS = 0.5, 1.0, 20.0
# Goals beside do-mpc on five zones: times faster, and relative difference of the optima.
_FASTER, _SAME_OPTIMUM = 30.0, 1e-4
# Goals of the effects of single actuators: error over RMS, and share of the steps with the right sign.
_EFFECT, _SIGN = 0.15, 0.98

Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One window of one building; `fmu`: file of the test case, None for plants of our own."""

    testcase: str
    period: str
    days: float
    fmu: Path | None = None

    @property
    def name(self) -> str:
        """Building and window."""
        return f"{self.testcase}, {self.period}"


@dataclass(frozen=True)
class Outcome:
    """KPIs by controller, plans by status, verdicts, wall time s; `failed`: the reason.

    `effects`: scores of the pairs of zone and actuator, where the plant can be run from one state again. `refused`: why
    a rival could not be built, by name.
    """

    case: Case
    kpis: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    statuses: Mapping[str, int] = field(default_factory=dict)
    model: str = ""
    effects: Sequence[PairScore] = ()
    refused: Mapping[str, str] = field(default_factory=dict)
    failed: str = ""
    seconds: float = 0.0

    def row(self) -> Row:
        """Table row: cost per m² and discomfort K·h, the mean over zones."""
        row: Row = {"building": self.case.testcase, "window": self.case.period}
        for name in (CONTROLLER, *BASELINES, WITHOUT, PER_ZONE):
            kpis = self.kpis.get(name)
            row[name] = f"{kpis['cost_tot']:.4f} / {kpis['tdis_tot']:.2f}" if kpis else self.refused.get(name, "–")
        row["plans"] = self.failed or ", ".join(f"{name} {n}" for name, n in self.statuses.items() if n)
        row["model"] = self.model or "–"
        return row

    def effect_rows(self) -> list[Row]:
        """Table rows: a pair each, its RMS and the error of its prediction, K."""
        return [
            {
                "building": f"{self.case.testcase}, {s.actuator} on {s.zone}",
                "window": self.case.period,
                CONTROLLER: f"effect {s.effect_rms_K:.3f} K RMS, error {s.rmse_K:.3f} K, sign right {s.sign_right:.1%}",
            }
            for s in self.effects
        ]


def run_zones_bench(
    *,
    fmus: Path | None = None,
    engine: Engine,
    quick: bool = False,
    only_speed: bool = False,
    progress: Callable[[str], None] = lambda _line: None,
) -> dict[str, Any]:
    """Run the buildings of several zones, and time a step over the number of zones.

    Args:
        fmus: folder with the FMU of the apartment; without it the apartment is left out.
        engine: where the buildings are run; the result does not depend on it.
        quick: two scored days of the first window of the house.
        only_speed: time the step alone, on no building.
        progress: callback for progress lines.
    """
    cases = [] if only_speed else _cases(fmus, quick)

    def on_done(n: int, outcome: Outcome) -> None:
        row = outcome.row()
        told = f"FAILED, {outcome.failed}" if outcome.failed else f"{row[CONTROLLER]}, {row['native']}"
        progress(f"[{n}/{len(cases)}] {outcome.case.name}, {outcome.seconds:.0f} s: {told}")

    outcomes = run_all(run_case, cases, engine, on_done)
    progress("timing a step over the number of zones")
    times = {zones: 1e3 * s for zones, s in solve_times((1, 2, 5) if quick else (1, 2, 5, 10, 20)).items()}
    progress("solving five zones in do-mpc too")
    try:
        beside = beside_do_mpc(instances=2 if quick else 10)
    except ConfigError as error:
        progress(str(error))
        beside = None
    rows: list[Row] = [*(o.row() for o in outcomes), *(row for o in outcomes for row in o.effect_rows())]
    rows += [
        {"building": f"{zones} zones, solve of 48 h at 15 min", "window": f"{ms:.1f} ms CPU"}
        for zones, ms in times.items()
    ]
    if beside is not None:
        rows += [
            {"building": f"5 zones, a move in every step, {name}", "window": f"{1e3 * seconds:.1f} ms CPU"}
            for name, seconds in (
                ("ours", beside.ours_s),
                ("do-mpc", beside.do_mpc_s),
                ("do-mpc, modes shared", beside.helped_s),
            )
        ]
    return results_json("zones", rows, [*targets(outcomes), *speed_targets(times, beside)])


def _cases(fmus: Path | None, quick: bool) -> list[Case]:
    if quick:
        return [Case(HOUSE, _WINDOWS[HOUSE][0], _QUICK_DAYS)]
    file = None if fmus is None else fmus / f"{APARTMENT}.fmu"
    buildings = [HOUSE, OFFICE, *([APARTMENT] if file is not None and file.is_file() else [])]
    return [
        Case(name, period, _DAYS[name], file if name == APARTMENT else None)
        for name in buildings
        for period in _WINDOWS[name]
    ]


def run_case(case: Case) -> Outcome:
    """Run the MPC, baselines and rivals over one window; a failure is recorded in the outcome."""
    began = time.perf_counter()
    try:
        outcome = _run(case)
    except ThermoForceError as error:
        outcome = Outcome(case, failed=f"{type(error).__name__}: {error}")
    return replace(outcome, seconds=time.perf_counter() - began)


def _run(case: Case) -> Outcome:
    settings: dict[str, Any] = {
        "plant": {} if case.fmu is None else {"kind": "fmu", "path": str(case.fmu)},
        "period": case.period,
        "days": case.days,
        "identification": {"days": _PROBING_DAYS, "most_days": _PROBING_DAYS},
    }
    scenario = load_scenario(None, {"testcase": case.testcase, "controller": {"name": CONTROLLER}, **settings})
    testcase = Experiment.of(scenario).testcase
    records: list[Record] = []
    with closing(build_plant(scenario.plant, testcase, scenario.seed)) as plant:
        task = identification_task(scenario, chosen_of(scenario, testcase))
        model = run_identification(task, plant, records.append)
        period = scored_period(plant, case.period, case.days)
        effects = score_pairs(within_limits(plant), model, period.start_s) if isinstance(plant, HouseOfRooms) else ()
    done = run(case.testcase, model=model, baselines=list(BASELINES), progress=False, **settings)
    kpis: dict[str, Mapping[str, float]] = dict(done.kpis)
    refused: dict[str, str] = {}
    try:
        config = task.identification.model_copy(update={"cross_effects": False})
        alone = identify(records[0], layout=testcase.layout, config=config, step_s=testcase.step_s)
    except DataError as error:
        refused = dict.fromkeys((WITHOUT, PER_ZONE), f"not identified: {error}")
    else:
        kpis[WITHOUT] = run(case.testcase, model=alone, progress=False, **settings).kpis[CONTROLLER]
        kpis[PER_ZONE] = _per_zone(case, alone, settings)
    return Outcome(case, kpis, done.result.fallback_levels(), verdict_in_words(model), effects, refused)


def _per_zone(case: Case, model: ThermalModel, settings: Mapping[str, Any]) -> Mapping[str, float]:
    """KPIs of one controller per zone."""
    scenario = load_scenario(None, {"testcase": case.testcase, "controller": {"name": CONTROLLER}, **settings})
    testcase = Experiment.of(scenario).testcase
    config = chosen_of(scenario, testcase, CONTROLLER).config
    assert isinstance(config, MPCConfig)
    with closing(build_plant(scenario.plant, testcase, scenario.seed)) as plant:
        period = scored_period(plant, case.period, case.days)
        return run_closed_loop(plant, OnePerZone(model, config), period, u_min=testcase.layout.u_min).kpis


def targets(outcomes: Sequence[Outcome]) -> list[Target]:
    """Cheaper than native control and thermostats at no more discomfort; the apartment: a tenth of native's."""
    found = []
    for o in outcomes:
        ours = o.kpis.get(CONTROLLER, {})
        nan = float("nan")
        native, thermostat = (o.kpis.get(name, {}) for name in BASELINES)
        cost, discomfort = ours.get("cost_tot", nan), ours.get("tdis_tot", nan)
        if o.case.testcase == APARTMENT:
            found.append(Target(f"{o.case.name}: cost over native control's", cost / native.get("cost_tot", nan), 1.0))
            least = 0.1 * native.get("tdis_tot", nan)
        else:
            cheapest = min(native.get("cost_tot", nan), thermostat.get("cost_tot", nan))
            found.append(Target(f"{o.case.name}: cost over the cheaper baseline's", cost / cheapest, 1.0))
            better = min(native.get("tdis_tot", nan), thermostat.get("tdis_tot", nan))
            least = max(better, _COMFORTABLE_Kh)
        found.append(Target(f"{o.case.name}: discomfort per zone, K·h", discomfort, least))
        if o.effects:
            signs = [s.sign_right for s in o.effects if np.isfinite(s.sign_right)]
            for whose, own in (("own", True), ("cross", False)):
                name = f"{o.case.name}: largest error of {whose} effects over their RMS"
                found.append(Target(name, worst(o.effects, own), _EFFECT))
            found.append(Target(f"{o.case.name}: least share of right signs", min(signs), _SIGN, "at least"))
    return found


def speed_targets(times: Mapping[int, float], beside: BesideDoMpc | None) -> list[Target]:
    """Growth of the solve time (ms) with the number of zones, that of five zones, and do-mpc's on the same problem.

    Without do-mpc its targets are not met.
    """
    nan = float("nan")
    b = beside or BesideDoMpc(nan, nan, nan, nan)
    return [
        Target("exponent of the solve time over zones", exponent(times), _LINEAR),
        Target("solve of five zones, ms of CPU", float(times.get(5, nan)), _FIVE_ZONES_MS),
        Target("five zones, the same problem: times faster than do-mpc", b.do_mpc_s / b.ours_s, _FASTER, "at least"),
        Target("and than do-mpc with modes shared", b.helped_s / b.ours_s, _FASTER, "at least"),
        Target("worst relative difference of the optimum to do-mpc's", b.worst_difference, _SAME_OPTIMUM),
    ]
