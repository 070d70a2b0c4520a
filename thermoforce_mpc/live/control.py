"""The loop of a controller at a real building: read, plan, check, set the levels, wait; give it back at the end.

Each step reads the record anew. What else is known is kept in a file, so that a controller that was killed goes on when
it is started again.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Protocol

import pandas as pd

from thermoforce_mpc.commands.tank import TANK_NAME
from thermoforce_mpc.connections.sole import Sets, set_by, sole_control
from thermoforce_mpc.connections.watchdog import Watchdog
from thermoforce_mpc.data import Block, Boundary, CommandValue, Plan, PlanStatus
from thermoforce_mpc.data.layout import check_same_layout
from thermoforce_mpc.errors import (
    ControllerRaised,
    NoForecast,
    PlantError,
    ThermoForceError,
    interruption,
    raise_if_terminated,
)
from thermoforce_mpc.live.building import Applied, Kept, KeptState, LiveBuilding, SetCommand
from thermoforce_mpc.loop.inputs import OUTAGE_H, UnitDoubts
from thermoforce_mpc.loop.loop import Believed, Decided, Loop, not_followed
from thermoforce_mpc.model.screening import limits_of, screened_history
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.records.live_journal import Given, LiveJournal
from thermoforce_mpc.records.run_folder import log_decision

_LOG = logging.getLogger(__name__)
# How often a building that does not take its levels back at the end is asked again, and how long between, s.
_RELEASES, _PAUSE_S = 5, 2.0
# Blocks remembered, for steps whose level was not measured.
_REMEMBERED = 2000
# How long a level holds beyond the end of its step, s: the next decision begins there, and takes its time.
_NEXT_DECISION_S = 120.0


class Clock(Protocol):
    """The time, in any zone."""

    def now(self) -> pd.Timestamp:
        """The time now."""

    def wait_until(self, at: pd.Timestamp) -> None:
        """Return at `at`, at once where that is past; after as long as it is until then, if the clock is set back."""


class WallClock:
    """The time of this machine."""

    def now(self) -> pd.Timestamp:
        """See `Clock.now`."""
        return pd.Timestamp.now("UTC")

    def wait_until(self, at: pd.Timestamp) -> None:
        """See `Clock.wait_until`; in short pieces, since a sleeping machine's clock jumps.

        No longer than it was at first, also where the clock is set back meanwhile.
        """
        most_s = time.monotonic() + (at - self.now()).total_seconds()
        while (left_s := min((at - self.now()).total_seconds(), most_s - time.monotonic())) > 0:
            time.sleep(min(left_s, 5.0))


@dataclass(frozen=True)
class Decision:
    """What was decided for the step from `instant` on: checked `blocks`, `plan`, why it was `refused`, `notes`."""

    instant: pd.Timestamp
    plan: Plan
    blocks: tuple[Block, ...]
    refused: str = ""
    notes: tuple[str, ...] = ()


def control(
    building: LiveBuilding,
    controller: Controller,
    *,
    clock: Clock | None = None,
    steps: int | None = None,
    delay_s: float = 30.0,
    dry: bool = False,
    outage_h: float = OUTAGE_H,
    kept: KeptState | None = None,
    journal: LiveJournal | None = None,
    told: Callable[[Decision], None] = lambda decision: None,
    sets: Sets | None = None,
    acts: bool = True,
    watchdog: Watchdog | None = None,
) -> object:
    """Control a building, of the step of `controller`, until interrupted, or for `steps` decisions.

    Whatever fails after the first decision, readings, forecast or plan, gives the building back to its own control for
    a step; the reason is in the log. What fails in the first one raises: nothing was set then. Returns the controller's
    last state.

    Args:
        clock: the time; by default this machine's.
        delay_s: how long after the beginning of a step it is decided, s, so that its last reading is there.
        dry: decide once and set nothing.
        outage_h: how long the last forecast may stand in where there is none, h.
        kept: where the controller's state is kept from step to step; None: a restart begins anew.
        journal: where steps are recorded for explain, watch and report.
        told: called with every decision, before it acts.
        acts: set what is decided; otherwise it is recorded beside what the building does by itself.
        watchdog: gives the building back where this process does not.
        sets: what is set, which no other controller may set meanwhile; by default what the connection says, if it does.

    Raises:
        InputError, PlantError: the first decision could not be made.
        ConfigError: another controller sets the building.
        PlantError: the building did not take its levels back at the end.
    """
    sets = set_by(building.connection) if sets is None else sets
    driver = _Building(
        building=building,
        controller=controller,
        clock=clock or WallClock(),
        left=steps,
        delay=pd.Timedelta(seconds=delay_s),
        dry=dry,
        kept=kept,
        journal=journal,
        told=told,
        acts=acts,
        watchdog=watchdog,
    )
    with sole_control(sets) if sets and acts and not dry else nullcontext():
        return Loop(driver, controller, outage_h).run()


def until_taken(attempt: Callable[[], bool], clock: Clock, failed: str, remedy: str) -> BaseException | None:
    """Give something back: `attempt` is made until it says that the building took it.

    An interrupt meanwhile costs one attempt and is returned, to be raised when all is in order. Raises `PlantError`, of
    what `failed` and its `remedy`, where no attempt was taken.
    """
    interrupt: BaseException | None = None
    for _ in range(_RELEASES):
        try:
            if attempt():
                return interrupt
            clock.wait_until(clock.now() + pd.Timedelta(seconds=_PAUSE_S))
        except BaseException as again:  # Ctrl-C once more, or another signal to end
            interrupt = again
    raise PlantError(f"{failed} in {_RELEASES} attempts: {remedy}") from interrupt


@dataclass(eq=False, kw_only=True)
class _Building:
    """A real building as the driver of a loop: it goes on by itself, and may fail at any time.

    `left`: decisions still to be made, None: no end; the others as in `control`.
    """

    building: LiveBuilding
    controller: Controller
    clock: Clock
    left: int | None
    delay: pd.Timedelta
    dry: bool
    kept: KeptState | None
    journal: LiveJournal | None
    told: Callable[[Decision], None]
    acts: bool
    watchdog: Watchdog | None

    def __post_init__(self) -> None:
        self._step = pd.Timedelta(seconds=self.controller.step_s)
        self._given = Given(None, None)
        # A tank of which nothing was learned stays the device's.
        learned = getattr(self.controller, "hot_water", None) is not None
        self._sets_tank = learned and self.building.command_of(TANK_NAME) is not None
        self._allowed = limits_of(self.controller)
        self._instant: pd.Timestamp | None = None
        self._applied: list[Applied] = []
        self._commands: dict[str, SetCommand] = {}
        self._set = False
        self._decided: tuple[pd.Timestamp, object, object] | None = None
        self._raised = False
        self.begun_anew = False

    def begin(self) -> object:
        """See `LoopDriver.begin`: the state that was kept, if it is of this controller and young enough."""
        self._next = self.building.instant(self.clock.now())
        if self.journal is not None and (origin := self.journal.origin()) is not None:
            self.building.count_from(pd.Timestamp(origin))
        if self.kept is None or (kept := self.kept.load(self._next)) is None:
            return None
        self.building.count_from(pd.Timestamp(kept.origin))
        self._applied = list(kept.applied)
        # What ended meanwhile, or was given back, is not held any more.
        now = self.clock.now()
        self._commands = {one.name: one for one in kept.commands if now <= pd.Timestamp(one.until)}
        if self.acts:
            self.building.remember(kept.told)
        return kept.state_at(self._next)

    def next_step(self) -> bool:
        """See `LoopDriver.next_step`."""
        self.begun_anew = False
        if self._instant is not None:
            # Steps that passed while this one was planned, or while the machine slept, are left out.
            now = self.building.instant(self.clock.now() - self.delay)
            self.begun_anew = now < self._instant
            if self.begun_anew:  # what is known is of times that are to come again
                _LOG.warning(
                    "the clock was set back, from the step of %s to that of %s: begun anew", self._instant, now
                )
                self._applied, self._commands, self._next = [], {}, now
            else:
                self._next = max(self._instant + self._step, now)
        if self.left == 0:
            return False
        self.left = None if self.left is None else self.left - 1
        self._instant, self._given = self._next, Given(None, None)
        self.clock.wait_until(self._instant + self.delay)
        return True

    def unfit(self, blocks: Sequence[Block]) -> str:
        """See `LoopDriver.unfit`: of each actuator its level is set, or the command of its map within its limits."""
        for block in blocks:
            for name, u, told in zip(self.building.names, block.u, block.command, strict=True):
                command = self.building.command_of(name)
                if isinstance(told, tuple):
                    return "room set-points, which a connection has none of"
                if u is None:
                    continue
                if command is None:
                    if told is not None:
                        return f"a command of {told:g} for '{name}', whose level is set"
                elif told is None:
                    return f"a level of {u:g} for '{name}', of which {command.name_in_words} is set"
                elif not command.allows(told):
                    return f"{command.in_words(told)} for '{name}', which its command in the map does not allow"
        return ""

    def read(self) -> Believed:
        """See `LoopDriver.read`."""
        building, controller = self.building, self.controller
        as_read = building.record(self._at, self._applied, self.clock.now())
        self._given = Given(as_read, None)
        record, doubts = screened_history(as_read, self._allowed)
        model = getattr(controller, "model", None)
        if model is not None:
            check_same_layout("the model", model.layout, "the map", building.layout)
        tank = building.tank_now()
        return Believed(record, as_read, doubts, controller.step_s, building.layout.u_min, tank)

    def units(self) -> UnitDoubts | None:
        """See `LoopDriver.units`."""
        return UnitDoubts(self.building.layout, getattr(self.controller, "model", None))

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`."""
        try:
            forecast = self.building.forecast(horizon_s, interval_s)
        except NoForecast as error:
            known = error.known if isinstance(error.known, Boundary) else None
            self._given = replace(self._given, forecast=known, no_forecast=str(error))
            raise
        self._given = replace(self._given, forecast=forecast)
        return forecast

    def instead(self, index: int, error: Exception, state: object) -> Decided | None:
        """See `LoopDriver.instead`: the building's own control, but for what is wrong from the start."""
        raised = error.__cause__ if isinstance(error, ControllerRaised) and error.__cause__ else error
        if index == 0:
            if state is None or isinstance(error, PlantError):
                raise error
            _LOG.warning("no decision with the state that was kept (%s): begun anew", raised)
            self._applied, self._commands = [], {}
            return None
        # Nobody is there to start it again: the next step may be better.
        expected = isinstance(raised, ThermoForceError)
        if self._raised and isinstance(error, ControllerRaised) and state is not None:
            # In two steps on end: what it goes on from may be at fault, for ever.
            _LOG.warning("no decision at %s (%s): the controller begins anew", self._at, raised, exc_info=raised)
            self._raised = False
            return None
        self._raised = isinstance(error, ControllerRaised)
        _LOG.warning("no decision at %s: %s", self._at, raised, exc_info=None if expected else raised)
        why = f"the building's own control: {raised if expected else f'{type(raised).__name__}: {raised}'}"
        native = Block.native(len(self.building.names), self.controller.step_s)
        plan = Plan((native,), PlanStatus.NATIVE, why, names=self.building.all_names)
        return Decided(index, None, None, plan, (native,), before=state, after=state)

    def act(self, decided: Decided) -> object:
        """See `LoopDriver.act`."""
        self._raised = self._raised and decided.observation is None
        decided = self._with_holds(decided)
        levels, time_s = [block.u for block in decided.blocks], self.building.time_s(self._at)
        name, plan, refused = self.controller.name, decided.plan, decided.refused
        # Of the forecast's table too, which was read after the measurements.
        notes = decided.notes if decided.observation is None else (*self.building.left_out, *decided.notes)
        log_decision(name, decided.index, time_s, plan, levels, refused, notes)
        self.told(Decision(self._at, plan, decided.blocks, refused, notes))
        if self.journal is not None:
            asked = (self.controller.horizon_s, self.controller.step_s)
            decision = replace(decided, notes=notes)
            origin, layout = self.building.origin.isoformat(), self.building.layout
            acts = self.acts and not self.building.paused
            self.journal.decided(decision, time_s, self._given, asked, origin, layout, acts=acts)
        if self.dry:
            self.left = 0
            return decided.after
        return self._apply(decided)

    def end(self) -> None:
        """See `LoopDriver.end`."""
        try:
            self._release()
        finally:
            if self.journal is not None:
                self.journal.ended("control was ended")

    @property
    def _at(self) -> pd.Timestamp:
        """Begin of the step."""
        assert self._instant is not None
        return self._instant

    def _apply(self, decided: Decided) -> object:
        """Set the levels or commands of each block at its time, until the step ends; what is past by then is left out.

        What is known is kept first, and again after every block. Returns the state to go on from.
        """
        begin, state = self._at + self.delay, decided.after
        end = begin + self._step
        beyond_s = min(_NEXT_DECISION_S, self._step.total_seconds())
        self._keep(self._at, decided.before, state)
        # What is not set did not act: as if nothing had been planned.
        acts = self.acts and not self.building.paused
        blocks, tank = decided.blocks if acts else (), self._tank_command(decided)
        if self._set and not acts:  # until now it was
            self._set = not self._write((None,) * len(self.building.names), 0.0)
        if not acts:
            self._commands = {}
            self._record(Block.native(len(self.building.names), self._step.total_seconds()), begin)
            state = not_followed(decided.before, decided.after)
            self._keep(self._at, decided.before, state)
        left = list(blocks)
        while left:
            block = left.pop(0)
            until = min(begin + pd.Timedelta(seconds=block.duration_s), end)
            # A machine that slept may wake after the block's end.
            self._wait_until(begin)
            if until > (now := self.clock.now()):
                hold_s = min((end - now).total_seconds(), self._step.total_seconds()) + beyond_s
                left_s = min((until - now).total_seconds(), block.duration_s)  # the clock may be set back
                block, later = self._as_may_be(block, now, left_s)
                if later is not None:
                    left.insert(0, later)
                    until -= pd.Timedelta(seconds=later.duration_s)
                taken = self._write(block.told, hold_s, tank)
                self._note_commands(block.told if taken else (None,) * len(block.told), now, hold_s)
                start_s = self.building.time_s(begin)
                # A plan whose levels were not taken did not act.
                state = state if taken else not_followed(decided.before, decided.after)
                # What a command brings is measured, not known.
                levels = tuple(None if told is not None else u for u, told in zip(block.u, block.command, strict=True))
                set_block = block if taken else Block.native(len(block.u), block.duration_s)
                self._record(set_block, begin)
                done = Applied(start_s, block.duration_s, levels if taken else (None,) * len(block.u))
                self._applied = [*self._applied, done][-_REMEMBERED:]
                self._keep(self._at, decided.before, state)
            else:
                self._record(Block.native(len(block.u), block.duration_s), begin)
            begin = until
        self._wait_until(end)
        return state

    def _wait_until(self, at: pd.Timestamp) -> None:
        """No longer than a step, where the clock was set back; not at all where a signal to end was dropped."""
        raise_if_terminated()
        self.clock.wait_until(min(at, self.clock.now() + self._step))

    def _with_holds(self, decided: Decided) -> Decided:
        """What will be set where a command may not change yet, as `_as_may_be` says, and a note on each of these."""
        if not self.acts or self.building.paused:
            return decided
        left, begin = list(decided.blocks), self._at + self.delay
        blocks, notes = list[Block](), dict[str, None]()
        while left:
            planned = left.pop(0)
            end = begin + pd.Timedelta(seconds=planned.duration_s)
            begins, begin = max(begin, self.clock.now()), end
            if begins >= end:  # past, and not set any more
                blocks.append(planned)
                continue
            block, later = self._as_may_be(planned, begins, (end - begins).total_seconds())
            if later is not None:
                left.insert(0, later)
                begin -= pd.Timedelta(seconds=later.duration_s)
            blocks.append(block)
            for name, wanted, value in zip(self.building.names, planned.told, block.told, strict=True):
                if value != wanted and (command := self.building.command_of(name)) is not None:
                    before = self._commands[name]
                    since = pd.Timestamp(before.since).tz_convert(self._at.tz)
                    held = f"{self.building.key(name)}: {command.in_words(before.value)} was set at {since:%H:%M}"
                    stays = f"and stays for {command.hold_min:g} min (hold_min)"
                    notes[f"{held} {stays if value is not None else 'and may stay no longer'}"] = None
        return replace(decided, blocks=tuple(blocks), notes=(*decided.notes, *notes)) if notes else decided

    def _tank_command(self, decided: Decided) -> float | None:
        """What is set at the tank in the step; None: it is given back to the device."""
        plan, command = decided.plan.hot_water, self.building.command_of(TANK_NAME)
        value = None if plan is None or decided.refused or not self._sets_tank else plan.command[0]
        if value is None or command is None:
            return None
        if not command.allows(value):
            _LOG.warning("%s, which the map does not allow: the tank is the device's own", command.in_words(value))
            return None
        return value

    def _as_may_be(self, block: Block, now: pd.Timestamp, seconds: float) -> tuple[Block, Block | None]:
        """What is to be set for `seconds` s from now on, and what is left of the block for later, if anything.

        Commands that a controller that was started again within a step would change before they were held stay for the
        rest of that time; those that would be held for too long are given back: plans count from the begins of steps.
        """
        out, lasts_s = list(block.told), seconds
        for a, (name, value) in enumerate(zip(self.building.names, block.told, strict=True)):
            command, before = self.building.command_of(name), self._commands.get(name)
            if command is None or before is None or not isinstance(value, float):
                continue
            held_s = (now - pd.Timestamp(before.since)).total_seconds()
            longest_s, least_s = command.longest_s(before.value), 60.0 * command.hold_min
            if value == before.value and held_s + seconds > longest_s + _NEXT_DECISION_S:
                out[a] = None
            elif value != before.value and held_s < (stays_s := min(least_s, longest_s)) - _NEXT_DECISION_S:
                out[a], lasts_s = before.value, min(lasts_s, stays_s - held_s)
        if out == list(block.told):
            return block, None
        levels = tuple(None if now_told is None else u for u, now_told in zip(block.u, out, strict=True))
        by_command = [None if one is None else now_told for one, now_told in zip(block.command, out, strict=True)]
        if (later_s := seconds - lasts_s) <= _NEXT_DECISION_S:
            return Block(levels, block.duration_s, by_command), None
        # What is given back stays so for the whole block.
        later = Block([None if one is None else u for one, u in zip(out, block.u, strict=True)], later_s, block.command)
        return Block(levels, block.duration_s - later_s, by_command), later

    def _note_commands(self, told: Sequence[CommandValue | None], now: pd.Timestamp, hold_s: float) -> None:
        """Note what is set since when, for `hold_s` s; what is left to itself is not."""
        until = (now + pd.Timedelta(seconds=hold_s)).isoformat()
        for name, value in zip(self.building.names, told, strict=True):
            if not isinstance(value, float) or self.building.command_of(name) is None:
                self._commands.pop(name, None)
            else:
                before = self._commands.get(name)
                since = before.since if before is not None and before.value == value else now.isoformat()
                self._commands[name] = SetCommand(name, value, since, until)

    def _record(self, block: Block, begin: pd.Timestamp) -> None:
        """Note a block in the journal, whose steps begin when they do, not when they are decided."""
        if self.journal is not None:
            self.journal.applied(block, self.building.time_s(begin - self.delay))

    def _keep(self, instant: pd.Timestamp, before: object, after: object) -> None:
        self._decided = instant, before, after
        if self.kept is not None:
            origin = self.building.origin.isoformat()
            self.kept.save(
                Kept(
                    origin,
                    instant.isoformat(),
                    before,
                    after,
                    tuple(self._applied),
                    commands=tuple(self._commands.values()),
                    told=self.building.told,
                )
            )

    def _write(self, told: Sequence[CommandValue | None], seconds: float, tank: float | None = None) -> bool:
        names = self.building.names
        levels = {name: value if isinstance(value, float) else None for name, value in zip(names, told, strict=True)}
        if self._sets_tank:
            levels[TANK_NAME] = tank
        # What people set by hand is not in it, and the watchdog must not give it back either.
        self.building.notice(self.clock.now())
        told_by_name = self.building.to_set(levels)
        # Before the call: one that fails, or is interrupted, may have set them.
        anything = any(value is not None for value in told_by_name.values())
        self._set = self._set or anything
        if self.watchdog is not None and anything:
            self.watchdog.about_to_set(tuple(told_by_name), seconds, self.building.ours(told_by_name))
        if self.watchdog is not None and not told_by_name:
            self.watchdog.released()
        try:
            self.building.write(levels, seconds, told_by_name, self.clock.now())
        except Exception as error:  # somebody's connection may raise anything
            _LOG.warning("the levels %s were not taken (%s: %s)", levels, type(error).__name__, error)
            if self.watchdog is not None and anything:  # a device may have made something else of them
                self.watchdog.about_to_set(tuple(told_by_name), seconds, self.building.ours(told_by_name))
            return False
        if self.watchdog is not None:
            if anything:
                self.watchdog.set(tuple(told_by_name), seconds, self.building.ours(told_by_name))
            else:
                self.watchdog.released()
        return True

    def _release(self) -> None:
        """Give everything back, if anything was set; an interrupt meanwhile costs one attempt, and is raised after."""
        error = sys.exc_info()[1]
        ending = None if error is None else interruption(error)
        if not self._set:
            if ending is not None:
                ending.add_note("nothing had to be given back: nothing is set")
            return
        names = ", ".join(self.building.names)
        interrupt = until_taken(
            lambda: self._write((None,) * len(self.building.names), 0.0),
            self.clock,
            f"the building did not take back {names}",
            "give them back to its own control by hand",
        )
        self._end_applied()
        if (last := interrupt or ending) is not None:
            last.add_note(self._given_back())
        if interrupt is not None:
            raise interrupt

    def _given_back(self) -> str:
        """What was given back, and what was not since people set it, in words."""
        names = (*self.building.names, *((TANK_NAME,) if self._sets_tank else ()))
        told = self.building.to_set(dict.fromkeys(names))
        parts = {"given back to the building's own control": True, "left as people set it by hand": False}
        return "; ".join(
            f"{words}: {', '.join(some)}"
            for words, back in parts.items()
            if (some := [name for name in names if (self.building.key(name) in told) == back])
        )

    def _end_applied(self) -> None:
        if self._decided is None:
            return
        now_s = self.building.time_s(self.clock.now())
        self._commands = {}
        self._applied = [
            replace(action, duration_s=min(action.duration_s, max(now_s - action.start_s, 0.0)))
            for action in self._applied
        ]
        self._keep(*self._decided)
