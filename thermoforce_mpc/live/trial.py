"""One short trial of each command of a building: set, read back, watched, and put back however it ends.

A trial stays inside the limits of the map and near what is set now. While it lasts the building is this process's alone
(`sole_control`), and a watchdog outside puts the command back where this process does not.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from thermoforce_mpc.commands.command import is_warm
from thermoforce_mpc.connections.sole import Sets, sole_control
from thermoforce_mpc.connections.watchdog import Watchdog
from thermoforce_mpc.errors import raise_if_terminated
from thermoforce_mpc.execution.progress import duration
from thermoforce_mpc.live.building import LiveBuilding
from thermoforce_mpc.live.control import Clock, until_taken
from thermoforce_mpc.measurements.points import LivePoint

_LOG = logging.getLogger(__name__)
# Shortest trial, s, and that of a level, for which most machines have a least time on or off.
LEAST_S, _LEVEL_S = 300.0, 900.0
# Beyond the trial's end a command holds for so long, s: what puts it back takes its time.
BEYOND_S = 120.0
# The points are read again so often in a trial, and at least so far apart, s.
_LOOKS, LOOK_S = 12, 5.0
# What counts as an answer: of level and flow and room at once, of power as a share of the larger and W.
_ANSWERS = {"level": 0.1, "flow": 1.0, "temperature": 0.2, "return_water": 1.0}
_OF_POWER, _LEAST_W = 0.2, 30.0


@dataclass(frozen=True)
class TrialPlan:
    """What is to be tried: the command `key`, as the connection calls it, from `before` to `value` for `seconds`.

    `actuators`: those that it feeds; `zones`: their rooms; `raises`: whether more heat is expected; `words`: the
    command's name. `refused`: why it is not tried, '' where it may be.
    """

    key: str
    actuators: tuple[str, ...]
    zones: tuple[str, ...]
    words: str
    before: float
    value: float
    seconds: float
    raises: bool
    near: float | None
    before_words: str
    value_words: str
    refused: str = ""

    @property
    def in_words(self) -> str:
        """What is done, in one line."""
        if self.refused:
            return f"{self.key}: {self.words}: not tried: {self.refused}"
        minutes = duration(self.seconds)
        return f"{self.key}: {self.words} from {self.before_words} to {self.value_words} for {minutes}, then back"


@dataclass(frozen=True)
class Answered:
    """A point `key` before a trial and at its end, in `unit`: whether it `answered`, and as expected (`fits`)."""

    key: str
    before: float
    after: float
    unit: str
    answered: bool
    fits: bool


@dataclass(frozen=True)
class TrialOutcome:
    """What came of a trial.

    `status`: 'answered' (something moved as expected), 'taken' (read back, and nothing moved), 'not read back' (nothing
    says what the device holds), 'not taken', 'ended early' or 'refused'; `words`: the sentence; `back`: how it was put
    back; `doubts`: what it says against the map.
    """

    key: str
    status: str
    words: str
    at: str = ""
    value: float = math.nan
    before: float = math.nan
    back: str = ""
    answers: tuple[Answered, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def is_done(self) -> bool:
        """Whether the command is known to work, so that it need not be tried again."""
        return self.status in ("answered", "taken", "not read back")


def planned_trials(
    building: LiveBuilding,
    points: Sequence[LivePoint],
    bounds_C: Mapping[str, tuple[float, float]],
    held: Mapping[str, float],
    hold_s: float | None = None,
) -> list[TrialPlan]:
    """A trial of each command of the building.

    Args:
        building: of whose map the commands are.
        points: as they were read now.
        bounds_C: lower and upper comfort bound of rooms now, °C.
        held: what devices say that they hold, by key; else the last reading of the command's column counts.
        hold_s: length of each, s, at least that of the command's `hold_min`; None: that.
    """
    by_key: dict[str, list[str]] = {}
    for name in building.names:
        by_key.setdefault(building.key(name), []).append(name)
    return [_planned(building, key, names, points, bounds_C, held, hold_s) for key, names in by_key.items()]


def _planned(
    building: LiveBuilding,
    key: str,
    names: Sequence[str],
    points: Sequence[LivePoint],
    bounds_C: Mapping[str, tuple[float, float]],
    held: Mapping[str, float],
    hold_s: float | None,
) -> TrialPlan:
    command = building.command_of(names[0])
    by_point = {point.key: point for point in points}
    level = next((by_point[of] for name in names if (of := f"actuators.{name}.level") in by_point), None)
    column = None if command is None else next((p for p in points if p.key.endswith(f"{key}.command")), None)
    told = column if command is not None else level
    before = held.get(key, math.nan if told is None or told.problem else told.last)
    zones = tuple(dict.fromkeys(building.zone_of(name) for name in names))
    rooms = [(by_point[f"zones.{zone}.temperature"], bounds_C.get(zone, (math.nan, math.nan))) for zone in zones]
    words = "the level" if command is None else command.name_in_words
    plan = TrialPlan(
        key, tuple(names), zones, words, before, math.nan, 0.0, True, building.nearness(names[0]), "?", "?"
    )
    if wrong := [f"{point.key}: {point.problem}" for point, _ in rooms if point.problem]:
        return replace(plan, refused=wrong[0])
    if not math.isfinite(before) and command is not None:
        return replace(plan, refused=f"what it is now is not known ({told.problem if told else 'no column'})")
    # A thermostat of the house is moved by the room where it is.
    by = set(zones) if command is None else {command.reference_of(zone) for zone in zones}
    acts = [one for zone, one in zip(zones, rooms, strict=True) if zone in by]
    in_rooms = [point.last for point, _ in acts], [bounds for _, bounds in acts]
    if command is None:
        before = before if math.isfinite(before) else 0.0
        value = 0.0 if before >= 0.5 else 1.0
        if value > before and is_warm(*in_rooms):
            return replace(plan, refused="a room is above its upper bound and the machine is off: try it when it runs")
        least_s, most_s = _LEVEL_S, math.inf
    else:
        found = command.tried(before, *in_rooms)
        if found is None:
            return replace(plan, refused=f"no other value near {command.in_words(before)} is allowed by the map")
        value, least_s, most_s = found, max(60.0 * command.hold_min, LEAST_S), command.longest_s(found)
    seconds = min(max(least_s, hold_s or 0.0), most_s)

    def say(value: float) -> str:
        text = f"{100 * value:.0f} %" if command is None else command.in_words(value)
        return text.removeprefix(words).strip()

    return replace(
        plan, before=before, value=value, seconds=seconds, raises=value > before, before_words=say(before),
        value_words=say(value),
    )  # fmt: skip


def tried(
    building: LiveBuilding,
    plan: TrialPlan,
    *,
    read: Callable[[pd.Timestamp], Sequence[LivePoint]],
    clock: Clock,
    sets: Sets,
    connection: tuple[str, Mapping[str, Any]] | None = None,
    log: Path | None = None,
    grace_s: float = 60.0,
    say: Callable[[str], None] = lambda text: None,
) -> TrialOutcome:
    """Try a command, and put it back.

    Args:
        building: that is set.
        plan: of `planned_trials`.
        read: the points at a time.
        clock: the time.
        sets: what is set, which no other controller may set meanwhile.
        connection: name and options for the watchdog, and `log`, its file; None: none is started.
        grace_s: how long after its end the watchdog puts it back, s.
        say: hears what happens.

    Raises:
        ConfigError: another controller sets the building.
        PlantError: the command could not be put back.
    """
    if plan.refused:
        return TrialOutcome(plan.key, "refused", f"{plan.words}: {plan.refused}")
    back = {plan.key: plan.before} if building.puts_back else {}
    with sole_control(sets):
        watchdog = None
        if connection is not None:
            watchdog = Watchdog(connection[0], connection[1], sets, grace_s, log, back)
        trial = _Trial(building, plan, clock, read, watchdog, say)
        if watchdog is None:
            return trial.run()
        with closing(watchdog):
            return trial.run()


class _Trial:
    """A trial under way."""

    def __init__(
        self,
        building: LiveBuilding,
        plan: TrialPlan,
        clock: Clock,
        read: Callable[[pd.Timestamp], Sequence[LivePoint]],
        watchdog: Watchdog | None,
        say: Callable[[str], None],
    ) -> None:
        self._building, self._plan, self._clock, self._read = building, plan, clock, read
        self._watchdog, self._say = watchdog, say
        self._seen_s = self._took = math.nan

    def run(self) -> TrialOutcome:
        """Set, watch and put back; an interrupt is raised after that."""
        plan, begin = self._plan, self._clock.now()
        outcome = TrialOutcome(
            plan.key, "ended early", f"{plan.words}: interrupted", begin.isoformat(), plan.value, plan.before
        )
        before = self._read(begin)
        try:
            told = self._set()
            if told:
                outcome = replace(outcome, status="not taken", words=f"{plan.words}: {plan.value_words}: {told}")
            else:
                after = self._watched(begin)
                outcome = self._judged(outcome, before, after)
        finally:
            back = self._put_back()
            self._say(f"{plan.key}: {back}")
        return replace(outcome, back=back)

    def _set(self) -> str:
        """Set the command; why it was not taken, '' where it was."""
        plan, seconds = self._plan, self._plan.seconds + BEYOND_S
        ours, told = {plan.key: [(plan.value, plan.near)]}, ""
        if self._watchdog is not None:
            self._watchdog.about_to_set([plan.key], seconds, ours)
        try:
            self._building.write({plan.actuators[0]: plan.value}, seconds, {plan.key: plan.value})
        except Exception as error:  # somebody's connection may raise anything
            told = str(error)
        # What the device made of it, where it rounds or has limits of its own, nobody set by hand.
        self._took = self._held()
        if self._watchdog is not None:
            took = {plan.key: [*ours[plan.key], *([(self._took, plan.near)] if math.isfinite(self._took) else [])]}
            (self._watchdog.about_to_set if told else self._watchdog.set)([plan.key], seconds, took)
        return told

    def _watched(self, begin: pd.Timestamp) -> Sequence[LivePoint]:
        """The points at the end of the trial; notes when the column of the command showed what was set."""
        plan, until = self._plan, begin + pd.Timedelta(seconds=self._plan.seconds)
        look = pd.Timedelta(seconds=max(plan.seconds / _LOOKS, LOOK_S))
        points: Sequence[LivePoint] = ()
        while (now := self._clock.now()) < until:
            self._clock.wait_until(min(now + look, until))
            raise_if_terminated()
            try:
                points = self._read(self._clock.now())
            except Exception as error:  # a table being written, a broker away for a moment
                _LOG.info("not read meanwhile: %s", error)
                continue
            column = self._column(points)
            if not math.isfinite(self._seen_s) and column is not None and self._is_ours(column.last):
                self._seen_s = (self._clock.now() - begin).total_seconds()
        return points

    def _column(self, points: Sequence[LivePoint]) -> LivePoint | None:
        plan = self._plan
        keys = {f"actuators.{plan.key}.command", f"machines.{plan.key}.command"}
        keys |= {f"actuators.{name}.level" for name in plan.actuators if plan.near is None}
        return next((point for point in points if point.key in keys and not point.problem), None)

    def _is_ours(self, value: float) -> bool:
        plan = self._plan
        return math.isfinite(value) and abs(value - plan.value) <= (0.05 if plan.near is None else plan.near)

    def _judged(self, outcome: TrialOutcome, before: Sequence[LivePoint], after: Sequence[LivePoint]) -> TrialOutcome:
        plan = self._plan
        answers, others = self._answers(before, after)
        held = self._held()
        if math.isfinite(held):
            taken = f"the device says {self._words(held)}"
        elif math.isfinite(self._seen_s):
            taken = f"its column shows it within {self._seen_s:.0f} s"
        else:
            taken = "nothing says what the device holds"
        moved = [one for one in answers if one.answered]
        fits = [one for one in moved if one.fits]
        told = "; ".join(f"{one.key} {one.before:.4g} to {one.after:.4g} {one.unit}".strip() for one in answers)
        doubts = []
        if math.isfinite(held) and not self._is_ours(held):
            made = math.isfinite(self._took) and abs(held - self._took) <= (plan.near or 0.05)
            by = "somebody set it, or it did not take the command"
            by = "it made that of the command: see its resolution, minimum and maximum in the map" if made else by
            doubts.append(f"the device holds {self._words(held)}: {by}")
        if moved and not fits:
            doubts.append("what moved went the other way: is the command of something else, or the wrong way round?")
        acts = [one for one in answers if one.key.endswith((".level", ".flow", ".heat"))]
        if others and not any(one.fits for one in acts or answers):
            doubts.append(f"{', '.join(others)} answered in its place: are rooms swapped?")
        doubts += [
            f"{one.key} changed by {abs(one.after - one.before):.3g} W: kW is likelier: unit: kW"
            for one in answers
            if one.unit == "W" and one.key.endswith("power") and 0.1 < max(one.before, one.after) < 15.0
            and abs(one.after - one.before) > _OF_POWER * max(one.before, one.after)
        ]  # fmt: skip
        known = math.isfinite(held) or math.isfinite(self._seen_s)
        status = "answered" if fits else "taken" if known else "not read back"
        what = {"answered": "it answered", "taken": "nothing answered in that time"}.get(status, "nothing answered")
        words = f"{plan.words} {plan.value_words} for {duration(plan.seconds)}: {taken}; {what} ({told})"
        return replace(outcome, status=status, words=words, answers=tuple(answers), doubts=tuple(doubts))

    def _words(self, value: float) -> str:
        command = self._building.command_of(self._plan.actuators[0])
        return f"{100 * value:.0f} %" if command is None else command.in_words(value)

    def _held(self) -> float:
        return self._building.held([self._plan.key]).get(self._plan.key, math.nan)

    def _answers(
        self, before: Sequence[LivePoint], after: Sequence[LivePoint]
    ) -> tuple[list[Answered], list[str]]:  # fmt: skip
        """What the points of the command did, and which levels of others moved as expected."""
        plan, answers, others = self._plan, list[Answered](), list[str]()
        then = {point.key: point for point in before}
        machines = self._building.machines_of(plan.actuators)
        keys = {f"actuators.{name}.{what}" for name in plan.actuators for what in ("level", "flow", "heat")}
        keys |= {f"machines.{name}.{what}" for name in machines for what in ("power", "return_water")}
        keys |= {f"zones.{zone}.temperature" for zone in plan.zones}
        span_s = min(plan.seconds, 900.0)
        for point in after:
            if point.problem or then[point.key].problem:
                continue
            sampled = point.key.endswith("temperature")
            was = then[point.key].last if sampled else then[point.key].mean(-span_s, 0.0)
            now = point.last if sampled else point.mean(-0.5 * plan.seconds, 0.0)
            if not (math.isfinite(was) and math.isfinite(now)):
                continue
            least = _ANSWERS.get(point.key.rpartition(".")[2], max(_OF_POWER * max(abs(was), abs(now)), _LEAST_W))
            moved = abs(now - was) > least
            fits = moved and (now > was) == plan.raises
            if point.key in keys:
                answers.append(Answered(point.key, round(was, 4), round(now, 4), point.unit, moved, fits))
            elif fits and point.key.endswith(".level"):
                others.append(point.key)
        return answers, others

    def _put_back(self) -> str:
        """Put the command back, and say how; an interrupt meanwhile costs one attempt, and is raised after."""
        plan, building = self._plan, self._building
        words = ""

        def attempt() -> bool:
            nonlocal words
            try:
                ours = (plan.value, self._took)
                words = put_back(building, plan.key, plan.actuators[0], ours, plan.before, plan.near)
            except Exception as error:  # somebody's connection may raise anything
                _LOG.warning("%s was not put back (%s: %s)", plan.key, type(error).__name__, error)
                return False
            return True

        interrupt = until_taken(
            attempt, self._clock, f"{plan.key} was not put back", f"set it back to {plan.before_words} by hand"
        )
        if self._watchdog is not None:
            self._watchdog.released()
        if interrupt is not None:
            raise interrupt
        return words


def put_back(
    building: LiveBuilding, key: str, name: str, ours: Sequence[float], before: float, near: float | None
) -> str:
    """Put the command `key` of actuator `name`, which holds one of `ours` by a trial, back to what was `before`; says
    how.

    What the device holds that is neither of these nor that, somebody set by hand meanwhile, and stays. Raises what the
    connection raises.
    """
    command = building.command_of(name)
    held = building.held([key]).get(key, math.nan)
    tolerance = 0.05 if near is None else near
    known = [one for one in (*ours, before) if math.isfinite(one)]
    if command is not None and math.isfinite(held) and all(abs(held - one) > tolerance for one in known):
        building.leave()
        return f"{command.in_words(held)} was set by hand meanwhile: left alone"
    if building.puts_back and math.isfinite(before):
        building.put_back({key: before})
        return f"put back to {f'{100 * before:.0f} %' if command is None else command.in_words(before)}"
    building.write({name: None}, 0.0, {key: None})
    return "given back to its own control"
