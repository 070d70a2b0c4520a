"""`tf-mpc bench interventions`: the paper's table of interventional validity on EnergyPlus, with test and figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.interventions.dataset import Dataset, load_or_simulate
from benchmarks.interventions.methods.registry import BEST, METHODS, MONOTONE, TWO_STATE
from benchmarks.interventions.protocol import PROBE_DAYS, QUICK, Protocol
from benchmarks.interventions.scores import CellScore, one_sided_wilcoxon
from benchmarks.interventions.suite import SuiteResult, run_suite
from benchmarks.paper.printed import INTERVENTIONAL_VALIDITY
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.plants.energyplus.zone import CLIMATES

Row = dict[str, Any]
Say = Callable[[str], None]

_AGAINST_BASELINE = 0.8
_SIGN_GOAL = 0.98


def data_for(
    folder: Path, *, quick: bool, days: Sequence[int] = (), draw: int = 1, engine: Engine, say: Say
) -> Dataset:
    """Data of the suite, read or simulated; numbers of probe `days` are added to those of the protocol.

    `draw` is the seed of internal gains and probing.
    """
    protocol = QUICK if quick else Protocol()
    wanted = tuple(sorted({*protocol.probe_days, *days}))
    return load_or_simulate(replace(protocol, probe_days=wanted, seed=draw), folder, engine, say=say)


def run_interventions_bench(
    data_folder: Path,
    *,
    out: Path,
    days: Sequence[int] = (),
    quick: bool = False,
    backbone: str = "shipped",
    seed: int = 1,
    engine: Engine,
    methods: Sequence[str] = (),
    draw: int = 1,
    progress: Say = lambda line: None,
) -> dict[str, Any]:
    """Run the suite and write `interventions.json`, the figures and `index.html` into `out`.

    Args:
        data_folder: folder of the simulated pairs.
        out: folder of the results, created if missing.
        days: numbers of probe days, by default 3 (quick: 1); targets and figures use the first.
        quick: fewer validation and test days.
        backbone: weights of the forecaster.
        seed: seed of the networks.
        engine: where pairs are simulated, and methods fitted and scored.
        methods: names in `METHODS`, by default all; targets are only computed for all.
        draw: seed of internal gains and probing; each value is another suite of the same kind.
        progress: callback for progress lines.

    Raises:
        DataError: probe days out of range, or damaged data.
        PlantError: the engine is missing or failed.
    """
    from benchmarks.interventions.page import write_page
    from benchmarks.interventions.plots import fan_figure, save, scatter_figure
    from thermoforce_mpc.files import write_json

    days = tuple(days) or ((1,) if quick else (3,))
    if not all(1 <= k <= max(PROBE_DAYS) for k in days):
        raise DataError(
            f"probe days {list(days)}: each must be between 1 and {max(PROBE_DAYS)}, the length of the part"
        )
    data = data_for(data_folder, quick=quick, days=days, draw=draw, engine=engine, say=progress)
    suite = run_suite(
        data,
        days,
        methods=tuple(methods) or tuple(METHODS),
        backbone=backbone,
        seed=seed,
        engine=engine,
        say=progress,
    )
    rows = [row for k in days for row in table_rows(suite, k)]
    rows += [row for k in days for row in wilcoxon_rows(suite, k)]
    rows += [cell_row(score) for score in suite.scores]
    result = results_json("interventions", rows, targets(suite, days[0]) if not methods else [])
    result["manifest"] = data.manifest
    out.mkdir(parents=True, exist_ok=True)
    figures = {
        "scatter": save(scatter_figure(suite, days[0]), out, "scatter"),
        "fan": save(fan_figure(suite.fans), out, "fan"),
    }
    write_json(out / "interventions.json", result)
    write_page(out / "index.html", result, figures)
    progress(f"figures, JSON and page: {out / 'index.html'}")
    return result


def table_rows(suite: SuiteResult, days: int) -> list[Row]:
    """The paper's table: means over the three cells of each climate, with the effect RMSE printed in the paper."""
    rows = []
    for climate in dict.fromkeys(s.climate for s in suite.scores):
        for name, method in METHODS.items():
            cells = suite.of(name, climate, days)
            if not cells:
                continue
            paper = INTERVENTIONAL_VALIDITY.get((name, climate))
            rows.append(
                {
                    "mode": _place(climate),
                    "method": method.label,
                    "days": days,
                    "factual_K": _mean(cells, "factual_rmse_K"),
                    "effect_K": _mean(cells, "effect_rmse_K"),
                    "sign": _mean(cells, "sign_accuracy"),
                    "violations": sum(c.violations for c in cells),
                    "of": sum(c.comparisons for c in cells),
                    "paper_effect_K": paper[1] if paper else None,
                    "paper_sign": paper[2] if paper else None,
                }
            )
    return rows


def wilcoxon_rows(suite: SuiteResult, days: int) -> list[Row]:
    """One-sided Wilcoxon tests over the cells: each ThermoForce variant against all other methods."""
    rows = []
    for name in (MONOTONE, TWO_STATE, BEST):
        for other, method in METHODS.items():
            ours, theirs = suite.of(name, days=days), suite.of(other, days=days)
            if other == name or not ours or not theirs:
                continue
            p, won = one_sided_wilcoxon(ours, theirs)
            label, against = METHODS[name].label, method.label
            rows.append({"test": label, "against": against, "days": days, "cells_won": won, "of": len(ours), "p": p})
    return rows


def cell_row(score: CellScore) -> Row:
    """Table row of one method on one cell."""
    return {
        "cell": f"{score.climate} {score.window}",
        "method": METHODS[score.method].label,
        "days": score.days,
        "pairs": score.pairs,
        "factual_K": score.factual_rmse_K,
        "effect_K": score.effect_rmse_K,
        "sign": score.sign_accuracy,
        "violations": score.violations,
        "fitted": score.note,
    }


def targets(suite: SuiteResult, days: int) -> list[Target]:
    """Targets for the paper's monotone operator and for the best variant.

    They are compared with the baselines of the paper and with all baselines, which include a grey box fitted to the
    same paired probe.
    """
    out = []
    groups = {
        "the paper's baselines": [name for name, m in METHODS.items() if not m.ours and m.in_paper],
        "all baselines": [name for name, m in METHODS.items() if not m.ours],
    }
    for name in (MONOTONE, BEST):
        ours = suite.of(name, days=days)
        if not ours:
            continue
        label = METHODS[name].label
        climates = list(dict.fromkeys(s.climate for s in ours))
        for group, baselines in groups.items():
            theirs = [s for b in baselines for s in suite.of(b, days=days)]
            lowest = {s.cell: min(t.effect_rmse_K for t in theirs if t.cell == s.cell) for s in ours}
            won = sum(s.effect_rmse_K < lowest[s.cell] for s in ours)
            out.append(Target(f"{label}: cells with the lowest effect RMSE, {group}", won, len(ours), "at least"))
            for climate in climates:
                mine = _mean(suite.of(name, climate, days), "effect_rmse_K")
                scores = [(_mean(suite.of(b, climate, days), "effect_rmse_K"), METHODS[b].label) for b in baselines]
                least, who = min(scores)
                goal = f"effect RMSE over the best of {group} ({who})"
                out.append(Target(f"{label}, {_place(climate)}: {goal}", mine / least, _AGAINST_BASELINE))
        for climate in climates:
            paper = INTERVENTIONAL_VALIDITY[MONOTONE, climate][1]
            mine = _mean(suite.of(name, climate, days), "effect_rmse_K")
            out.append(Target(f"{label}, {_place(climate)}: effect RMSE, K (paper's ThermoForce)", mine, paper))
        signs = min(s.sign_accuracy for s in ours)
        out.append(Target(f"{label}: sign accuracy, worst cell", signs, _SIGN_GOAL, "at least"))
        out.append(Target(f"{label}: monotonicity violations", sum(s.violations for s in ours), 0))
    return out


def _place(climate: str) -> str:
    return CLIMATES[climate].label  # type: ignore[index]


def _mean(cells: Sequence[CellScore], key: str) -> float:
    return float(np.mean([getattr(cell, key) for cell in cells]))
