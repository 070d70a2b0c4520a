"""HTML report of a run, one self-contained file: figures, courses, plans over the instants, who acted, and errors."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data import HOUR_S, Layout, PlanStatus
from thermoforce_mpc.files import write_whole
from thermoforce_mpc.plants.kpis import zone_kpis
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord, gates_held
from thermoforce_mpc.simulation.report.answers import answers_json
from thermoforce_mpc.simulation.report.courses import Course, course_of, most_blocks
from thermoforce_mpc.simulation.report.decisions import decisions_json
from thermoforce_mpc.simulation.report.forecast_check import forecast_errors, free_forecast_scores
from thermoforce_mpc.simulation.report.other_levels import other_levels_json
from thermoforce_mpc.simulation.report.packing import Json
from thermoforce_mpc.simulation.report.page import UPLOT, rendered
from thermoforce_mpc.simulation.report.plans import plans_json
from thermoforce_mpc.simulation.watching import watch_spells

if TYPE_CHECKING:
    from thermoforce_mpc.model.thermal_model import ThermalModel

KPI_LABELS = {
    "cost_tot": ("Cost", "{currency}/m²"),
    "ener_tot": ("Energy", "kWh/m²"),
    "tdis_tot": ("Discomfort", "K·h"),
    "emis_tot": ("Emissions", "kg CO₂/m²"),
    "pele_tot": ("Peak power (15 min)", "kW/m²"),
    "time_rat": ("Computing time / real time", "–"),
}
# KPIs that are shown as bars, too.
_BARS = ("cost_tot", "ener_tot", "tdis_tot")
SCRIPTS = (
    UPLOT, "base.js", "tip.js", "group.js", "chart.js", "run.js", "course.js", "plan_facts.js", "plans.js",
    "cumulative.js", "others.js", "status.js", "answers.js", "run_page.js",
)  # fmt: skip
# Courses that end further from their KPI are named: this share of it, and so much at least (per m², K·h).
_APART, _LEAST_APART = 0.03, {"cost_tot": 1e-4, "tdis_tot": 0.05}
# So many stretches are told; `steps.csv` has all.
_MOST_EVENTS = 300
# Statuses of which the page tells each stretch; gate and watch are told apart.
_TOLD = tuple(status for status in PlanStatus if status.fallen_back or status is PlanStatus.BRIDGED)


def write_report(
    folder: Path,
    *,
    kpis: Mapping[str, Any],
    result: RunResult,
    baselines: Mapping[str, RunResult],
    currency: str,
    layout: Layout,
    area_m2: float,
    model: ThermalModel | None = None,
) -> Path:
    """Write `report.html` into a run folder that already holds its manifest.

    `kpis` is the content of `kpis.json`; `layout` says which actuators serve which zone, `area_m2` is the floor area;
    `model` is that of the controller, for the step responses and what other levels would have done.
    """
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    runs = {result.controller: result, **baselines}
    most = most_blocks(layout, len(runs))
    courses = {name: course_of(run, layout, area_m2, most) for name, run in runs.items()}
    data = report_data(result, courses, currency, layout, area_m2, model)
    everyone = {name: run.kpis for name, run in runs.items()}
    names, others, events = layout.names, data["other_levels"], _events(result)
    page = rendered(
        "report.html.j2",
        SCRIPTS,
        data,
        kpis=kpis,
        manifest=manifest,
        table=_kpi_rows(everyone, currency),
        controllers=list(everyone),
        gates={name: gate.in_words() for name, gate in gates_held(result, baselines).items()},
        advice=_advice(manifest["identification"]),
        zones=names.zones if len(names.zones) > 1 else (),
        planned=data["planned"],
        others=others and {"hours": others["n"] * others["step_s"] / HOUR_S},
        answers=data["answers"] is not None,
        forecast=forecast_errors(result),
        free_forecast=free_forecast_scores(result),
        watch=[spell.in_words() for spell in watch_spells(result)],
        apart=_apart(courses, everyone),
        events=events[:_MOST_EVENTS],
        more_events=max(0, len(events) - _MOST_EVENTS),
        fallback_levels=result.fallback_levels(),
        rounding=_rounding(data),
    )
    path = folder / "report.html"
    write_whole(path, page)
    return path


def report_data(
    result: RunResult,
    courses: Mapping[str, Course],
    currency: str,
    layout: Layout,
    area_m2: float,
    model: ThermalModel | None,
) -> Json:
    """What the scripts of the page read, see `assets/run.js`; `courses` of the controller and its baselines."""
    names = layout.names
    course = courses[result.controller]
    plans = plans_json(result, layout, area_m2)
    return {
        "currency": currency,
        "names": {"zones": names.zones, "actuators": names.actuators, "machines": names.machines},
        "serves": [layout.actuators_of(z) for z in range(len(names.zones))],
        "prices": _different_prices(course),
        "own": {"name": result.controller, "averaged": course.averaged, **course.to_json()},
        "baselines": [
            {"name": name, **beside.own_json()} for name, beside in courses.items() if name != result.controller
        ],
        "steps": decisions_json(result),
        "planned": plans is not None,
        "plans": plans,
        "other_levels": other_levels_json(result, model, layout),
        "answers": answers_json(model),
    }


def _different_prices(course: Course) -> list[int]:
    """Numbers of the first machine of each price: machines that pay the same share a curve."""
    found: list[int] = []
    for m, price in enumerate(course.price_per_kWh):
        if not any(np.array_equal(price, course.price_per_kWh[k], equal_nan=True) for k in found):
            found.append(m)
    return found


def _kpi_rows(everyone: Mapping[str, Mapping[str, float]], currency: str) -> list[dict[str, Any]]:
    """One row per KPI, with the best value of the row, and the largest where it is shown as bars."""
    rows = []
    for key, (label, unit) in KPI_LABELS.items():
        values = [kpis.get(key) for kpis in everyone.values()]
        if all(value is None for value in values):
            continue
        rows.append(_row(label, unit.format(currency=currency), values, best=key != "time_rat", bars=key in _BARS))
        if key == "tdis_tot":
            found = {name: zone_kpis(kpis) for name, kpis in everyone.items()}
            for zone in dict.fromkeys(zone for of in found.values() for zone in of):
                rows.append(_row(f"· {zone}", unit, [found[name].get(zone) for name in everyone]))
    return rows


def _apart(courses: Mapping[str, Course], kpis: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Where cost or discomfort so far do not end at the KPI: 'cost of native: 0.07, KPI 0.09'."""
    found = []
    for name, course in courses.items():
        ends = {"cost_tot": float(course.cost[-1]), "tdis_tot": float(course.discomfort_Kh[:, -1].mean())}
        for key, end in ends.items():
            kpi = kpis[name].get(key)
            if kpi is not None and abs(end - kpi) > max(_APART * abs(kpi), _LEAST_APART[key]):
                found.append(f"{KPI_LABELS[key][0].lower()} of {name}: {end:.4g}, KPI {kpi:.4g}")
    return found


def _row(label: str, unit: str, values: list[float | None], *, best: bool = True, bars: bool = False) -> dict[str, Any]:
    values = [value if value is not None and np.isfinite(value) else None for value in values]
    numbers = [value for value in values if value is not None]
    return {
        "label": label,
        "unit": unit,
        "values": values,
        "best": min(numbers) if numbers and best else None,
        "most": max(numbers) if bars and numbers and min(numbers) >= 0 < max(numbers) else None,
    }


def _advice(identification: Mapping[str, Any]) -> list[str]:
    """What the verdicts on the models advise; with several actuators, each by name."""
    named = identification.get("actuators")
    if named is None:
        return list((identification.get("competence") or {}).get("advice", ()))
    return [f"{name}: {advice}" for name, of in named.items() for advice in (of["competence"] or {}).get("advice", ())]


def _events(result: RunResult) -> list[dict[str, Any]]:
    """Stretches of steps in which something else than a plan as wanted acted, or a reading was doubtful."""

    def kind(step: StepRecord) -> tuple[str, str, str]:
        return step.plan.status.value, step.refused, "; ".join(step.notes)

    found: list[dict[str, Any]] = []
    before = None
    for step in result.steps:
        now = status, refused, notes = kind(step)
        told = status in _TOLD or bool(refused or notes)
        if told and now == before:
            found[-1]["steps"] += 1
        elif told:
            why = step.plan.why
            found.append(
                {"time_s": step.time_s, "steps": 1, "status": status, "refused": refused, "why": why, "notes": notes}
            )
        before = now
    return found


def _rounding(data: Json) -> str:
    """What of the run is not in the page, or not as exactly as in the run folder."""
    says = [
        "Planned temperatures are rounded to 0.01 K, planned levels to 0.01, and other numbers in this page to the "
        "65,535th part of their range; the files of the run have all digits."
    ]
    if data["own"]["averaged"] > 1:
        says.append(f"Courses are means over {data['own']['averaged']} blocks.")
    if data["steps"]["every"] > 1:
        says.append(f"Of statuses, reasons and computing times one in {data['steps']['every']} is here.")
    if data["plans"] and data["plans"]["every"] > 1:
        says.append(f"Of the plans one in {data['plans']['every']} is here; “tf-mpc explain” shows any.")
    return " ".join(says)
