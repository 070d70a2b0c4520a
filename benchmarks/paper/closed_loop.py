"""The paper's closed loop: its own setting over three windows, beside native control and RC-MPC."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from benchmarks.interventions.plots import save
from thermoforce_mpc.comparison.results_json import results_json
from thermoforce_mpc.experiment.run import run_scenario
from thermoforce_mpc.plants.testcases import find_config, load_scenario
from thermoforce_mpc.report.display import RunDisplay

# The paper's names of its windows, and ours.
WINDOWS = {"peak A": "peak_heat_day", "peak B": "44", "typical": "typical_heat_day"}
_MARKERS = {"native": "o", "rc_mpc": "s", "thermoforce_paper": "^"}
_KPIS = {"energy_kWh_m2": "ener_tot", "discomfort_Kh": "tdis_tot", "cost_EUR_m2": "cost_tot"}


def run_closed_loop_tables(
    out: Path, *, weather: Path | None, quick: bool, progress: Callable[[str], None]
) -> dict[str, Any]:
    """Run the scenario `paper_closed_loop` over each window, into `out`; `quick`: one day of each.

    Raises:
        PlantError: the plant failed.
    """
    rows: list[dict[str, Any]] = []
    for window, period in WINDOWS.items():
        progress(f"closed loop, {window} ({period})")
        wanted: dict[str, Any] = {"period": period, "baselines": ["native", "rc_mpc"]}
        wanted |= {"plant": {"weather": str(weather)}} if weather else {}
        wanted |= {"days": 1.0} if quick else {}
        scenario = load_scenario(find_config("scenarios", "paper_closed_loop"), wanted)
        folder = run_scenario(scenario, RunDisplay(quiet=True), out / window.replace(" ", "-"), ["tf-mpc", "paper"])
        rows += [{"window": window, **row} for row in _rows(json.loads((folder / "kpis.json").read_text()))]
    save(_pareto(rows), out, "pareto")
    return results_json("paper closed loop", rows, [])


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
