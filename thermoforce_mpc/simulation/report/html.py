"""HTML report of a run, one self-contained file: setup, KPIs, plots, prediction errors and fallbacks."""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from markupsafe import Markup

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.simulation.closed_loop import RunResult, gates_held
from thermoforce_mpc.simulation.report.forecast_check import forecast_errors, free_forecast_scores
from thermoforce_mpc.simulation.report.plots import actuation_plot, kpi_plot, temperature_plot
from thermoforce_mpc.simulation.run_folder import steps_frame, trajectory_frame
from thermoforce_mpc.simulation.watching import watch_spells

KPI_LABELS = {
    "cost_tot": ("Cost", "{currency}/m²"),
    "ener_tot": ("Energy", "kWh/m²"),
    "tdis_tot": ("Discomfort", "K·h"),
    "emis_tot": ("Emissions", "kg CO₂/m²"),
    "pele_tot": ("Peak power (15 min)", "kW/m²"),
    "time_rat": ("Computing time / real time", "–"),
}


def write_report(
    folder: Path, *, kpis: Mapping[str, Any], result: RunResult, baselines: Mapping[str, RunResult], currency: str
) -> Path:
    """Write `report.html` into a run folder that already holds its manifest; `kpis` is the content of `kpis.json`."""
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    trajectory, steps = trajectory_frame(result.steps), steps_frame(result.steps)
    others = {name: trajectory_frame(baseline.steps) for name, baseline in baselines.items()}
    everyone = {result.controller: result.kpis, **{name: b.kpis for name, b in baselines.items()}}
    fallen_back = steps.status.isin(["shifted", "thermostat", "guard"])
    events = steps[fallen_back | (steps.refused != "") | (steps.notes != "")]
    template = page_environment().get_template("report.html.j2")
    page = template.render(
        kpis=kpis,
        manifest=manifest,
        table=_kpi_rows(everyone, currency),
        controllers=list(everyone),
        gates={name: gate.in_words() for name, gate in gates_held(result, baselines).items()},
        temperature=Markup(temperature_plot(trajectory, steps, others)),
        actuation=Markup(actuation_plot(trajectory, currency)),
        comparison=Markup(kpi_plot(everyone, currency)),
        forecast=forecast_errors(result),
        free_forecast=free_forecast_scores(result),
        watch=[spell.in_words() for spell in watch_spells(result)],
        events=events.to_dict("records"),
        fallback_levels=result.fallback_levels(),
        sentences=_sentences(steps),
    )
    path = folder / "report.html"
    path.write_text(page, encoding="utf-8")
    return path


def page_environment() -> jinja2.Environment:
    """Jinja environment of all pages; an undefined value in a template is an error."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("thermoforce_mpc.simulation.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )


def _kpi_rows(everyone: Mapping[str, Mapping[str, float]], currency: str) -> list[dict[str, Any]]:
    """One row per KPI, with the best value of the row."""
    rows = []
    for key, (label, unit) in KPI_LABELS.items():
        values = [kpis.get(key) for kpis in everyone.values()]
        numbers = [value for value in values if value is not None]
        best = min(numbers) if numbers and key != "time_rat" else None
        rows.append(
            {"label": label, "unit": unit.format(currency=currency), "key": key, "values": values, "best": best}
        )
    return rows


def _sentences(steps: pd.DataFrame) -> list[dict[Hashable, Any]]:
    """Reasons of the plans of the first 24 h, one per hour."""
    hour = ((steps.time_s - steps.time_s.iloc[0]) // HOUR_S).astype(int)
    hourly = steps[~hour.duplicated()]
    return hourly.head(24)[["time_s", "T_zone_C", "u_planned", "why"]].to_dict("records")
