"""The results of a run in its folder: configuration, trajectories, step log, KPIs and manifest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.files import file_sha256
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.simulation.closed_loop import RunResult
from thermoforce_mpc.simulation.folder.capped import capped_figures
from thermoforce_mpc.simulation.folder.plain_files import write_plain
from thermoforce_mpc.simulation.folder.run_folder import (
    LOCK,
    environment,
    file_stem,
    steps_frame,
    trajectory_frame,
    write_json,
)
from thermoforce_mpc.simulation.scenario_result import ScenarioResult
from thermoforce_mpc.simulation.views.watching import gates_held


def write_results(folder: Path, outcome: ScenarioResult, command: Sequence[str], currency: str) -> dict[str, Any]:
    """Write resolved configuration, trajectories, step log, KPIs and the manifest with hashes of the other files.

    Returns:
        The content of `kpis.json`.
    """
    scenario, plant, result, baselines = outcome.scenario, outcome.plant, outcome.result, outcome.baselines
    resolved = yaml.safe_dump(scenario.model_dump(mode="json"), sort_keys=False)
    write_plain(folder / "scenario.yaml", resolved)
    write_plain(folder / "trajectory.csv", trajectory_frame(result.steps).to_csv(index=False))
    write_plain(folder / "steps.csv", steps_frame(result.steps).to_csv(index=False))
    for name, baseline in baselines.items():
        write_plain(folder / f"trajectory_{file_stem(name)}.csv", trajectory_frame(baseline.steps).to_csv(index=False))
    kpis = figures_of(scenario, asdict(plant), result, baselines, outcome.equal_in_words(currency))
    write_json(folder / "kpis.json", kpis)
    table = pd.DataFrame.from_dict(outcome.kpis, orient="index")
    write_plain(folder / "kpis.csv", table.to_csv(index_label="controller"))
    manifest = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": list(command),
        "seed": scenario.seed,
        "environment": environment(),
        "plant": asdict(plant),
        "identification": dict(outcome.identification),
        "planning": {name: counts.to_json() for name, counts in outcome.planning.items()},
        "forecaster": dict(outcome.forecaster),
        "fallbacks": {"controller": result.fallback_levels()}
        | {name: baseline.fallback_levels() for name, baseline in baselines.items()},
        "seconds": {run.controller: run.seconds for run in (result, *baselines.values())},
        "sha256": {
            path.name: file_sha256(path) for path in sorted(folder.iterdir()) if path.is_file() and path.name != LOCK
        },
    }
    write_json(folder / "manifest.json", manifest)
    return kpis


def figures_of(
    scenario: Scenario, plant: Mapping[str, Any], result: RunResult, baselines: Mapping[str, RunResult], equal: str
) -> dict[str, Any]:
    """The content of `kpis.json`; `plant` is a `PlantInfo` in JSON, `equal` what is as comfortable, in words."""
    return {
        "testcase": plant.get("testcase", ""),
        "plant": f"{plant.get('kind')}: {plant.get('description')}",
        "weather": plant.get("weather", ""),
        "period": scenario.period,
        "start_day": result.period.start_s / DAY_S,
        "scored_days": result.period.scored_s / DAY_S,
        "price": scenario.price,
        "controller": result.controller,
        "kpis": result.kpis,
        "baselines": {name: baseline.kpis for name, baseline in baselines.items()},
        "equal_comfort": equal,
        "gate": {name: asdict(gate) for name, gate in gates_held(result, baselines).items()},
        "power_cap": capped_figures(scenario, result, baselines),
    }
