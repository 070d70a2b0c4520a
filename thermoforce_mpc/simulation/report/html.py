"""HTML report of a run, one self-contained file: setup, KPIs, plots, prediction errors and fallbacks."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from markupsafe import Markup

from thermoforce_mpc.data import HOUR_S, Layout, Names, PlanStatus
from thermoforce_mpc.files import write_whole
from thermoforce_mpc.plants.kpis import zone_kpis
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
    folder: Path,
    *,
    kpis: Mapping[str, Any],
    result: RunResult,
    baselines: Mapping[str, RunResult],
    currency: str,
    layout: Layout,
) -> Path:
    """Write `report.html` into a run folder that already holds its manifest.

    `kpis` is the content of `kpis.json`; `layout` says which actuators serve which zone.
    """
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    trajectory, steps = trajectory_frame(result.steps), steps_frame(result.steps)
    others = {name: trajectory_frame(baseline.steps) for name, baseline in baselines.items()}
    everyone = {result.controller: result.kpis, **{name: b.kpis for name, b in baselines.items()}}
    told = [status for status in PlanStatus if status.fallen_back or status is PlanStatus.BRIDGED]
    fallen_back = steps.status.isin(told)
    events = steps[fallen_back | (steps.refused != "") | (steps.notes != "")]
    names = layout.names
    template = page_environment().get_template("report.html.j2")
    page = template.render(
        kpis=kpis,
        manifest=manifest,
        table=_kpi_rows(everyone, currency),
        controllers=list(everyone),
        gates={name: gate.in_words() for name, gate in gates_held(result, baselines).items()},
        advice=_advice(manifest["identification"]),
        zones=names.zones if len(names.zones) > 1 else (),
        actuators=names.actuators if len(names.actuators) > 1 else (),
        temperature=Markup(temperature_plot(trajectory, steps, others, layout)),
        actuation=Markup(actuation_plot(trajectory, currency, layout.names)),
        comparison=Markup(kpi_plot(everyone, currency)),
        forecast=forecast_errors(result),
        free_forecast=free_forecast_scores(result),
        watch=[spell.in_words() for spell in watch_spells(result)],
        events=events.to_dict("records"),
        fallback_levels=result.fallback_levels(),
        sentences=_sentences(steps, names),
    )
    path = folder / "report.html"
    write_whole(path, page)
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
        if key == "tdis_tot":
            found = {name: zone_kpis(kpis) for name, kpis in everyone.items()}
            for zone in dict.fromkeys(zone for of in found.values() for zone in of):
                of_zone = [found[name].get(zone) for name in everyone]
                best = min((value for value in of_zone if value is not None), default=None)
                rows.append({"label": f"· {zone}", "unit": unit, "key": key, "values": of_zone, "best": best})
    return rows


def _advice(identification: Mapping[str, Any]) -> list[str]:
    """What the verdicts on the models advise; with several actuators, each by name."""
    named = identification.get("actuators")
    if named is None:
        return list((identification.get("competence") or {}).get("advice", ()))
    return [f"{name}: {advice}" for name, of in named.items() for advice in (of["competence"] or {}).get("advice", ())]


def _sentences(steps: pd.DataFrame, names: Names) -> list[dict[str, Any]]:
    """Reasons of the plans of the first 24 h, one per hour, with temperatures and levels as text."""
    hour = ((steps.time_s - steps.time_s.iloc[0]) // HOUR_S).astype(int)
    hourly = steps[~hour.duplicated()].head(24)
    T = [names.label("T_zone_C", z) for z in range(len(names.zones))]
    u = ["u_planned" + names.label("u", a).removeprefix("u") for a in range(len(names.actuators))]
    return [
        {
            "time_s": row["time_s"],
            "T_zone_C": ", ".join(f"{row[key]:.2f}" for key in T),
            "u_planned": ", ".join("–" if pd.isna(row[key]) else f"{row[key]:.2f}" for key in u),
            "why": row["why"],
        }
        for row in hourly.to_dict("records")
    ]
