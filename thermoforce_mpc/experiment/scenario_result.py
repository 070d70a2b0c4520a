"""A scenario that was run: its results, as they are written and said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import yaml

from thermoforce_mpc.data import DAY_S, Period, PlantInfo
from thermoforce_mpc.errors import ConfigError, counted
from thermoforce_mpc.experiment.equal_comfort import AsComfortable
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.files import file_sha256
from thermoforce_mpc.loop.closed_loop import RunResult
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.records.plain_files import write_plain
from thermoforce_mpc.records.run_folder import (
    LOCK,
    environment,
    file_stem,
    steps_frame,
    times_frame,
    trajectory_frame,
    write_json,
)
from thermoforce_mpc.report.display import RunDisplay
from thermoforce_mpc.report.findings import (
    COST,
    Capped,
    Planning,
    figures_of,
    gates_held,
    planning_of,
    verdict,
    watch_spells,
    without_times,
)
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import suggestion

if TYPE_CHECKING:
    from thermoforce_mpc.model.thermal_model import ThermalModel


@dataclass(frozen=True)
class ScenarioResult:
    """A scenario that was run: the controller's closed loop and its baselines' on the same plant and window.

    `identification` and `forecaster` are what the manifest says of the models and of the frozen weights. `equal`: the
    thermostat that is as comfortable; None where it was not searched.
    """

    experiment: Experiment
    plant: PlantInfo
    result: RunResult
    baselines: Mapping[str, RunResult]
    models: Mapping[str, ThermalModel]
    identification: Mapping[str, Any]
    forecaster: Mapping[str, Any]
    equal: AsComfortable | None = None

    @property
    def scenario(self) -> Scenario:
        """The scenario that was run."""
        return self.experiment.written

    @property
    def kpis(self) -> dict[str, dict[str, float]]:
        """BOPTEST's KPIs by controller, the scenario's own first."""
        return {name: dict(result.kpis) for name, result in self._results().items()}

    @property
    def planning(self) -> dict[str, Planning]:
        """How each controller planned: solves by solver, calls of the exported operator, parameters."""
        return {name: planning_of(result, self.models.get(name)) for name, result in self._results().items()}

    def to_dataframe(self, controller: str | None = None) -> pd.DataFrame:
        """The trajectory of a controller, by default the scenario's own, a row a block; raises `ConfigError`."""
        results = self._results()
        name = controller or self.result.controller
        if name not in results:
            raise ConfigError(f"no run of '{name}'{suggestion(name, results)}; there are {', '.join(results)}")
        return trajectory_frame(results[name].steps)

    def equal_in_words(self, currency: str) -> str:
        """The controller beside a thermostat that is as comfortable; '' where none was searched."""
        if self.equal is None:
            return ""
        return f"{self.result.controller} costs {self.equal.in_words(self.result.kpis[COST], currency)}"

    def _results(self) -> dict[str, RunResult]:
        return {self.result.controller: self.result, **self.baselines}


def write_results(folder: Path, outcome: ScenarioResult, command: Sequence[str], currency: str) -> dict[str, Any]:
    """Write configuration, trajectories, step log, KPIs, manifest with hashes; returns what `kpis.json` holds.

    Equal runs write equal files, but for `times.csv` and the manifest.
    """
    scenario, plant, result, baselines = outcome.experiment.written, outcome.plant, outcome.result, outcome.baselines
    resolved = yaml.safe_dump(scenario.model_dump(mode="json"), sort_keys=False)
    write_plain(folder / "scenario.yaml", resolved)
    write_plain(folder / "trajectory.csv", trajectory_frame(result.steps).to_csv(index=False))
    write_plain(folder / "steps.csv", steps_frame(result.steps).to_csv(index=False))
    for name, baseline in baselines.items():
        write_plain(folder / f"trajectory_{file_stem(name)}.csv", trajectory_frame(baseline.steps).to_csv(index=False))
    kpis = figures_of(scenario, asdict(plant), result, baselines, outcome.equal_in_words(currency))
    write_json(folder / "kpis.json", kpis)
    runs = {run.controller: run.steps for run in (result, *baselines.values())}
    write_plain(folder / "times.csv", times_frame(runs).to_csv(index=False))
    table = pd.DataFrame.from_dict({name: without_times(of) for name, of in outcome.kpis.items()}, orient="index")
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
        "time_rat": {run.controller: run.kpis["time_rat"] for run in (result, *baselines.values())},
        "sha256": {
            path.name: file_sha256(path) for path in sorted(folder.iterdir()) if path.is_file() and path.name != LOCK
        },
    }
    write_json(folder / "manifest.json", manifest)
    return kpis


def headline(plant: Plant, period: Period, experiment: Experiment) -> str:
    """What is run, in three lines."""
    info = plant.info
    return (
        f"Plant: {info.kind} {info.testcase} ({info.description})\n"
        f"Weather: {info.weather}\n"
        f"Window: {_window(period)}, {experiment.price} tariff; controller {experiment.own.name}"
    )


def _window(period: Period) -> str:
    first = period.start_s / DAY_S
    return f"{period.name}, days {first:g} to {first + period.scored_s / DAY_S:g}"


def print_summary(
    outcome: ScenarioResult, folder: Path, currency: str, power_cap: Mapping[str, Any], display: RunDisplay
) -> None:
    """Print the KPI table and what was out of the ordinary."""
    plant, period = outcome.plant, outcome.result.period
    said = verdict(outcome.result.controller, outcome.kpis, currency, period.scored_s / DAY_S)
    display.console.print(f"\n{said}\n", soft_wrap=True, markup=False)
    title = f"{plant.kind} plant, {plant.weather}\n{_window(period)}, {outcome.experiment.price} tariff"
    gates = {name: gate.in_words() for name, gate in gates_held(outcome.result, outcome.baselines).items()}
    display.kpi_table(outcome.kpis, title, currency, gates)
    if equal := outcome.equal_in_words(currency):
        display.say(equal)
    for name, figures in power_cap.items():
        display.say(f"{name}: {Capped(**figures).in_words()}")
    if outcome.experiment.own.chosen.needs_model:
        display.say(f"{outcome.result.controller}: {outcome.planning[outcome.result.controller].in_words()}")
    levels = outcome.result.fallback_levels()
    fallbacks = {level: n for level, n in levels.items() if n and level not in ("solved", "acceptable", "rule", "gate")}
    if unproved := levels["acceptable"]:
        display.say(f"Not shown to be the cheapest: {counted(unproved, 'plan')}, checked as all are")
    if fallbacks:
        display.say(f"Fallbacks: {fallbacks}; reasons in {folder / 'steps.csv'}")
    for spell in watch_spells(outcome.result):
        display.say(f"Watch: {spell.in_words()}")
