"""HTML report of a run, one self-contained file: figures, courses, plans over the instants, who acted, and errors."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Layout
from thermoforce_mpc.files import write_whole
from thermoforce_mpc.simulation.closed_loop import RunResult
from thermoforce_mpc.simulation.findings import Capped, gates_held, planning_of, verdict, watch_spells
from thermoforce_mpc.simulation.folder.plain_files import write_plain
from thermoforce_mpc.simulation.report.courses import Course, course_of, most_blocks
from thermoforce_mpc.simulation.report.model_panels import answers_json, other_levels_json
from thermoforce_mpc.simulation.report.page import UPLOT, Json, rendered
from thermoforce_mpc.simulation.report.plans import FINEST_K, TEMPERATURES, decisions_json, plans_json
from thermoforce_mpc.simulation.report.tables import (
    advice,
    apart,
    events,
    forecast_errors,
    free_forecast_scores,
    kpi_rows,
)

if TYPE_CHECKING:
    from thermoforce_mpc.model.thermal_model import ThermalModel

SCRIPTS = (
    UPLOT, "base.js", "tip.js", "group.js", "chart.js", "looks.js", "run.js", "course.js", "plan_facts.js", "plans.js",
    "cumulative.js", "others.js", "status.js", "answers.js", "run_page.js",
)  # fmt: skip
# So many stretches are listed; `steps.csv` has all.
_MOST_EVENTS = 300


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
    manifest: Mapping[str, Any] | None = None,
    said: Sequence[str] = (),
    path: Path | None = None,
) -> Path:
    """Write `report.html` into a run folder, or the report to `path`.

    `kpis` and `manifest` are the contents of the files of that name, the latter by default that in the folder; `model`
    is that of the controller, for step responses and other levels; `said` is shown at the top.
    """
    if manifest is None:
        manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    runs = {result.controller: result, **baselines}
    most = most_blocks(layout, len(runs))
    courses = {name: course_of(run, layout, area_m2, most) for name, run in runs.items()}
    data = report_data(result, courses, currency, layout, area_m2, model)
    everyone = {name: run.kpis for name, run in runs.items()}
    names, others, stretches = layout.names, data["other_levels"], events(result)
    page = rendered(
        "report.html.j2",
        SCRIPTS,
        data,
        kpis=kpis,
        manifest=manifest,
        said=said,
        verdict=verdict(result.controller, everyone, currency, _days(result)),
        table=kpi_rows(everyone, currency),
        controllers=list(everyone),
        gates={name: gate.in_words() for name, gate in gates_held(result, baselines).items()},
        advice=advice(manifest["identification"]),
        zones=names.zones if len(names.zones) > 1 else (),
        planned=data["planned"],
        others=others and {"hours": others["n"] * others["step_s"] / HOUR_S},
        answers=data["answers"] is not None,
        forecast=forecast_errors(result),
        free_forecast=free_forecast_scores(result),
        watch=[spell.in_words() for spell in watch_spells(result)],
        capped={name: Capped(**figures).in_words() for name, figures in kpis.get("power_cap", {}).items()},
        apart=apart(courses, everyone),
        scaled={name: course.scaled for name, course in courses.items() if course.scaled != 1.0},
        events=stretches[:_MOST_EVENTS],
        more_events=max(0, len(stretches) - _MOST_EVENTS),
        fallback_levels=result.fallback_levels(),
        planning=planning_of(result, model).in_words(),
        rounding=_rounding(data),
    )
    if path is None:
        write_plain(folder / "report.html", page)
    else:
        write_whole(path, page)
    return path or folder / "report.html"


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


def _days(result: RunResult) -> float:
    """Days until the last sample: of a run that was cut off fewer than its window has."""
    last = result.steps[-1].samples[-1]
    return round((last.start_s + last.duration_s - result.period.start_s) / DAY_S, 2)


def _different_prices(course: Course) -> list[int]:
    """Numbers of the first machine of each price: machines that pay the same share a curve."""
    machines: list[int] = []
    for m, price in enumerate(course.price_per_kWh):
        if not any(np.array_equal(price, course.price_per_kWh[k], equal_nan=True) for k in machines):
            machines.append(m)
    return machines


def _rounding(data: Json) -> str:
    """What of the run is not in the page, or not as exactly as in the run folder."""
    steps = [row.get("step", 0.0) for name in TEMPERATURES for row in (data["plans"] or {}).get(name, ())]
    says = [
        f"Planned temperatures are rounded to {max([FINEST_K, *steps]):.2g} K, planned levels to 0.01, and "
        "other numbers in this page to the 65,535th part of their range; the files of the run have all digits."
    ]
    if data["own"]["averaged"] > 1:
        says.append(f"Courses are means over {data['own']['averaged']} blocks.")
    if data["steps"]["every"] > 1:
        says.append(f"Of statuses, reasons and computing times one in {data['steps']['every']} is here.")
    if data["plans"] and data["plans"]["every"] > 1:
        says.append(f"Of the plans one in {data['plans']['every']} is here; “tf-mpc explain” shows any.")
    return " ".join(says)
