"""What a run decided at an instant, why, and what else could have been done: read from its journal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Boundary, Observation, steps_in
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.errors import ArtifactError, DataError, InputError
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.experiment.outside import CODE, HUB, unknown
from thermoforce_mpc.files import check_plain
from thermoforce_mpc.records.journal import NAME, JournalError, making_sense, margins_of, planned_of, read_run
from thermoforce_mpc.records.run_folder import kept_model
from thermoforce_mpc.records.told_steps import (
    ToldBuilding,
    ToldStep,
    forecast_of,
    history_before,
    models_before,
    told_building,
    told_loops,
    told_steps,
)
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import validate

if TYPE_CHECKING:
    from controllers.mpc.alternatives import Alternatives


# A planned temperature nearer to its bound than this is bound by it, K.
_BINDING_K = 0.05
# Mean effect of what is planned from which a margin has a share of it, K.
_HELD_K = 1.0
# Latest instants at which a run learned something that are told.
_MOST_LEARNED = 10


@dataclass(frozen=True)
class ExplainedStep:
    """One step of a run: what was known, planned, decided and done.

    `steps` are those of the loop until then, this one last; `boundary` the forecast it was made on, gaps filled as in
    the run; `plan` the planned courses and `margins` those of the first step, by name (rows as in `Plan`);
    `building`: where.
    """

    controller: str
    steps: tuple[ToldStep, ...]
    boundary: Boundary
    plan: Mapping[str, Array]
    margins: Mapping[str, Array]
    building: ToldBuilding

    @property
    def step(self) -> ToldStep:
        """The step."""
        return self.steps[-1]

    @property
    def observation(self) -> Observation:
        """What it was made on."""
        return Observation(history_before(self.steps), self.boundary)

    @property
    def T_zone_C(self) -> Array:
        """Planned zone temperatures (Z, N), °C."""
        return compose(self.plan["T_free_C"], self.plan["T_forced_K"])

    def bounds(self) -> list[str]:
        """What binds in the plan, zone by zone: the comfort bound it touches first, and what it violates."""
        if not self.plan:
            return []
        sentences = []
        n = self.T_zone_C.shape[-1]
        for z, zone in enumerate(self.step.names.zones):
            lower_C, upper_C = self.boundary.lower_C[z, 1 : n + 1], self.boundary.upper_C[z, 1 : n + 1]
            T, of = self.T_zone_C[z, : lower_C.size], "" if self.step.names.single else f"{zone}: "
            near = {"lower": T - lower_C, "upper": upper_C - T}
            touched = [
                (int(np.argmax(gap <= _BINDING_K)), side) for side, gap in near.items() if (gap <= _BINDING_K).any()
            ]
            if touched:
                at, side = min(touched)
            else:
                side, gap = min(near.items(), key=lambda item: float(np.nanmin(item[1])))
                at = int(np.nanargmin(gap))
            when_h = (self.boundary.time_s[at + 1] - self.step.time_s) / HOUR_S
            bound_C = float((lower_C if side == "lower" else upper_C)[at])
            if not touched:
                sentences.append(
                    f"{of}nearest is the {side} comfort bound, {bound_C:.1f} °C, {near[side][at]:.2f} K away in "
                    f"{when_h:.3g} h: plans keep a margin"
                )
                continue
            sentences.append(f"{of}the {side} comfort bound, {bound_C:.1f} °C, binds first, in {when_h:.3g} h")
            outside = {side: float(-np.nanmin(gap)) for side, gap in near.items()}
            worst = max(outside, key=lambda name: outside[name])
            if outside[worst] > _BINDING_K:
                sentences.append(f"{of}the plan is up to {outside[worst]:.2f} K outside the {worst} bound")
        return sentences

    def learned(self) -> list[str]:
        """What the run had learned of sensors, meters, hours and limits before this step, each with its instant: the
        latest of it.
        """
        told = [
            f"{self.building.in_words(step.time_s)}: {news}"
            for step in self.steps[:-1]
            if (news := step.told.get("news"))
        ]
        more = len(told) - _MOST_LEARNED
        return [f"{more} times more before"] * (more > 0) + told[-_MOST_LEARNED:]

    def margins_in_words(self) -> list[str]:
        """What the plan kept inside the comfort bounds of its first step, zone by zone, and what it learned else.

        What it costs is what holds a room so much warmer, or cooler, of what holds it where it is planned.
        """
        margins, lines = self.margins, []
        for z, zone in enumerate(self.step.names.zones if margins else ()):
            of = "" if self.step.names.single else f"{zone}: "
            parts = []
            for b, bound in enumerate(("lower", "upper")):
                sizes_K = {name: values[b, z] for name, values in margins.items() if values.ndim == 2}
                listed = ", ".join(f"{name} {size_K:.2f}" for name, size_K in sizes_K.items() if round(size_K, 2))
                whole_K = max(sum(sizes_K.values()), 0.0)
                parts.append(f"{whole_K:.2f} K inside the {bound} bound" + (f" ({listed})" if listed else ""))
                held_K = float(np.mean(self.plan["T_forced_K"][z])) * (1.0 if bound == "lower" else -1.0)
                if whole_K and held_K > _HELD_K:
                    parts[-1] += f", about {100.0 * whole_K / held_K:.1f} % of the plan's energy"
            if round(offset_K := float(margins["offset"][z]), 2):
                parts.append(f"prediction moved by {offset_K:+.2f} K")
            lines.append(of + ", ".join(parts))
        for machine, unused in zip(self.step.names.machines, margins.get("unused_capacity", ()), strict=False):
            if round(unused, 2) > 0.0:
                lines.append(
                    f"{machine}: {100.0 * unused:.0f} % of its capacity left unused, which it did not give when asked"
                )
            elif round(unused, 2):
                lines.append(
                    f"{machine}: {-100.0 * unused:.0f} % more than the capacity of the record, which it gave since"
                )
        return lines


def decision_at(folder: Path, at: str | None = None, controller: str | None = None) -> ExplainedStep:
    """The step of the run in `folder` in force `at` an instant (`seconds_of`), by default the last.

    `controller`: whose, by default the first that was run (the scenario's own).

    Raises:
        JournalError: there is no journal, or it is damaged.
        ConfigError: there is a link in the folder.
        InputError: `at` is no time or outside the run, or `controller` did not run.
    """
    path = folder / NAME
    check_plain(folder)
    with making_sense(path):
        entries = read_run(path).entries
        building, loops = told_building(entries[0].content), told_loops(entries)
        if not loops:
            raise JournalError(f"{path}: no step was decided yet")
        name = controller or next(iter(loops))
        if name not in loops:
            raise InputError(f"--controller {name}: did not run; there are {', '.join(loops)}")
        steps = list(told_steps(loops[name]))
        if not steps:
            raise JournalError(f"{path}: {name} has not decided anything yet")
        if at is not None:
            seconds, first = building.seconds_of(at), steps[0].time_s
            end = steps[-1].time_s + (steps[1].time_s - first if len(steps) > 1 else HOUR_S)
            if not first <= seconds < end:
                words = f"{building.in_words(first)} to {building.in_words(end)}"
                ran = f"{name} ran from {words} ({first:.0f} to {end:.0f} s)"
                raise InputError(f"--at {at}: {ran}")
            steps = [step for step in steps if step.time_s <= seconds]
        told = steps[-1].told
        return ExplainedStep(name, tuple(steps), forecast_of(steps), planned_of(told), margins_of(told), building)


def hour_ends(n: int, step_s: float, hours: float) -> range:
    """Number of steps at the end of each of the first `hours` of a plan of `n` steps; of less than one hour its end."""
    every = steps_in(min(hours, 1.0) * HOUR_S, step_s)
    return range(every, min(n, max(every, round(hours * HOUR_S / step_s))) + 1, every)


def claims_of(folder: Path, decision: ExplainedStep) -> tuple[str, ...]:
    """What the model of the run found of sensors, meters, hours and neighbours (`ThermalModel.claims`); none where
    there is no model, or it cannot be read. Raises `JournalError`.
    """
    from thermoforce_mpc.model.thermal_model import load_model

    with making_sense(folder / NAME):
        entry: Mapping[str, Any] = models_before(read_run(folder / NAME).entries).get(decision.controller, {})
        if not entry.get("folder"):
            return ()
        try:
            return load_model(kept_model(folder, entry["folder"])).claims
        except ArtifactError:
            return ()  # `alternatives_of` says why


# What a plan would have been made on does not matter here, so no weights are loaded.
_FREE_RESPONSE: dict[str, Any] = {"name": "linear_weather", "options": {}}


def alternatives_of(folder: Path, decision: ExplainedStep) -> Alternatives | str:
    """What else could have been done, or why that cannot be said; raises `JournalError`."""
    with making_sense(folder / NAME):
        entries = read_run(folder / NAME).entries
        scenario = validate(Scenario, dict(entries[0].content["scenario"]), f"{folder / NAME}, line 1")
        name, real = decision.controller, decision.building.is_real
        # At a real building the MPC controls, and no code of a scenario.
        code = [] if real else [one.value for one in unknown(scenario) if one.key in (CODE, HUB)]
        if code or name not in (scenario.controller.name, *scenario.baselines):
            unclear = ", ".join(code) or name
            return f"they need what you have not given here before, or what was changed since: {unclear}"
        contestant = None if real else Experiment.of(scenario).contestant(name)
        if not real and (contestant is None or not contestant.chosen.needs_model):
            return f"{name} acts without a model"
        entry: Mapping[str, Any] = models_before(entries).get(name, {})
        if not entry.get("folder"):
            return f"there is no model: {entry.get('refused') or 'the run was given one that it did not keep'}"
        from controllers.mpc.alternatives import alternatives
        from controllers.mpc.config import FreeResponseConfig, MPCConfig
        from controllers.mpc.controller import ThermoForceMPC
        from controllers.mpc.state import MPCState, metered_W
        from thermoforce_mpc.model.thermal_model import load_model

        options = scenario.controller.options
        config = contestant.chosen.config if contestant else validate(MPCConfig, options, f"{folder / NAME}")
        assert isinstance(config, MPCConfig)
        config = config.model_copy(update={"free_response": FreeResponseConfig(**_FREE_RESPONSE)})
        try:
            model = load_model(kept_model(folder, entry["folder"]))
            # What a real building is told in the place of levels does not matter here.
            controller = (
                replace(contestant.chosen, config=config).build(model) if contestant else ThermoForceMPC(model, config)
            )
            assert isinstance(controller, ThermoForceMPC)
            planned = decision.step.plan if decision.plan else None
            observation, begin_s = decision.observation, decision.steps[0].time_s
            since = observation.history.time_s[:-1] >= begin_s
            # Highest mean power of the building over a step of the run, or month, before the decision.
            aims = config.objective
            power_W = metered_W(observation.history, observation.boundary, at_the_meter=aims.at_the_meter)
            peak_W = float(np.nanmax(power_W[since], initial=0.0))
            if aims.peak_of != "run":
                peak_W = MPCState(begin_s).peak_after(observation, aims.peak_of, at_the_meter=aims.at_the_meter)
            return alternatives(controller, observation, planned, peak_W)
        except (ArtifactError, DataError) as error:
            return str(error)


def alternatives_json(alternatives: Alternatives | str) -> dict[str, Any]:
    """All of it, for programs."""
    if isinstance(alternatives, str):
        return {"none": alternatives}
    courses = [
        asdict(course) | {"u": course.u.tolist(), "T_zone_C": course.T_zone_C.tolist(), "total": course.total}
        for course in alternatives.courses
    ]
    return {"courses": courses, "notes": list(alternatives.notes), "reason": alternatives.reason}
