"""Alternatives of a decision of a run: from its journal, and the model kept beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from controllers.registry import build_controller, find_entry
from thermoforce_mpc.data import Plan, PlanStatus
from thermoforce_mpc.errors import ArtifactError, DataError
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import validate
from thermoforce_mpc.simulation.checks import validate_scenario
from thermoforce_mpc.simulation.composition import controller_options
from thermoforce_mpc.simulation.folder.run_folder import kept_model
from thermoforce_mpc.simulation.journal.journal import NAME, making_sense, read_run
from thermoforce_mpc.simulation.outside import CODE, unknown
from thermoforce_mpc.simulation.views.explaining import Decision

if TYPE_CHECKING:  # CasADi is loaded only where there is a model
    from controllers.mpc.alternatives import Alternatives

# What a plan would have been made on does not matter here, so no weights are loaded.
_FREE_RESPONSE = {"name": "linear_weather", "options": {}}


def alternatives_of(folder: Path, decision: Decision) -> Alternatives | str:
    """What else could have been done, or why that cannot be said.

    Raises:
        JournalError: the journal is damaged.
    """
    with making_sense(folder / NAME):
        return _alternatives_of(folder, decision)


def _alternatives_of(folder: Path, decision: Decision) -> Alternatives | str:
    if decision.plan and not {"lower_C", "upper_C"} <= set(decision.plan):
        return "the journal, of an earlier release, does not hold the bounds that the plan kept"
    entries = read_run(folder / NAME).entries
    scenario = validate(Scenario, dict(entries[0].content["scenario"]), f"{folder / NAME}, line 1")
    name = decision.controller
    code = [one.value for one in unknown(scenario) if one.key == CODE]
    if code or name not in (scenario.controller.name, *scenario.baselines):
        return f"they need what you have not given here before, or what was changed since: {', '.join(code) or name}"
    if not find_entry(name).needs_model:
        return f"{name} acts without a model"
    models: Mapping[str, Any] = next((entry.content["models"] for entry in entries if entry.kind == "models"), {})
    entry: Mapping[str, Any] = models.get(name, {})
    if not entry.get("folder"):
        return f"there is no model: {entry.get('refused') or 'the run was given one that it did not keep'}"
    from controllers.mpc.alternatives import alternatives
    from controllers.mpc.controller import ThermoForceMPC
    from thermoforce_mpc.model.thermal_model import load_model

    options = controller_options(scenario, name) | {"free_response": _FREE_RESPONSE}
    try:
        model = load_model(kept_model(folder, entry["folder"]))
        controller = build_controller(name, options, validate_scenario(scenario), model)
        assert isinstance(controller, ThermoForceMPC)
        return alternatives(controller, decision.observation, _planned(decision), _peak_W(decision))
    except (ArtifactError, DataError) as error:
        return str(error)


def _planned(decision: Decision) -> Plan | None:
    """The plan without its blocks; None where nothing was planned."""
    if not decision.plan:
        return None
    told = decision.step.told
    plan = Plan((), PlanStatus(told["status"]), told["why"], margins=decision.margins, names=decision.step.names)
    courses: dict[str, Any] = dict(decision.plan)
    return replace(plan, **courses)


def _peak_W(decision: Decision) -> float:
    """Highest mean power of the building over a step of the run before the decision, W."""
    history = decision.observation.history
    since = history.power_W[:, history.time_s[:-1] >= decision.steps[0].time_s].sum(axis=0)
    return float(np.nanmax(since, initial=0.0))


def alternatives_json(alternatives: Alternatives | str) -> dict[str, Any]:
    """All of it, for programs."""
    if isinstance(alternatives, str):
        return {"none": alternatives}
    courses = [
        asdict(course) | {"u": course.u.tolist(), "T_zone_C": course.T_zone_C.tolist(), "total": course.total}
        for course in alternatives.courses
    ]
    return {"courses": courses, "notes": list(alternatives.notes), "reason": alternatives.reason}
