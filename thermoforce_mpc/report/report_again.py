"""The report of a run made again from its folder, also of a run that was cut off or is under way."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.data import DAY_S, J_PER_KWH
from thermoforce_mpc.errors import ArtifactError, InputError
from thermoforce_mpc.files import check_plain, read_bounded
from thermoforce_mpc.loop.closed_loop import RunResult
from thermoforce_mpc.records.run_folder import is_complete, kept_model, own_of, write_json
from thermoforce_mpc.records.told_steps import ToldBuilding, ToldRun, told_run
from thermoforce_mpc.report.findings import figures_of

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
    from thermoforce_mpc.report import write_report

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
    from thermoforce_mpc.report.courses import course_of

    course = course_of(result, building.layout, building.area_m2, len(result.steps) * 1000)
    energy_J = np.nansum(course.power_W * course.duration_s)
    kpis = {
        "cost_tot": float(course.cost[-1]),
        "ener_tot": float(energy_J / J_PER_KWH / building.area_m2),
        "tdis_tot": float(course.discomfort_Kh[:, -1].mean()),
    }
    return replace(result, kpis={**kpis, **result.kpis})


def _json(path: Path) -> dict[str, Any]:
    return dict(json.loads(read_bounded(path, _MOST_BYTES, InputError))) if path.is_file() else {}
