"""The paper's closed loop: its own setting over three windows and seeds, beside native control and RC-MPC."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import wilcoxon

from benchmarks.interventions.plots import save
from thermoforce_mpc.comparison.outcome import results_json
from thermoforce_mpc.experiment.run import run_scenario
from thermoforce_mpc.plants.testcases import find_config, load_scenario
from thermoforce_mpc.report.display import RunDisplay

# The paper's names of its windows, and ours.
WINDOWS = {"peak A": "peak_heat_day", "peak B": "44", "typical": "typical_heat_day"}
OURS, RC = "thermoforce_paper", "rc_mpc_paper"
_MARKERS = {"native": "o", RC: "s", "rc_mpc": "D", OURS: "^"}
_KPIS = {"energy_kWh_m2": "ener_tot", "discomfort_Kh": "tdis_tot", "cost_EUR_m2": "cost_tot"}


def run_closed_loop_tables(
    out: Path, *, weather: Path | None, quick: bool, seeds: int, progress: Callable[[str], None]
) -> dict[str, Any]:
    """Run the scenario `paper_closed_loop` over each window and seed, into `out`; `quick`: one day of each.

    A seed is that of the probing and of the network's training. Native control knows none, and today's RC-MPC, which
    stands beside for comparison, runs with the first.

    Returns:
        Rows of each window, seed and controller, then of the tests over them.

    Raises:
        PlantError: the plant failed.
    """
    rows: list[dict[str, Any]] = []
    for window, period in WINDOWS.items():
        for seed in range(1, seeds + 1):
            progress(f"closed loop, {window} ({period}), seed {seed} of {seeds}")
            others = ["native", "rc_mpc"] if seed == 1 else []
            wanted: dict[str, Any] = {"period": period, "baselines": [*others, RC], "seed": seed}
            wanted["identification"] = {"options": {"seed": seed}}
            wanted |= {"plant": {"weather": str(weather)}} if weather else {}
            wanted |= {"days": 1.0} if quick else {}
            scenario = load_scenario(find_config("scenarios", "paper_closed_loop"), wanted)
            place = window.replace(" ", "-") + ("" if seed == 1 else f"-seed-{seed}")
            folder = run_scenario(scenario, RunDisplay(quiet=True), out / place, ["tf-mpc", "paper"])
            found = _rows(json.loads((folder / "kpis.json").read_text()))
            rows += [{"window": window, "seed": seed, **row} for row in found]
    save(_pareto([row for row in rows if row["seed"] == 1]), out, "pareto")
    return results_json("paper closed loop", [*rows, *closed_loop_tests(rows)], [])


def closed_loop_tests(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """One-sided Wilcoxon signed-rank tests over windows and seeds, that our discomfort and energy are lower.

    Windows that share a seed, and seeds that share a window, are not independent: p is a lower bound.
    """
    of = {(row["window"], row["seed"], row["controller"]): row for row in rows}
    found = []
    for other in ("native", RC):
        for key in ("discomfort_Kh", "energy_kWh_m2"):
            ours, theirs = [], []
            for (window, seed, name), row in of.items():
                if name == OURS:
                    ours.append(row[key])
                    theirs.append(of[window, 1 if other == "native" else seed, other][key])
            less = np.array(ours) - np.array(theirs)
            p = float(wilcoxon(less, alternative="less").pvalue) if less.any() else 1.0
            words = f"Wilcoxon: {key.split('_')[0]} of {OURS} below {other}, windows and seeds"
            found.append({"test": words, "p": p, "lower": int((less < 0.0).sum()), "of": less.size})
    return found


def _rows(kpis: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Energy, discomfort and cost of each controller of a run."""
    found = {kpis["controller"]: kpis["kpis"], **kpis["baselines"]}
    return [{"controller": name, **{key: of[kpi] for key, kpi in _KPIS.items()}} for name, of in found.items()]


def _pareto(rows: list[dict[str, Any]]) -> Figure:
    """Energy against discomfort: one line a window, one marker a controller."""
    figure = Figure(figsize=(6.5, 4.2), layout="constrained")
    axes = figure.subplots()
    for window, style in zip(WINDOWS, ("-", "--", ":"), strict=True):
        of = {row["controller"]: row for row in rows if row["window"] == window}
        shown = [of[name] for name in _MARKERS]
        x, y = ([row[key] for row in shown] for key in ("energy_kWh_m2", "discomfort_Kh"))
        axes.plot(x, y, color="#8a939c", linestyle=style, label=window, zorder=1)
        for name, energy, discomfort in zip(_MARKERS, x, y, strict=True):
            label = name if window == "peak A" else None
            axes.scatter(energy, discomfort, marker=_MARKERS[name], color="#1b1f24", s=45, label=label, zorder=2)
    axes.set_xlabel("energy, kWh/m²")
    axes.set_ylabel("discomfort, K·h")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    return figure
