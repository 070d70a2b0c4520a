"""Identification before a scored window: settings, probing of the plant, and the identified model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from controllers.entries.entry import Chosen
from controllers.registry import choose
from thermoforce_mpc.data import Period, Record
from thermoforce_mpc.loop.probing import Identifying, Probed, ProbingProgress, probe_until_known
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.records.recorded_plant import (
    find_probing,
    keeping_probing,
    note_end,
    place_of_journals,
    told_probing,
)
from thermoforce_mpc.scenario.comfort import Comfort
from thermoforce_mpc.scenario.scenario import PlantSpec, ProbingSpec, Scenario
from thermoforce_mpc.scenario.settings import merge, validate
from thermoforce_mpc.scenario.testcase import Actuator, TestCase

if TYPE_CHECKING:  # the predictor is loaded only when a controller needs it
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.probing.probe import ProbingConfig
    from thermoforce_mpc.model.thermal_model import ThermalModel

# Trials of part load, as shares of the highest level, and steps at each where only the temperature tells their heat.
_TRIAL_SHARES, _UNMETERED_STEPS = (0.5, 0.25), 8


@dataclass(frozen=True)
class IdentificationTask:
    """All inputs of an identification before a window; `run_identification` uses nothing else.

    `period`: scored window, which is not probed; `days`, `most_days`, `end_early`: see `identify_on`; `step_s`: step of
    the model, s; `seed`: of the probing and of the forecast errors in `plant`, which the probing design uses; `probed`:
    folder of a run whose probing is taken, see `find_probing`; `comfort`: bounds in the place of the plant's.
    """

    testcase: TestCase
    plant: PlantSpec
    period: str
    days: float
    most_days: float
    end_early: bool
    step_s: float
    seed: int
    probing: ProbingConfig
    identification: IdentificationConfig
    probed: str | None = None
    comfort: Comfort | None = None

    @property
    def how_probed(self) -> dict[str, Any]:
        """What tells a probing from others of the same building."""
        values = self.to_json()
        return {name: values[name] for name in ("seed", "probing", "identification")}

    @property
    def probed_files(self) -> str | None:
        """The file or folder that is read of `probed`."""
        return None if self.probed is None else str(place_of_journals(Path(self.probed)))

    def in_words(self, keep: Path | None = None) -> str:
        """What is done, for people; `keep`: journal of the probing, see `run_identification`."""
        if self.probed is not None:
            return f"Identifying from the probing in {self.probed}"
        told = told_probing(keep) if keep else None
        if told is None:
            return f"Probing for {self.days:g} days and identifying"
        return "Identifying" if told.has_ended else f"Probing goes on after {told.days:.3g} recorded days"

    def to_json(self) -> dict[str, Any]:
        """All fields as JSON values, for a hash key or a file."""
        values = ((item.name, getattr(self, item.name)) for item in fields(self))
        return {
            name: value.model_dump(mode="json") if isinstance(value, BaseModel) else value for name, value in values
        }


@dataclass(frozen=True)
class IdentifiedModel:
    """A model and its origin, for the manifest; `refused` says why there is none where the data could not be fitted."""

    model: ThermalModel | None
    origin: Mapping[str, Any]
    refused: str = ""

    @property
    def acts_on(self) -> ThermalModel | str:
        """What a controller is built with: the model, or the reason why there is none."""
        return self.refused if self.model is None else self.model


def identify_on(
    plant: Plant,
    *,
    before: Period,
    days: float,
    most_days: float | None = None,
    end_early: bool = False,
    testcase: TestCase | None = None,
    step_s: float | None = None,
    seed: int = 1,
    probing: ProbingConfig | None = None,
    config: IdentificationConfig | None = None,
) -> ThermalModel:
    """Probe `plant` for `days` that end where the warm-up of `before` begins, and identify a model from them.

    If they would begin before the start of the year, the last days of the year are probed instead.

    Args:
        most_days: where the model is not competent after `days`, or its effect known to worse than 30 %, probing goes
            on on the same run, day by day, until neither is so, this many days are over, or `before` (or a new year)
            begins; by default it does not.
        end_early: end before `days`, not before 1.5 days, once a model is competent and its effect known well.
        testcase: mode, floor area and default step; by default those of `bestest_hydronic_heat_pump`.
        step_s: step of the model; by default the test case's.

    Raises:
        DataError: the record is not sufficient for identification; the message has numbers and advice.
        PlantError: the plant failed.
    """
    from thermoforce_mpc.identification.config import IdentificationConfig

    testcase = testcase or load_testcase("bestest_hydronic_heat_pump")
    identifying = Identifying(testcase, config or IdentificationConfig(), step_s)
    probed, look = probe_until_known(
        plant,
        identifying,
        before=before,
        days=days,
        most_days=most_days or days,
        end_early=end_early,
        seed=seed,
        probing=probing,
    )
    return identifying.conclude(probed, look)


def may_act(model: ThermalModel) -> bool:
    """Whether a controller may act on a model: no actuator's card says otherwise or is without a verdict."""
    return not any(card.unfit for card in model.cards)


def chosen_of(scenario: Scenario, testcase: TestCase, controller: str | None = None) -> Chosen:
    """A controller of a scenario, by default its own, with its options; raises `ConfigError` as `choose`."""
    own = scenario.controller
    name = controller or own.name
    return choose(name, own.options if name == own.name else {}, testcase, scenario.comfort, scenario.step_s)


def identification_settings(scenario: Scenario, chosen: Chosen) -> tuple[ProbingConfig, IdentificationConfig]:
    """Probing and identification settings of a scenario for a controller; `ConfigError` names wrong keys.

    By default the machine is probed at the levels that this controller uses: those between lowest and full if it
    modulates, off and full if it switches. Where that is to be decided (actuation mode auto), a few steps at half level
    are added; where heat is not metered, more of them, and at a quarter too.
    """
    spec, testcase = scenario.identification, chosen.testcase
    metered = all(actuator.heat.units for actuator in testcase.points.actuators)
    actuation = getattr(chosen.config, "actuation", None)
    shipped = testcase.defaults
    derived: dict[str, Any] = {}
    if any(machine.supply is not None for machine in testcase.machines.values()):
        derived["power_curve"] = True
    if isinstance(testcase.actuator, Actuator) and testcase.actuator.map == "radiator" and not metered:
        derived["heat_input"] = "identity"  # the level of a radiator map is heat
    of_testcase = merge(derived, shipped.identification)
    return settings_for(actuation, metered, spec, scenario.seed, shipped.probing, of_testcase)


def settings_for(
    actuation: Any,
    metered: bool,
    spec: ProbingSpec,
    seed: int,
    probing_defaults: Mapping[str, Any] | None,
    identification_defaults: Mapping[str, Any] | None = None,
) -> tuple[ProbingConfig, IdentificationConfig]:
    """Settings for a controller with this `actuation` (None: a rule), at a building whose heat is `metered` or not.

    The defaults are those of the building, the options of `spec` the user's. Raises `ConfigError` naming a wrong key.
    """
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.identification.probing.probe import ProbingConfig

    of_building, defaults = dict(probing_defaults or {}), dict[str, Any]()
    if actuation is not None and actuation.mode in ("modulating", "supply"):
        # Probe the intermediate levels that a plan can use.
        defaults["levels"] = (0.0, *np.linspace(actuation.lowest_level, 1.0, 5).round(3).tolist())
    elif actuation is not None:
        defaults["levels"] = (0.0, actuation.level)
        if actuation.mode == "auto" and "levels" not in {**of_building, **spec.probing}:
            defaults["trial_levels"] = tuple(share * actuation.level for share in _TRIAL_SHARES)
            if not metered:
                defaults["trial_steps"] = _UNMETERED_STEPS
    given = merge(defaults, of_building)
    probing = validate(ProbingConfig, merge(given, spec.probing), "identification.probing")
    derived: dict[str, Any] = {"seed": seed}
    between = [level for level in (*probing.levels, *probing.trial_levels) if 0.0 < level < max(probing.levels)]
    if actuation is not None and actuation.mode == "auto" and between:
        derived["lowest_level"] = min(between)  # these levels are held, not made by cycling
    elif actuation is not None and actuation.mode == "duty" and max(probing.levels) <= actuation.level < 1.0:
        derived["lowest_level"] = actuation.level  # blocks at part load, the only level that there is
    if probing.trial_levels and not metered:
        derived["part_load"] = True
    options = merge(merge(derived, dict(identification_defaults or {})), spec.options)
    return probing, validate(IdentificationConfig, options, "identification.options")


def identification_task(scenario: Scenario, chosen: Chosen) -> IdentificationTask:
    """What is to be identified of a scenario's plant for a controller; raises `ConfigError` for a wrong setting."""
    testcase = chosen.testcase
    probing, config = identification_settings(scenario, chosen)
    return IdentificationTask(
        testcase=testcase,
        plant=scenario.plant,
        period=scenario.period,
        days=scenario.identification.days,
        most_days=max(scenario.identification.days, scenario.identification.most_days),
        end_early=scenario.identification.end_early,
        step_s=scenario.step_s or testcase.step_s,
        seed=scenario.seed,
        probing=probing,
        identification=config,
        probed=scenario.identification.probed,
        comfort=scenario.comfort,
    )


def run_identification(
    task: IdentificationTask,
    plant: Plant,
    on_record: Callable[[Record], None] | None = None,
    on_progress: Callable[[ProbingProgress], None] | None = None,
    *,
    keep: Path | None = None,
    say: Callable[[str], None] | None = None,
) -> ThermalModel:
    """Identify a model from the probing that `task` names, or from that of `plant`, which must be that of `task`.

    `on_record` gets the record that was identified from; `keep`: journal of the probing; one that is there is gone on
    with, and where it has ended, nothing is probed; `say`: told why probing ended.

    Raises:
        DataError: the record is not sufficient for identification.
        PlantError: the plant failed.
        JournalError: a journal of the probing cannot be used; names the file.
    """
    identifying = Identifying(task.testcase, task.identification, task.step_s, say)
    probed, look = taken_probing(task, keep), None
    if probed is None:
        with keeping_probing(plant, keep, task.testcase, task.how_probed) as kept:
            probed, look = probe_until_known(
                kept,
                identifying,
                before=kept.period(task.period),
                days=task.days,
                most_days=task.most_days,
                end_early=task.end_early,
                seed=task.seed,
                probing=task.probing,
                on_progress=on_progress,
            )
            note_end(kept, probed.why)
    if on_record:
        on_record(probed.record)
    return identifying.conclude(probed, look)


def taken_probing(task: IdentificationTask, keep: Path | None = None) -> Probed | None:
    """The probing that need not be made: that which the task names, or one that has ended in the journal `keep`.

    Raises `ConfigError` and `JournalError` as `find_probing`.
    """
    if task.probed is not None:
        return find_probing(Path(task.probed), task.testcase, task.how_probed)
    told = told_probing(keep) if keep else None
    return told.probed if told and told.has_ended else None


def model_for(source: SavedModel | IdentificationTask, plant: Plant) -> ThermalModel:
    """The model that comes from there: loaded, or newly identified on `plant`.

    Raises:
        ArtifactError, DataError, PlantError: as `SavedModel.load` and `run_identification`.
    """
    return source.load() if isinstance(source, SavedModel) else run_identification(source, plant)


@dataclass(frozen=True)
class SavedModel:
    """A model that is there already: its folder, and the step that it is taken at, s."""

    folder: str
    step_s: float

    def load(self) -> ThermalModel:
        """The model at this step; raises `ArtifactError`."""
        from thermoforce_mpc.model.thermal_model import load_model

        model = load_model(Path(self.folder))
        if model.operator.step_s == self.step_s:
            return model
        return replace(model, operator=model.operator.resampled(self.step_s))
