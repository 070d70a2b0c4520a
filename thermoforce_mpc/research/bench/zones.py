"""`tf-mpc bench zones`: the default configuration on buildings of several zones, beside two baselines."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.errors import ThermoForceError
from thermoforce_mpc.research.bench.boptest import verdict_in_words
from thermoforce_mpc.research.bench.processes import in_processes
from thermoforce_mpc.research.bench.zone_scaling import solve_times
from thermoforce_mpc.simulation.bench_result import Target, bench_result
from thermoforce_mpc.simulation.run import run

CONTROLLER, BASELINES = "thermoforce_mpc", ("native", "thermostat")
# Windows by building: two cold and a mild one; the office, which is cooled too, has a hot one.
HOUSE, OFFICE, APARTMENT = "house:5rooms", "energyplus:small_office", "twozone_apartment_hydronic"
_WINDOWS = {
    HOUSE: ("cold_week", "24", "sunny_week"),
    OFFICE: ("peak_heat_day", "cold_day", "mix_day", "peak_cool_day"),
    APARTMENT: ("peak_heat_day", "typical_heat_day"),
}
_DAYS = {HOUSE: 7.0, OFFICE: 14.0, APARTMENT: 14.0}
_QUICK_DAYS = 2.0
# Days of probing: all of them, whatever the verdict.
_PROBING_DAYS = 3.0
# Discomfort that counts as none, K·h per zone, and goals of the solve time: exponent, and ms for five zones.
_COMFORTABLE_Kh, _LINEAR, _FIVE_ZONES_MS = 0.5, 1.0, 20.0

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
    """KPIs by controller, plans by status, verdicts, wall time s; `failed`: the reason."""

    case: Case
    kpis: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    statuses: Mapping[str, int] = field(default_factory=dict)
    model: str = ""
    failed: str = ""
    seconds: float = 0.0

    def row(self) -> Row:
        """Table row: cost per m² and discomfort K·h, the mean over zones."""
        row: Row = {"building": self.case.testcase, "window": self.case.period}
        for name in (CONTROLLER, *BASELINES):
            kpis = self.kpis.get(name)
            row[name] = f"{kpis['cost_tot']:.4f} / {kpis['tdis_tot']:.2f}" if kpis else "–"
        row["plans"] = self.failed or ", ".join(f"{name} {n}" for name, n in self.statuses.items() if n)
        row["model"] = self.model or "–"
        return row


def run_zones_bench(
    *,
    fmus: Path | None = None,
    jobs: int = 2,
    quick: bool = False,
    progress: Callable[[str], None] = lambda _line: None,
) -> dict[str, Any]:
    """Run the buildings of several zones, and time a step over the number of zones.

    Args:
        fmus: folder with the FMU of the apartment; without it the apartment is left out.
        jobs: processes; the result does not depend on it.
        quick: two scored days of the first window of the house.
        progress: callback for progress lines.
    """
    cases = _cases(fmus, quick)

    def on_done(n: int, outcome: Outcome) -> None:
        row = outcome.row()
        told = f"FAILED, {outcome.failed}" if outcome.failed else f"{row[CONTROLLER]}, {row['native']}"
        progress(f"[{n}/{len(cases)}] {outcome.case.name}, {outcome.seconds:.0f} s: {told}")

    outcomes = in_processes(run_case, cases, jobs, on_done)
    progress("timing a step over the number of zones")
    times = {zones: 1e3 * s for zones, s in solve_times((1, 2, 5) if quick else (1, 2, 5, 10, 20)).items()}
    rows: list[Row] = [o.row() for o in outcomes]
    rows += [
        {"building": f"{zones} zones, solve of 48 h at 15 min", "window": f"{ms:.1f} ms"} for zones, ms in times.items()
    ]
    return bench_result("zones", rows, [*targets(outcomes), *speed_targets(times)])


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
    """Run the MPC and the baselines over one window; a failure is recorded in the outcome."""
    began = time.perf_counter()
    plant: dict[str, Any] = {} if case.fmu is None else {"kind": "fmu", "path": str(case.fmu)}
    try:
        done = run(
            case.testcase,
            plant=plant,
            period=case.period,
            days=case.days,
            baselines=list(BASELINES),
            identification={"days": _PROBING_DAYS, "most_days": _PROBING_DAYS},
            progress=False,
        )
    except ThermoForceError as error:
        return Outcome(case, failed=f"{type(error).__name__}: {error}", seconds=time.perf_counter() - began)
    found = done.models.get(CONTROLLER)
    words = "none" if found is None else verdict_in_words(found)
    return Outcome(case, done.kpis, done.result.fallback_levels(), words, seconds=time.perf_counter() - began)


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
    return found


def speed_targets(times: Mapping[int, float]) -> list[Target]:
    """Growth of the solve time with the number of zones, and that of five zones."""
    zones, ms = np.array(list(times)), np.array(list(times.values()))
    exponent = float(np.polyfit(np.log(zones), np.log(ms), 1)[0])
    return [
        Target("exponent of the solve time over zones", exponent, _LINEAR),
        Target("solve of five zones, ms", float(times.get(5, float("nan"))), _FIVE_ZONES_MS),
    ]
