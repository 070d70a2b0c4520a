"""HTML report of a run, one self-contained file: figures, courses, plans over the instants, who acted, and errors.

`report_again` makes it from a folder, also of a run that was cut off or is under way.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from thermoforce_mpc.data import DAY_S, HOUR_S, J_PER_KWH, Array, Layout, PlanStatus
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.errors import ArtifactError, InputError
from thermoforce_mpc.files import check_plain, read_bounded, read_json, write_json, write_plain, write_whole
from thermoforce_mpc.loop.closed_loop import RunResult, StepRecord
from thermoforce_mpc.plants.kpis import zone_kpis
from thermoforce_mpc.records.run_folder import is_complete, kept_model, own_of
from thermoforce_mpc.records.told_steps import ToldBuilding, ToldRun, told_run
from thermoforce_mpc.report.findings import (
    Capped,
    GateHeld,
    best_values,
    figures_of,
    planning_of,
    verdict,
    watch_spells,
)
from thermoforce_mpc.report.page import UPLOT, Json, rendered
from thermoforce_mpc.report.panels import (
    FINEST_K,
    TEMPERATURES,
    RunCourse,
    answers_json,
    course_of,
    decisions_json,
    most_blocks,
    other_levels_json,
    plans_json,
)
from thermoforce_mpc.report.whole_tables import figure

if TYPE_CHECKING:
    from thermoforce_mpc.model.thermal_model import ThermalModel


KPI_LABELS = {
    "cost_tot": ("Cost", "{currency}/m²"),
    "ener_tot": ("Energy", "kWh/m²"),
    "tdis_tot": ("Discomfort", "K·h"),
    "emis_tot": ("Emissions", "kg CO₂/m²"),
    "pele_tot": ("Peak of electricity (15 min)", "kW/m²"),
    "pgas_tot": ("Peak of gas (15 min)", "kW/m²"),
    "pdih_tot": ("Peak of district heat (15 min)", "kW/m²"),
    "time_rat": ("Computing time / real time", "–"),
}
# KPIs that are shown as bars, too.
_BARS = ("cost_tot", "ener_tot", "tdis_tot")
# Courses that end further from their KPI are named: this share of it, and so much at least (per m², K·h).
_APART, _LEAST_APART = 0.03, {"cost_tot": 1e-4, "tdis_tot": 0.05}
# Statuses of which the page lists each stretch; gate and watch are told apart.
_NOTABLE = tuple(status for status in PlanStatus if status.fallen_back or status is PlanStatus.BRIDGED)


def kpi_rows(everyone: Mapping[str, Mapping[str, float]], currency: str) -> list[dict[str, Any]]:
    """One row per KPI, with the best value of the row (`best_values`), and the largest where it is shown as bars."""
    rows, best = [], {key: value for key, value in best_values(everyone).items() if key != "time_rat"}
    for key, (label, unit) in KPI_LABELS.items():
        values = [kpis.get(key) for kpis in everyone.values()]
        if all(value is None for value in values):
            continue
        unit = unit.format(currency=currency)
        rows.append(_row(key, label, unit, values, best=best.get(key), bars=key in _BARS))
        if key == "tdis_tot":
            by_zone = {name: zone_kpis(kpis) for name, kpis in everyone.items()}
            for zone in dict.fromkeys(zone for of in by_zone.values() for zone in of):
                of_zone = [by_zone[name].get(zone) for name in everyone]
                least = min((v for v in of_zone if v is not None and np.isfinite(v)), default=None)
                rows.append(_row(key, f"· {zone}", unit, of_zone, best=least))
    for key in dict.fromkeys(key for kpis in everyone.values() for key in own_of(kpis)):
        label, _, unit = key.rpartition(", ")
        rows.append(_row(key, label, unit, [kpis.get(key) for kpis in everyone.values()]))
    return rows


def apart(courses: Mapping[str, RunCourse], kpis: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Where cost or discomfort so far do not end at the KPI: 'cost of native: 0.07, KPI 0.09'."""
    differences = []
    for name, course in courses.items():
        ends = {"cost_tot": float(course.cost[-1]), "tdis_tot": float(course.discomfort_Kh[:, -1].mean())}
        for key, end in ends.items():
            kpi = kpis[name].get(key)
            if kpi is not None and abs(end - kpi) > max(_APART * abs(kpi), _LEAST_APART[key]):
                differences.append(f"{KPI_LABELS[key][0].lower()} of {name}: {end:.4g}, KPI {kpi:.4g}")
    return differences


def _row(
    key: str, label: str, unit: str, values: list[float | None], *, best: float | None = None, bars: bool = False
) -> dict[str, Any]:
    values = [value if value is not None and np.isfinite(value) else None for value in values]
    numbers = [value for value in values if value is not None]
    return {
        "label": label,
        "unit": unit,
        "values": values,
        "texts": ["–" if value is None else figure(key, value) for value in values],
        "best": best,
        "most": max(numbers) if bars and len(numbers) > 1 and min(numbers) >= 0 < max(numbers) else None,
    }


def advice(identification: Mapping[str, Any]) -> list[str]:
    """What the verdicts on the models advise; with several actuators, each by name."""
    actuators = identification.get("actuators")
    if actuators is None:
        return list((identification.get("competence") or {}).get("advice", ()))
    verdicts = {name: origin["competence"] or {} for name, origin in actuators.items()}
    return [f"{name}: {advice}" for name, verdict in verdicts.items() for advice in verdict.get("advice", ())]


def events(result: RunResult) -> list[dict[str, Any]]:
    """Stretches of steps in which not a plan as wanted acted, a reading was doubtful, or there was news."""

    stretches: list[dict[str, Any]] = []
    previous = None
    for step in result.steps:
        plan, refused, notes = step.plan, step.refused, "; ".join(step.notes)
        present = status, _, _, news = plan.status.value, refused, notes, plan.news
        notable = status in _NOTABLE or bool(refused or notes or news)
        if notable and present == previous:
            stretches[-1]["steps"] += 1
        elif notable:
            what = {"status": status, "refused": refused, "why": plan.why, "notes": notes}
            stretches.append({"time_s": step.time_s, "steps": 1, **what})
        previous = present
    return stretches


def forecast_errors(result: RunResult) -> list[dict[str, Any]]:
    """Error of the planned zone temperature: `zone`, `hours`, `bias_K` (planned − measured), `rmse_K`, `n` plans.

    The error at the first step is a pure prediction error. Beyond it, the error also includes the difference between
    the scored plan and the later plans that were applied.
    """
    measured = {round(step.time_s): step.T_zone_C for step in result.steps}

    def figures(planned_C: Array, came_C: Array) -> dict[str, Any]:
        error = planned_C[0] - came_C
        finite = error[np.isfinite(error)]  # NaN where the zone's sensor was silent
        if not finite.size:
            return {}
        return {"bias_K": float(np.mean(finite)), "rmse_K": rms(finite), "n": finite.size}

    return _scored(result, result.steps, measured, (1.0, 6.0, 12.0, 24.0), ("T_zone_C",), figures)


def free_forecast_scores(result: RunResult) -> list[dict[str, Any]]:
    """Error of free forecasts and coverage of their 80 % intervals: `zone`, `hours`, `mae_K`, `coverage`, `n`.

    The reference is the free temperature `T_free_now_C` of the plan made at the forecast's target time, so later
    actions do not affect the score. Plans of the first two days are left out, while corrections adapt.
    """
    came = {round(step.time_s): step.plan.T_free_now_C for step in result.steps if step.plan.u.size}
    start_s = result.steps[0].time_s if result.steps else 0.0
    settled = (step for step in result.steps if step.time_s - start_s >= 2 * DAY_S)

    def figures(forecast_C: Array, came_C: Array) -> dict[str, Any]:
        free, low, high = forecast_C
        error, inside = free - came_C, (low <= came_C) & (came_C <= high)
        finite = np.isfinite(error)  # NaN where the zone's sensor was silent
        if not finite.any():
            return {}
        mae_K = float(np.mean(np.abs(error[finite])))
        return {"mae_K": mae_K, "coverage": float(np.mean(inside[finite])), "n": int(finite.sum())}

    return _scored(result, settled, came, (1.0, 6.0, 24.0), ("T_free_C", "T_free_low_C", "T_free_high_C"), figures)


def _scored(
    result: RunResult,
    steps: Iterable[StepRecord],
    came: Mapping[int, Array],
    horizons_h: tuple[float, ...],
    names: tuple[str, ...],
    figures: Callable[[Array, Array], dict[str, Any]],
) -> list[dict[str, Any]]:
    """Rows zone by zone, then by lead time, of the `figures` of a zone.

    They get the plans' courses of these `names` (names, plans) so much later, and what `came` then (plans,), by time
    (s). Steps are read once, and no plan is kept: those of a year would not fit in memory.
    """
    planned: dict[float, list[Array]] = {hours: [] for hours in horizons_h}
    seen: dict[float, list[Array]] = {hours: [] for hours in horizons_h}
    for step in steps:
        for hours in horizons_h:
            k = round(hours * HOUR_S / step.boundary.step_s) - 1
            later = came.get(round(step.time_s + hours * HOUR_S))
            if later is not None and 0 <= k < step.plan.u.shape[-1]:
                planned[hours].append(np.stack([getattr(step.plan, name)[:, k] for name in names]))
                seen[hours].append(later)
    return [
        {"zone": zone, "hours": hours, **found}
        for z, zone in enumerate(result.names.zones)
        for hours, courses in planned.items()
        if courses and (found := figures(np.array(courses)[:, :, z].T, np.array(seen[hours])[:, z]))
    ]


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
    origin: pd.Timestamp | None = None,
    model: ThermalModel | None = None,
    manifest: Mapping[str, Any] | None = None,
    said: Sequence[str] = (),
    path: Path | None = None,
) -> Path:
    """Write `report.html` into a run folder, or the report to `path`.

    `kpis` and `manifest` are the contents of the files of that name, the latter by default that in the folder; `model`
    is that of the controller, for step responses and other levels; `said` is shown at the top. Seconds of a real
    building count from `origin`: the page has dates then.
    """
    if manifest is None:
        manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    runs = {result.controller: result, **baselines}
    most = most_blocks(layout, len(runs))
    courses = {name: course_of(run, layout, area_m2, most) for name, run in runs.items()}
    data = report_data(result, courses, currency, layout, area_m2, model)
    everyone = {name: run.kpis for name, run in runs.items()}
    last = result.steps[-1].samples[-1]  # of a run that was cut off before its window ends
    clock = ToldBuilding("", layout, currency, area_m2, origin)
    if origin is not None:
        data["dates"] = _dates(origin, last.start_s + last.duration_s)
    days = round((last.start_s + last.duration_s - result.period.start_s) / DAY_S, 2)
    names, others, stretches = layout.names, data["other_levels"], events(result)
    page = rendered(
        "report.html.j2",
        SCRIPTS,
        data,
        kpis=kpis,
        manifest=manifest,
        said=said,
        verdict=verdict(result.controller, everyone, currency, days),
        table=kpi_rows(everyone, currency),
        controllers=list(everyone),
        gates={name: GateHeld(**figures).in_words() for name, figures in kpis.get("gate", {}).items()},
        advice=advice(manifest["identification"]),
        zones=names.zones if len(names.zones) > 1 else (),
        planned=data["planned"],
        others=others and {"hours": others["n"] * others["step_s"] / HOUR_S},
        answers=data["answers"] is not None,
        forecast=forecast_errors(result),
        free_forecast=free_forecast_scores(result),
        watch=[spell.in_words(clock.in_words) for spell in watch_spells(result)],
        claims=model.claims if model else (),
        capped={name: Capped(**figures).in_words() for name, figures in kpis.get("power_cap", {}).items()},
        apart=apart(courses, everyone),
        scaled={name: course.scaled for name, course in courses.items() if course.scaled != 1.0},
        events=stretches[:_MOST_EVENTS],
        when=clock.in_words,
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
    courses: Mapping[str, RunCourse],
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
        "serves": layout.actuators_of_zones,
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


def _dates(origin: pd.Timestamp, end_s: float) -> Json:
    """The clock of a building whose seconds count from `origin`, until `end_s`: the day on which they begin, and `from`
    which second on its clock is `shift` more than they are, from the midnight of that day.
    """
    at_s = HOUR_S * np.arange(math.ceil(max(end_s, HOUR_S) / HOUR_S))
    began = origin.normalize().tz_localize(None)
    shown = (origin + pd.to_timedelta(at_s, unit="s")).tz_localize(None)
    shift = np.round((shown - began).total_seconds().to_numpy() - at_s)
    first = np.r_[True, np.diff(shift) != 0.0]
    return {"began": f"{began:%Y-%m-%d}", "from": at_s[first].tolist(), "shift": shift[first].tolist()}


def _different_prices(course: RunCourse) -> list[int]:
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


_MOST_BYTES = 10_000_000


def report_again(folder: Path, path: Path | None = None) -> tuple[Path, tuple[str, ...]]:
    """Write the report of the run in `folder`, to `path` or into the folder; returns its file, and what is missing.

    Of a run that has not ended its figures are written into the folder too, as `incomplete_kpis.json`.

    Raises:
        ConfigError: there is a link in the folder, or its test case is no longer known.
        JournalError: there is no journal, it is damaged, or no step has ended.
        StorageError: the report cannot be written.
    """
    from thermoforce_mpc.model.thermal_model import load_model

    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of a run")
    check_plain(folder)
    run = told_run(folder)
    building = run.building
    notes = _cut_off(folder, run)
    told = _json(folder / "kpis.json")
    results = {name: _so_far(result, building, told) for name, result in run.results.items()}
    result, *baselines = results.values()
    entry: Mapping[str, Any] = run.models.get(result.controller, {})
    model, why = None, str(entry.get("refused") or "")
    if entry.get("folder"):
        try:
            model = load_model(kept_model(folder, entry["folder"]))
        except ArtifactError as error:
            why = str(error)
    if why:
        notes.append(f"The model of the run is not shown: {why}")
    manifest = _json(folder / "manifest.json") or {
        "plant": run.plant,
        "command": run.command,
        "environment": {"thermoforce-mpc": run.version},
        "identification": entry.get("origin", {}),
    }
    beside = {baseline.controller: baseline for baseline in baselines}
    kpis = figures_of(run.scenario, manifest["plant"], result, beside, str(told.get("equal_comfort", "")))
    if building.is_real:
        since = building.in_words(result.period.start_s)
        kpis |= {"testcase": building.name, "period": f"since {since}", "price": "the map's"}
    if path is None and not is_complete(folder):
        write_json(folder / "incomplete_kpis.json", {**kpis, "said": notes})
    file = write_report(
        folder,
        currency=building.currency,
        kpis=kpis,
        result=result,
        baselines=beside,
        layout=building.layout,
        area_m2=building.area_m2,
        origin=building.origin,
        model=model,
        manifest=manifest,
        said=notes,
        path=path,
    )
    return file, tuple(notes)


def _cut_off(folder: Path, run: ToldRun) -> list[str]:
    """What is told of a run that has not ended, or of a real building, whose run has no end."""
    if run.building.is_real:
        return _at_a_building(run)
    notes = []
    for name in run.cut_off:
        result = run.results[name]
        last_sample = result.steps[-1].samples[-1]
        end_s, days = last_sample.start_s + last_sample.duration_s, result.period.scored_s / DAY_S
        days_done = (end_s - result.period.start_s) / DAY_S
        notes.append(
            f"{name} was cut off after {days_done:.3g} of {days:g} days, at {run.building.in_words(end_s)}. Its "
            "figures are those until then, from metered power and the temperatures at the ends of blocks."
        )
        b = result.steps[0].boundary
        if (b.heating_price_per_kWh != b.price_per_kWh).any():
            notes.append(
                "Heating has a carrier of its own: until then its fan's electricity counts at the price of gas."
            )
    absent = [name for name in (run.scenario.controller.name, *run.scenario.baselines) if name not in run.results]
    if absent:
        notes.append(f"{', '.join(absent)} had not begun.")
    early = folder / "INCOMPLETE.txt"
    if notes and early.is_file():
        notes.append(read_bounded(early, _MOST_BYTES, InputError).decode("utf-8", "replace")[:500].strip())
    if notes and not is_complete(folder):
        notes.append(f"“tf-mpc resume {folder}” goes on with a run that was ended before its time.")
    return notes


def _at_a_building(run: ToldRun) -> list[str]:
    notes = []
    for name, result in run.results.items():
        first, last = result.samples[0], result.samples[-1]
        begun, ended = (run.building.in_words(at) for at in (first.start_s, last.start_s + last.duration_s))
        notes.append(
            f"{name} at {run.building.name}, {begun} to {ended}. Cost is that of metered power at the prices in force, "
            "discomfort that of the readings at the ends of blocks."
        )
    if not run.building.area_m2 > 0.0:
        notes.append("Figures per m² are not known: the map has no floor_area_m2.")
    return notes


def _so_far(result: RunResult, building: ToldBuilding, told: Mapping[str, Any]) -> RunResult:
    """A result with figures of its own where the plant's are not there: until the last step that ended.

    The user's own KPIs are those that the run had `told`: a report runs no code of a run's folder.
    """
    if "ener_tot" in result.kpis:
        everyone = {str(told.get("controller")): told.get("kpis", {}), **told.get("baselines", {})}
        own = own_of(everyone.get(result.controller, {}))
        return replace(result, kpis=result.kpis | {key: float("nan" if v is None else v) for key, v in own.items()})
    course = course_of(result, building.layout, building.area_m2, len(result.steps) * 1000)
    energy_J = np.nansum(course.power_W * course.duration_s)
    kpis = {
        "cost_tot": float(course.cost[-1]),
        "ener_tot": float(energy_J / J_PER_KWH / building.area_m2),
        "tdis_tot": float(course.discomfort_Kh[:, -1].mean()),
    }
    return replace(result, kpis={**kpis, **result.kpis})


def _json(path: Path) -> dict[str, Any]:
    return read_json(path, _MOST_BYTES) if path.is_file() else {}
