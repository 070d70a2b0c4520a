"""What `tf-mpc run` says of a run: what is run, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from controllers.registry import find_entry
from thermoforce_mpc.data import DAY_S, Period
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.simulation.folder.capped import Capped
from thermoforce_mpc.simulation.scenario_result import ScenarioResult
from thermoforce_mpc.simulation.views.display import RunDisplay
from thermoforce_mpc.simulation.views.verdict import verdict
from thermoforce_mpc.simulation.views.watching import gates_held, watch_spells


def headline(plant: Plant, period: Period, scenario: Scenario) -> str:
    """What is run, in three lines."""
    info = plant.info
    return (
        f"Plant: {info.kind} {info.testcase} ({info.description})\n"
        f"Weather: {info.weather}\n"
        f"Window: {_window(period)}, {scenario.price} tariff; controller {scenario.controller.name}"
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
    title = f"{plant.kind} plant, {plant.weather}\n{_window(period)}, {outcome.scenario.price} tariff"
    gates = {name: gate.in_words() for name, gate in gates_held(outcome.result, outcome.baselines).items()}
    display.kpi_table(outcome.kpis, title, currency, gates)
    if equal := outcome.equal_in_words(currency):
        display.say(equal)
    for name, figures in power_cap.items():
        display.say(f"{name}: {Capped(**figures).in_words()}")
    if find_entry(outcome.scenario.controller.name).needs_model:
        display.say(f"{outcome.result.controller}: {outcome.planning[outcome.result.controller].in_words()}")
    levels = outcome.result.fallback_levels()
    fallbacks = {level: n for level, n in levels.items() if n and level not in ("solved", "rule", "gate")}
    if fallbacks:
        display.say(f"Fallbacks: {fallbacks}; reasons in {folder / 'steps.csv'}")
    for spell in watch_spells(outcome.result):
        display.say(f"Watch: {spell.in_words()}")
