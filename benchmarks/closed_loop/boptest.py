"""`tf-mpc bench boptest`: the default configuration on test cases of BOPTEST from their FMUs, beside native control."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.cases import run_all
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.errors import InputError, ThermoForceError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.experiment.run import run
from thermoforce_mpc.files import named_configs
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.fmu.archive import read_archive
from thermoforce_mpc.plants.testcases import load_testcase

CONTROLLER, NATIVE = "thermoforce_mpc", "native"
_QUICK_DAYS, _DAYS = 2.0, 14.0
# Discomfort as a share of native control's, and cost as a multiple of it; other test cases: no worse than native.
_GOALS = {"bestest_hydronic": (0.1, 1.01), "bestest_air": (0.2, 1.0), "twozone_apartment_hydronic": (0.1, 1.0)}
_NO_WORSE = (1.0, 1.0)

Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One scenario of one FMU."""

    fmu: Path
    testcase: str
    period: str
    price: str
    days: float


@dataclass(frozen=True)
class Outcome:
    """KPIs by controller, plans of the MPC by status, verdict on its model, wall time s; `failed`: the reason."""

    case: Case
    kpis: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    statuses: Mapping[str, int] = field(default_factory=dict)
    model: str = ""
    failed: str = ""
    seconds: float = 0.0

    def row(self) -> Row:
        """Table row: cost per m² and discomfort K·h of MPC and native control."""
        row: Row = {"test case": self.case.testcase, "period": self.case.period}
        for name in (CONTROLLER, NATIVE):
            kpis = self.kpis.get(name)
            row[name] = f"{kpis['cost_tot']:.4f} / {kpis['tdis_tot']:.2f}" if kpis else "–"
        row["plans"] = self.failed or ", ".join(f"{name} {n}" for name, n in self.statuses.items() if n)
        row["model"] = self.model or "–"
        return row


def run_boptest_bench(
    fmus: Path,
    *,
    price: str = "constant",
    engine: Engine,
    quick: bool = False,
    progress: Callable[[str], None] = lambda _line: None,
) -> dict[str, Any]:
    """Run every FMU found in `fmus` over its scenarios.

    Args:
        fmus: folder with FMUs of test cases; those without a configuration that ships are named in the table.
        price: tariff.
        engine: where the cases are run; the result does not depend on it.
        quick: two scored days instead of fourteen.
        progress: callback for progress lines.

    Raises:
        InputError: the folder has no FMU, or one that cannot be read.
    """
    cases, rows = _found(fmus, price, _QUICK_DAYS if quick else _DAYS)

    def on_done(n: int, outcome: Outcome) -> None:
        row = outcome.row()
        done = f"[{n}/{len(cases)}] {row['test case']}, {row['period']}, {outcome.seconds:.0f} s: "
        progress(done + (f"FAILED, {outcome.failed}" if outcome.failed else f"{row[CONTROLLER]}, {row[NATIVE]}"))

    outcomes = run_all(run_case, cases, engine, on_done)
    return results_json("boptest", [*(o.row() for o in outcomes), *rows], targets(outcomes))


def _found(folder: Path, price: str, days: float) -> tuple[list[Case], list[Row]]:
    """Cases of the FMUs in `folder`, and rows that say which of them have no configuration."""
    files = sorted(folder.glob("*.fmu"))
    if not files:
        raise InputError(f"{folder}: no file ends in .fmu")
    cases: list[Case] = []
    rows: list[Row] = []
    known = named_configs("testcases")
    for file in files:
        archive = read_archive(file)
        if file.stem not in known:
            why = "no test case file of that name ships"
            rows.append(
                {"test case": file.stem, "period": "–", CONTROLLER: "–", NATIVE: "–", "plans": why, "model": "–"}
            )
            continue
        mode = load_testcase(file.stem).mode
        for period in archive.days:
            wanted = mode == "both" or (mode == "cooling") == ("cool" in period)
            if wanted:
                cases.append(Case(file, file.stem, period, price, days))
    return cases, rows


def run_case(case: Case) -> Outcome:
    """Run the MPC and native control over one scenario; a failure is recorded in the outcome."""
    began = time.perf_counter()
    try:
        done = run(
            case.testcase,
            plant={"kind": "fmu", "path": str(case.fmu)},
            period=case.period,
            price=case.price,
            days=case.days,
            baselines=[NATIVE],
            progress=False,
        )
    except ThermoForceError as error:
        return Outcome(case, failed=f"{type(error).__name__}: {error}", seconds=time.perf_counter() - began)
    found = done.models.get(CONTROLLER)
    words = "none" if found is None else verdict_in_words(found)
    return Outcome(case, done.kpis, done.result.fallback_levels(), words, seconds=time.perf_counter() - began)


def verdict_in_words(model: ThermalModel) -> str:
    """Verdict on a model; where there are several actuators, how many are competent and what is said of the others."""
    words = [card.competence.in_words() if card.competence else "not judged" for card in model.cards]
    if len(words) == 1:
        return words[0]
    known, others = list[float](), list[str]()
    for name, card, word in zip(model.operator.actuators, model.cards, words, strict=True):
        if card.competence and card.competence.competent:
            known.append(card.competence.relative_sd)
        else:
            others.append(f"{name}: {word}")
    found = f"{len(known)} of {len(words)} actuators competent"
    if known:
        found += f", the effect of 8 h at full level known to ± {100 * min(known):.0f} to {100 * max(known):.0f} %"
    return "; ".join([found, *others])


def targets(outcomes: Sequence[Outcome]) -> list[Target]:
    """Discomfort and cost against native control, each scenario for itself; a failed one meets neither."""
    found = []
    for o in outcomes:
        discomfort, cost = _GOALS.get(o.case.testcase, _NO_WORSE)
        name = f"{o.case.testcase}, {o.case.period}"
        ours, native = o.kpis.get(CONTROLLER), o.kpis.get(NATIVE)
        nan = float("nan")
        relative = ours["cost_tot"] / native["cost_tot"] if ours and native else nan
        found.append(Target(f"{name}: cost over native control's", relative, cost))
        found.append(
            Target(
                f"{name}: discomfort K·h, {discomfort:g} of native control's",
                ours["tdis_tot"] if ours else nan,
                discomfort * native["tdis_tot"] if native else nan,
            )
        )
    return found
