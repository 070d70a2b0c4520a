"""Taking a building into service step by step: points, trials, record, model, shadow; what is done and what is next.

What was found is kept in a file, so that it goes on where it was interrupted; what can be seen anew is read anew.
"""

from __future__ import annotations

import logging
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any
from zoneinfo import available_timezones

import numpy as np
import pandas as pd

from controllers.state_classes import model_key
from thermoforce_mpc.data.clock import ZONES_S
from thermoforce_mpc.data.layout import check_same_layout
from thermoforce_mpc.errors import ConfigError, DataError, InputError, PlantError, ThermoForceError, counted
from thermoforce_mpc.execution.keys import digest
from thermoforce_mpc.execution.progress import duration, figure
from thermoforce_mpc.files import plain_json, read_json, write_json
from thermoforce_mpc.identification.probing.operation import findings, telling_part
from thermoforce_mpc.live.building import LiveBuilding
from thermoforce_mpc.live.trial import Answered, TrialOutcome, TrialPlan
from thermoforce_mpc.measurements.checks import command_remarks, remarks
from thermoforce_mpc.measurements.load import Measurements, learned_commands, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.points import LivePoint, read_points
from thermoforce_mpc.model.thermal_model import load_model
from thermoforce_mpc.records.run_folder import MOST_BYTES, SHADOW

_LOG = logging.getLogger(__name__)
_FORMAT = 1
# What a model is learned from at least, days (as `measurements.signals` says); whole days before a shadow says
# what it would have saved.
_LEAST_DAYS, _SHADOW_DAYS = 2.9, 7
# Readings of fewer steps are a record that has just begun.
_BEGUN_STEPS = 3.0
_AHEAD_S = 24 * 3600.0
# Remarks on which nothing is tried: what would be set, or watched, is another thing.
_BARS = ("rooms swapped", "command is no command", "unit of temperature")


@dataclass(frozen=True, eq=False)
class PointsFound:
    """The points of a building, and what they say against one another.

    `problems`: for which nothing is tried; `doubts`: to be looked at; `measured`: the record, None where there is none
    yet; `bounds_C`: comfort bounds of rooms now.
    """

    points: tuple[LivePoint, ...]
    problems: tuple[str, ...]
    doubts: tuple[str, ...]
    measured: Measurements | None
    bounds_C: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class CommissioningStage:
    """One stage: `status` 'done', 'next', 'mend' or 'later', what is known of it, and the command that does it."""

    name: str
    status: str
    words: str
    command: str = ""


@dataclass(frozen=True)
class CommissioningFiles:
    """Where things are: connection and map, folder of this, model, folder of control, table of measurements.

    `has_history`: whether the connection gives its history as a table; `records`: whether what comes can be recorded.
    """

    config: str
    map_file: str
    out: str
    model: str
    control_out: str
    table: str
    has_history: bool = False
    records: bool = False

    def told(self, words: str, *names: str) -> str:
        """`tf-mpc WORDS`, in which each `{}` is one of `names` as a shell takes it."""
        return f"tf-mpc {words}".format(*map(shlex.quote, names))

    @property
    def again(self) -> str:
        """Goes on here."""
        return self.told("commission {} --map {} --out {}", self.config, self.map_file, self.out)

    @property
    def recorded(self) -> str:
        """Writes the history as a table, or records what comes."""
        words = self.told("record --map {} --connection {}", self.map_file, self.config)
        return words + (f" --days 365 --out {shlex.quote(self.table)}" if self.has_history else "")

    @property
    def identified(self) -> str:
        """Makes the model, of the table, which a connection with a history writes first."""
        words = self.told("identify --data {} --map {} --out {}", self.table, self.map_file, self.model)
        return f"{self.recorded} && {words}" if self.has_history and not Path(self.table).exists() else words

    def control(self, words: str, *names: str) -> str:
        """`tf-mpc control` with map and connection, and `words` as of `told`."""
        return self.told("control --map {} --connection {} " + words, self.map_file, self.config, *names)


def read_house(building: LiveBuilding, rules: MeasurementMap, now: pd.Timestamp) -> PointsFound:
    """Read all points and check them against one another, the map and the weather.

    Raises:
        PlantError: the connection failed.
        ConfigError, DataError: nothing of its table can be read.
    """
    table = building.table()
    points = read_points(table, rules, now)
    problems = [f"{point.key} (column {point.column}): {point.problem}" for point in points if point.problem]
    doubts = [f"{point.key} (column {point.column}): {doubt}" for point in points for doubt in point.doubts]
    doubts += [*_of_clock(building, rules, now), *_of_ages(points, rules)]
    measured, bounds = None, dict[str, tuple[float, float]]()
    if not any(not point.values.size for point in points):  # else it cannot be read as a whole
        try:
            measured = read_measurements(table, rules, now=now)
            bounds = _bounds_now(measured)
            told = _of_record(measured)
            problems += [words for kind, words in told if kind in _BARS]
            doubts += [words for kind, words in told if kind not in _BARS]
        except (DataError, ConfigError) as error:
            # What is only heard begins with now: that there are no steps yet is nothing to be looked at.
            if max(-float(point.at_s[0]) for point in points) > _BEGUN_STEPS * building.step_s:
                doubts.append(f"no record yet: {error}")
    if measured is not None:
        wrong, odd = _as_controlled(building, now)
        problems, doubts = problems + wrong, doubts + odd
    return PointsFound(points, tuple(problems), tuple(dict.fromkeys(doubts)), measured, bounds)


def _of_clock(building: LiveBuilding, rules: MeasurementMap, now: pd.Timestamp) -> list[str]:
    """What is odd of the map's clock, of which hours of comfort are, where the connection tells the home's."""
    asked = getattr(building.connection, "time_zone", None)
    zone, home = rules.time.zone or "UTC", "" if asked is None else asked()
    if home not in available_timezones():
        return []
    days = [pd.Timestamp(year=now.year, month=month, day=1, tz="UTC") for month in (1, 7)]
    if all(day.tz_convert(zone).utcoffset() == day.tz_convert(home).utcoffset() for day in days):
        return []
    return [f"time.zone of the map is {zone}, the home's is {home}: hours of comfort and of prices are by the map's"]


def _of_ages(points: Sequence[LivePoint], rules: MeasurementMap) -> list[str]:
    """What is odd of the ages of readings: that all are old, where each point has new ones more often."""
    every_s = [point.every_s for point in points if math.isfinite(point.every_s)]
    age_s = min((point.age_s for point in points if point.values.size), default=0.0)
    if not every_s or not age_s > max(ZONES_S, 3.0 * float(np.median(every_s))):
        return []
    of_zone = f"is time.zone of the map, {rules.time.zone or 'UTC'}, that of the stamps, or does the logger stand?"
    return [f"the newest reading of all is {age_s / 60.0:.0f} min old, and they come more often: {of_zone}"]


def _of_record(measured: Measurements) -> list[tuple[str, str]]:
    """Kind and words of what a record says against itself."""
    record, layout, rules = measured.record, measured.layout, measured.map
    commands = {name: found[1] for name in layout.names.actuators if (found := rules.command_of(name)) is not None}
    every = [*remarks(record, layout), *command_remarks(record, layout, measured.commands, commands)]
    return [(one.kind, one.in_words()) for one in every]


def _bounds_now(measured: Measurements) -> dict[str, tuple[float, float]]:
    conditions = measured.conditions
    last = [
        tuple(float(row[np.isfinite(row)][-1]) if np.isfinite(row).any() else math.nan for row in pair)
        for pair in zip(conditions.lower_C, conditions.upper_C, strict=True)
    ]
    return {zone: (low, high) for zone, (low, high) in zip(measured.layout.names.zones, last, strict=True)}


def _as_controlled(building: LiveBuilding, now: pd.Timestamp) -> tuple[list[str], list[str]]:
    """Why a controller would refuse what is read, and what is odd: readings and weather and prices ahead."""
    try:
        building.record(building.instant(now), now=now)
    except (PlantError, InputError) as error:
        return [str(error)], list(building.left_out)
    try:
        building.forecast(_AHEAD_S, building.step_s)
    except (PlantError, InputError) as error:
        return [], [*building.left_out, f"forecast: {error}"]
    return [], list(building.left_out)


class CommissioningBook:
    """What came of trials so far, in a file; of another map or connection it is begun anew."""

    def __init__(self, path: Path, of: Mapping[str, Any]) -> None:
        """`of`: what the trials are of, such as the map and the connection's options."""
        self._path, self._of = path, digest(dict(of))
        self.trials: dict[str, TrialOutcome] = {}
        self.under_way: dict[str, Any] = {}
        self.begun_anew = ""
        if not path.exists():
            return
        try:
            told = read_json(path, MOST_BYTES)
            self.under_way = dict(told.get("under_way") or {})
            if (told["format"], told["of"]) != (_FORMAT, self._of):
                self.begun_anew = "the map or the connection changed since: its commands are tried anew"
                return
            self.trials = {key: _outcome(one) for key, one in told["trials"].items()}
        except (InputError, ValueError, KeyError, TypeError, AttributeError) as error:
            self.begun_anew = f"{path} cannot be read ({error}): begun anew"

    def begin(self, plan: TrialPlan, now: pd.Timestamp) -> None:
        """Keep that a command is about to be tried, and what it was: should this process end in it."""
        self.under_way = {
            "key": plan.key, "actuator": plan.actuators[0], "value": plan.value, "before": plan.before,
            "near": plan.near, "at": now.isoformat(),
        }  # fmt: skip
        self.save()

    def end(self, outcome: TrialOutcome | None) -> None:
        """Keep what came of it; None: it was put back."""
        self.under_way = {}
        if outcome is not None:
            self.trials[outcome.key] = outcome
        self.save()

    def save(self) -> None:
        """Write the file; raises `StorageError`."""
        trials = {key: asdict(one) for key, one in self.trials.items()}
        content = {"format": _FORMAT, "of": self._of, "trials": trials, "under_way": self.under_way}
        write_json(self._path, content, follow=True)


def _outcome(told: Mapping[str, Any]) -> TrialOutcome:
    answers = tuple(Answered(**one) for one in told["answers"])
    numbers = {key: math.nan if told[key] is None else float(told[key]) for key in ("value", "before")}
    return TrialOutcome(**{**told, **numbers, "answers": answers, "doubts": tuple(told["doubts"])})


def stages(
    found: PointsFound, plans: Sequence[TrialPlan], book: CommissioningBook, files: CommissioningFiles
) -> list[CommissioningStage]:
    """What is done of each stage, which one is next, and its command."""
    out = [_of_points(found, files.again), _of_trials(plans, book, files.again)]
    model, of_model = _of_model(found, files)
    record = _of_known(found, files) if model.status != "done" else None
    out.append(record or CommissioningStage("record", "done", "there is a model of it"))
    out += [model, _of_shadow(files, of_model)]
    words = "sets what it plans; end it at any time: the building is given back"
    out.append(CommissioningStage("control", "open", words, files.control("--model {}", files.model)))
    # The first one that is not done is next, and what comes after waits for it.
    first = next((i for i, one in enumerate(out) if one.status == "open"), len(out))
    blocked = any(one.status == "mend" for one in out[:first])
    later = [replace(one, status="later") if one.status == "open" else one for one in out]
    return [replace(one, status="next") if i == first and not blocked else one for i, one in enumerate(later)]


def _of_points(found: PointsFound, again: str) -> CommissioningStage:
    n, wrong = len(found.points), len(found.problems)
    doubts = f", {len(found.doubts)} to be looked at" if found.doubts else ""
    if wrong:
        faults = f"{counted(wrong, 'fault')} in {counted(n, 'point')}{doubts}: mend them"
        return CommissioningStage("points", "mend", f"{faults} (map, device or logger), then", again)
    return CommissioningStage("points", "done", f"{n} points read{doubts}")


def _of_trials(plans: Sequence[TrialPlan], book: CommissioningBook, again: str) -> CommissioningStage:
    done = [plan.key for plan in plans if (one := book.trials.get(plan.key)) is not None and one.is_done]
    failed = [key for key, one in book.trials.items() if one.status == "not taken" or one.doubts]
    words = f"{len(done)} of {len(plans)} commands tried"
    if failed:
        return CommissioningStage("trials", "mend", f"{words}; look at {', '.join(failed)}, then", f"{again} --again")
    if len(done) == len(plans):
        return CommissioningStage("trials", "done", words)
    return CommissioningStage("trials", "open", words, again)


def _of_known(found: PointsFound, files: CommissioningFiles) -> CommissioningStage:
    """Whether what was measured tells the effect of acting."""
    measured = found.measured
    # Else somebody writes the table.
    record = files.recorded if files.has_history or files.records else files.again
    if measured is None:
        return CommissioningStage("record", "open", "nothing is recorded yet: let it run for days", record)
    days = measured.record.n_steps * measured.record.step_s / 86400.0
    set_by_command = any(measured.map.command_of(name) for name in measured.layout.names.actuators)
    try:
        served = measured.served()
        if days < _LEAST_DAYS:
            raise DataError(f"{days:.1f} days: a model needs three days of trials, or weeks of operation")
        part, _ = telling_part(served.record, served.layout)
        unknown = [one for one in findings(part, served.layout) if not one.competent]
        if unknown:
            lacking = "; ".join(f"of {one.actuator}: {one.plainly or one.words}" for one in unknown)
            raise DataError(f"a model of them may not act: {lacking}")
        learned_commands(served)
    except DataError as error:
        probe = files.control("--out {} --mode probe", files.control_out)
        advice = (
            "meanwhile set other values on some days, at the same hours"
            if set_by_command
            else f"or let it try levels within the bounds until it knows: {probe}"
        )
        words = f"{days:.1f} days do not show yet what heating or cooling does: {error}. Measure on; {advice}"
        return CommissioningStage("record", "open", words, record)
    return CommissioningStage("record", "done", f"{days:.1f} days show what heating or cooling does")


def _of_model(found: PointsFound, files: CommissioningFiles) -> tuple[CommissioningStage, str]:
    """The stage, and the key of the model, '' where there is none of this building."""
    if not Path(files.model).exists():
        return CommissioningStage("model", "open", f"none yet in {files.model}", files.identified), ""
    try:
        model = load_model(Path(files.model))
        if found.measured is not None:
            check_same_layout("the model", model.layout, "the map", found.measured.served().layout)
    except ThermoForceError as error:
        return CommissioningStage("model", "open", f"{files.model}: {error}", files.identified), ""
    unfit = [
        name
        for name, card in zip(model.names.actuators, model.cards, strict=True)
        if card.competence is None or not card.competence.competent
    ]
    if unfit:
        words = f"it may not act on {', '.join(unfit)}: measure longer, then"
        return CommissioningStage("model", "open", words, files.identified), model_key(model)
    words = f"{files.model} may act on {', '.join(model.names.actuators)}"
    return CommissioningStage("model", "done", words), model_key(model)


def _of_shadow(files: CommissioningFiles, of_model: str) -> CommissioningStage:
    command = files.control("--model {} --out {} --mode shadow", files.model, files.control_out)
    try:
        told = read_json(Path(files.control_out) / SHADOW, MOST_BYTES)
        days, said, of = len(told["days"]), str(told["said"]), str(told["model"])
    except (InputError, KeyError, TypeError):
        return CommissioningStage("shadow", "open", f"{_SHADOW_DAYS} days in which nothing is set", command)
    if of != of_model:
        words = f"{_SHADOW_DAYS} days in which nothing is set; those in {files.control_out} are of another model"
        return CommissioningStage("shadow", "open", words, command)
    if days < _SHADOW_DAYS:
        return CommissioningStage("shadow", "open", f"{days} of {_SHADOW_DAYS} days; {said}", command)
    return CommissioningStage("shadow", "done", f"{days} days; {said}")


@dataclass(frozen=True, eq=False)
class CommissioningReport:
    """Everything that was found, to be shown."""

    at: pd.Timestamp
    found: PointsFound
    plans: tuple[TrialPlan, ...]
    trials: Mapping[str, TrialOutcome]
    stages: tuple[CommissioningStage, ...]
    notes: tuple[str, ...] = field(default=())

    @property
    def is_well(self) -> bool:
        """Whether nothing has to be mended."""
        return not any(stage.status == "mend" for stage in self.stages)

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON values."""
        points = [
            {
                **{
                    key: getattr(p, key) for key in ("key", "column", "unit", "declared", "age_s", "every_s", "problem")
                },
                "value": p.last,
                "least": p.values.min(initial=np.inf),
                "most": p.values.max(initial=-np.inf),
                "doubts": list(p.doubts),
            }
            for p in self.found.points
        ]
        told = {
            "at": self.at.isoformat(),
            "points": points,
            "problems": list(self.found.problems),
            "doubts": list(self.found.doubts),
            "planned": [asdict(plan) for plan in self.plans],
            "trials": {key: asdict(one) for key, one in self.trials.items()},
            "stages": [asdict(stage) for stage in self.stages],
            "notes": list(self.notes),
        }
        return dict(plain_json(told))

    def to_markdown(self) -> str:
        """A short report."""
        lines = [f"# Commissioning, {self.at:%Y-%m-%d %H:%M %Z}", ""]
        lines += ["| point | column | value | age | range of a day | |", "|---|---|---|---|---|---|"]
        lines += [f"| {' | '.join(row)} |" for row in rows_of(self.found.points)]
        for title, texts in (("To be mended", self.found.problems), ("To be looked at", self.found.doubts)):
            lines += ["", f"## {title}", "", *(f"- {text}" for text in texts)] if texts else []
        lines += ["", "## Trials", ""]
        for plan in self.plans:
            one = self.trials.get(plan.key)
            lines.append(f"- {plan.in_words}" if one is None else f"- {one.key}: {one.words}; {one.back or 'not set'}")
            lines += [f"  - {doubt}" for doubt in (one.doubts if one else ())]
        lines += ["", "## Stages", ""]
        for stage in self.stages:
            lines.append(f"- **{stage.name}**: {stage.status}. {stage.words}")
            lines += [f"  `{stage.command}`"] if stage.command else []
        return "\n".join([*lines, *(["", *self.notes] if self.notes else []), ""])


def rows_of(points: Sequence[LivePoint]) -> list[tuple[str, str, str, str, str, str]]:
    """Rows of a table of points: key, column, value with unit, age, range of a day, whether it is well."""
    out = []
    for p in points:
        span = f"{figure(np.min(p.values))} to {figure(np.max(p.values))}" if p.values.size else ""
        value = f"{figure(p.last)} {p.unit}".strip() if math.isfinite(p.last) else "none"
        age = duration(p.age_s) if math.isfinite(p.age_s) else ""
        out.append((p.key, p.column, value, age, span, "wrong" if p.problem else "look" if p.doubts else "ok"))
    return out
