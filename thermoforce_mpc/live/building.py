"""A real building at the instants of control steps: its record until then, and the forecast from then on.

What is kept of a run at a real building: what the controller knows, from step to step for the case that it is
started anew, and what the journal says of building, controller and model.

A record tells most of it again, but not what the watch has found, which sensor is not believed, the highest power so
far, how wide the forecast's interval has to be, and levels that nobody measures.
"""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from controllers.mpc.config import MPCConfig
from controllers.safety.deadline import BoundedCalls, Crashed
from controllers.state_classes import STATE_CLASSES
from thermoforce_mpc.commands.command import Command, TemperatureCommand
from thermoforce_mpc.commands.loop import LearnedCommand
from thermoforce_mpc.commands.tank import TANK_NAME, LearnedTank, TankRecord
from thermoforce_mpc.data import ACTING, DAY_S, SAMPLED, Array, Boundary, Layout, Names, Record, steps_in
from thermoforce_mpc.data.clock import CLOCKS_S, ZONES_S, in_celsius
from thermoforce_mpc.data.notes import Note
from thermoforce_mpc.errors import DataError, InputError, NoConnection, NoForecast, NotAsTold, PlantError, StorageError
from thermoforce_mpc.execution.progress import duration
from thermoforce_mpc.experiment.run_models import origin
from thermoforce_mpc.files import file_sha256, plain_json
from thermoforce_mpc.identification.probing.excitation import RoomsState
from thermoforce_mpc.identification.probing.probe import LevelsState, ProbingState
from thermoforce_mpc.live.windows import OpenWindow, as_if_empty, open_windows, without
from thermoforce_mpc.measurements.forecast import ReadBefore, read_forecast
from thermoforce_mpc.measurements.load import Measurements, learned_commands, learned_tank, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.tables.earlier import Earlier
from thermoforce_mpc.model.saved import JSON_NAME
from thermoforce_mpc.model.thermal_model import load_model
from thermoforce_mpc.protocols import Connection
from thermoforce_mpc.records.live_journal import UNNAMED_CURRENCY, RealRun
from thermoforce_mpc.records.people import People
from thermoforce_mpc.scenario.scenario import ControllerSpec, Scenario
from thermoforce_mpc.state_file import StateFormat

# What controllers look back at, and how old the latest reading may be for the record to say anything of now, days.
_BACK_DAYS, _OLDEST_DAYS = 31.0, 1.0
# Longest time for an answer of the connection, s, at most half a step; calls that may be left behind without one.
ANSWER_S, _LEFT_BEHIND = 60.0, 3
# Outdoor temperature of so many seconds, so far from its forecast, and as °F so near to it, K: a wrong unit.
_LATELY_S, _FAR_K, _NEAR_K = 10800.0, 10.0, 4.0
# Readings stamped so little after the clock are of the same one, s; by more than `CLOCKS_S` they are refused.
_SAME_CLOCK_S = 60.0
# Notes on what was left out that an error names, as a mistake is most often the first of them.
_MOST_SAID = 3
# Steps on end whose new readings are older than the step, from which on that is said.
_LATE = 3
# A device that takes whole degrees makes of a temperature one so far from it, K, and one that takes halves, which may
# repeat what it was told before it says so (Zigbee2MQTT does).
_ROUNDED_K, _HALVED_K = 0.51, 0.26
# Steps in which a device says what it said before its command, from which on that is said: one that sleeps is late.
_REVERTED = 3


@dataclass(frozen=True)
class Applied:
    """Levels (A,) that were set from `start_s` for `duration_s`, s; None where the building's own control acted."""

    start_s: float
    duration_s: float
    u: tuple[float | None, ...]


@dataclass(frozen=True)
class LastTold:
    """A command that an actuator was told, to hold `until` a time, ISO 8601.

    `before`: what was set before (NaN: unknown); `seen`: it was read since; `took`: what the device made of it, where
    that is another value (it rounds, or has limits of its own), else NaN.
    """

    name: str
    value: float
    before: float
    until: str
    seen: bool = False
    took: float = math.nan

    def holds(self, value: float, near: float) -> bool:
        """Whether a device that says `value` holds this command."""
        return abs(value - self.value) <= near or abs(value - self.took) <= near


class LiveBuilding:
    """Reads a building through its connection, by its map; times are those of `Record`, from the first record's year.

    Raises `PlantError` where the connection fails or does not answer within a minute (half a step, if that is shorter),
    and `DataError` where its tables cannot be used.
    """

    def __init__(
        self,
        connection: Connection,
        rules: MeasurementMap,
        step_s: float,
        prices: Path | None = None,
        people: People | None = None,
        map_file: Path | None = None,
    ) -> None:
        """`prices`: a file of them, read anew in each step, in the place of those of the map; `people`: who ask.

        `map_file`: that of the `rules`; a note says where it was changed since.
        """
        self._map_file, self._map_read = map_file, None if map_file is None else map_file.read_bytes()
        self._prices, self._people = prices, people
        self._told: dict[str, LastTold] = {}
        self._rounds = set[str]()  # said already
        self._hand_read = dict[str, float]()  # what was set by hand and read since
        self._forecast_before = ReadBefore()
        self._read_before = Earlier(_BACK_DAYS)
        self._reverted: dict[str, int] = {}
        self._looked: tuple[pd.Timestamp, pd.Timestamp] | None = None
        self._late = 0
        self.connection, self._rules, self._step_s = connection, rules, step_s
        if (reads := getattr(connection, "reads", None)) is not None:
            reads([column for _, signal in rules.signals() for column in signal.columns])
        self._origin: pd.Timestamp | None = None
        self._measured: Measurements | None = None
        self._calls, self._answer_s = BoundedCalls(_LEFT_BEHIND), min(ANSWER_S, 0.5 * step_s)
        # Levels are written, and given back, also while a table is still waited for.
        self._reader, self._writer = object(), object()
        self.left_out: tuple[str, ...] = ()
        self._windows: Mapping[int, OpenWindow] = {}
        self.now: pd.Timestamp | None = None

    @property
    def all_names(self) -> Names:
        """Names of zones, actuators and machines."""
        return self._rules.names if self._measured is None else self._measured.record.names

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the actuators that are set."""
        return self.all_names.actuators

    @property
    def step_s(self) -> float:
        """Step of its record, s."""
        return self._step_s

    def table(self) -> pd.DataFrame | str | Path:
        """What the connection gives as measurements; raises `PlantError`."""
        table: pd.DataFrame | str | Path = self._call("measurements")
        return table

    def command_of(self, name: str) -> Command | None:
        """What is set in the place of the level of an actuator, or at the tank, by the map; None where its level is."""
        if name == TANK_NAME:
            return None if self._rules.hot_water is None else self._rules.hot_water.command
        found = self._rules.command_of(name)
        return None if found is None else found[1]

    @property
    def paused(self) -> str:
        """Why people want nothing set, '' where they do not."""
        return "" if self._people is None else self._people.paused

    @property
    def layout(self) -> Layout:
        """What acts where; known after the first record."""
        assert self._measured is not None
        return self._measured.layout

    @property
    def origin(self) -> pd.Timestamp:
        """The new year that seconds count from; known after the first record."""
        assert self._origin is not None
        return self._origin

    def count_from(self, origin: pd.Timestamp) -> None:
        """Count seconds from `origin`, as an earlier run did."""
        self._origin = origin.tz_convert(self._rules.time.zone or "UTC")

    def instant(self, now: pd.Timestamp) -> pd.Timestamp:
        """The last instant at which a step begins, at or before `now`: whole steps from the new year of the zone."""
        local = now.tz_convert(self._rules.time.zone or "UTC")
        new_year = pd.Timestamp(year=local.year, month=1, day=1, tz=local.tz)
        steps = math.floor(((local - new_year).total_seconds() + 1e-3) / self._step_s)
        return new_year + pd.Timedelta(seconds=steps * self._step_s)

    def time_s(self, at: pd.Timestamp) -> float:
        """`at` in seconds, as the record has it; known after the first record."""
        return float((at - self.origin).total_seconds())

    def record(self, instant: pd.Timestamp, applied: Sequence[Applied] = (), now: pd.Timestamp | None = None) -> Record:
        """What was measured until `instant`; steps without readings are NaN, but for levels that were `applied`.

        `now`: the time, by default `instant`. What was left out of the tables is in `left_out`.

        Raises:
            ConfigError: the table has no time zone.
            DataError: it cannot be used, ends more than a day before, or has readings of times to come.
            PlantError: the connection failed.
        """
        self.now = now = instant if now is None else now
        measured = read_measurements(
            self._call("measurements"), self._rules, step_s=self._step_s, at=instant, now=now, before=self._read_before
        ).served()
        record = measured.record
        of_clocks = (*self._ahead(measured, now), *self._behind(measured, now))
        self.left_out = (*measured.left_out, *of_clocks, *self._set_by_hand(measured, now), *self._of_map())
        if paused := self.paused:
            self.left_out = (*self.left_out, paused)
        self._origin = record.origin if self._origin is None else self._origin
        shift_s = (record.origin - self._origin).total_seconds()
        record = replace(record, time_s=record.time_s + shift_s, origin=self._origin)
        record = _until(record, self.time_s(instant), measured.left_out)
        record = replace(record, u=_with_applied(record, applied)).last(round(_BACK_DAYS * DAY_S / self._step_s))
        at = np.searchsorted(measured.record.time_s + shift_s, record.time_s + 1.0) - 1  # the last known holds
        contacts = {name: contact[np.maximum(at, 0)] for name, contact in measured.windows.items()}
        self._windows = open_windows(record, measured.layout, contacts)
        record = without(record, self._windows)
        self.left_out = (*self.left_out, *self._of_windows(record.names.zones))
        conditions = replace(measured.conditions, time_s=measured.conditions.time_s + shift_s)
        tank = measured.tank and replace(measured.tank, time_s=measured.tank.time_s + shift_s)
        self._measured = replace(measured, record=record, conditions=conditions, tank=tank)
        return record

    def commands(self) -> dict[str, LearnedCommand]:
        """The commands of the map, with what the measurements tell of them; raises as `record`, and `DataError`."""
        now = pd.Timestamp.now("UTC")  # a table that a machine appends to, also after a power failure
        measured = read_measurements(self._call("measurements"), self._rules, step_s=self._step_s, now=now)
        return learned_commands(measured.served())

    def tank(self) -> LearnedTank | None:
        """The tank of the map, with what the measurements tell of it; raises as `commands`."""
        now = pd.Timestamp.now("UTC")
        return learned_tank(
            read_measurements(self._call("measurements"), self._rules, step_s=self._step_s, now=now).served()
        )

    def tank_log(self) -> tuple[TankRecord, pd.Timestamp] | None:
        """What was measured of the tank until the last `record`, and what its seconds count from; None without one."""
        tank = None if self._measured is None else self._measured.tank
        return None if tank is None else (tank, self.origin)

    def tank_now(self) -> tuple[float, bool]:
        """Temperature of the tank at the last `record`, °C, NaN where it is not known, and whether it is charged."""
        tank = None if self._measured is None else self._measured.tank
        return (math.nan, False) if tank is None else tank.now()

    def _of_map(self) -> tuple[str, ...]:
        """A note where the file of the map was changed."""
        with suppress(OSError):  # it is being written, and was read
            if self._map_file is not None and self._map_file.read_bytes() != self._map_read:
                return (f"{self._map_file}: changed since control began: it takes effect at a restart",)
        return ()

    def _ahead(self, measured: Measurements, now: pd.Timestamp) -> tuple[str, ...]:
        """A note on readings stamped a little after the clock; raises `DataError` where it is more: what is of now?"""
        newest_s = measured.newest_s()
        ahead_s = newest_s - (now - measured.record.origin).total_seconds()
        if not ahead_s > _SAME_CLOCK_S:
            return ()
        newest = measured.record.origin + pd.Timedelta(seconds=newest_s)
        after = f"{_duration(ahead_s)} after the clock ({now:%H:%M %Z})"
        what = f"the newest temperature of a room is stamped {newest}, {after}"
        if ahead_s <= CLOCKS_S:
            return (Note(f"{what}: set one of the clocks", "set one of the clocks"),)
        of_zone = self._another_zone
        cause = f"probably {of_zone}" if ahead_s >= ZONES_S else f"one of the clocks is wrong, or {of_zone}"
        raise DataError(f"{what}: {cause}. Nothing is set on readings of another time")

    @property
    def _another_zone(self) -> str:
        zone = self._rules.time.zone
        return f"time.zone of the map, {zone}, is not the zone of the stamps" if zone else "the stamps' offset is wrong"

    def _behind(self, measured: Measurements, now: pd.Timestamp) -> tuple[str, ...]:
        """A note where readings come step by step, and are stamped before the last look at them, which had them not.

        A logger that keeps winter time all year is an hour behind in summer; one that stands gives no new ones.
        """
        if not math.isfinite(newest_s := measured.newest_s()):
            return ()
        newest = measured.record.origin + pd.Timedelta(seconds=newest_s)
        before, self._looked = self._looked, (newest, now)
        if before is not None and newest > before[0]:
            late_s = (before[1] - newest).total_seconds()
            self._late = self._late + 1 if late_s > _SAME_CLOCK_S else 0
        if self._late < _LATE:
            return ()
        come = "temperatures of rooms come, but stamped before the step in which they came"
        return (f"{come}: {self._another_zone}, or they are late; plans take the house for what it was then",)

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """The forecast from the last `record` on; see `Plant.forecast`.

        Once there was one, a file of prices that cannot be read costs the prices only, and weather that is not there
        leaves the prices of their own file, as `NoForecast.known`.
        """
        assert self._measured is not None
        n = round(horizon_s / interval_s)
        try:
            ahead = self._ahead_of(self._call("forecast"), n)
            self.left_out = (*self.left_out, *_doubt_of_outdoors(self._measured.record, ahead))
            return ahead
        except (InputError, PlantError) as error:
            known = None
            if self._forecast_before.any:
                with suppress(InputError):
                    known = self._ahead_of(None, n)
            raise NoForecast(str(error), known=known) from error

    def _ahead_of(self, table: pd.DataFrame | str | Path | None, n: int) -> Boundary:
        """`n` steps of the forecast by `table` (None: there is none), with what people ask; raises `InputError`."""
        assert self._measured is not None
        left_out = list[str]()
        ahead = read_forecast(
            table,
            self._measured,
            least_steps=n,
            prices=self._prices,
            now=self.now,
            left_out=left_out,
            before=self._forecast_before,
        )
        if self._people is not None and self.now is not None:
            ahead, asked = self._people.applied(ahead, self.origin, self.now)
            left_out += asked
        self.left_out = (*self.left_out, *left_out)
        return as_if_empty(ahead, self._windows).head(n)

    def write(
        self,
        levels: Mapping[str, float | None],
        seconds: float,
        told: Mapping[str, float | None] | None = None,
        now: pd.Timestamp | None = None,
    ) -> None:
        """Set what `to_set` says of levels (`told`, where it was asked) `now`, by default the time of the last reading;
        raises what the connection raises, and where it does not answer. A device that rounds took its command.
        """
        told, now = self.to_set(levels) if told is None else told, self.now if now is None else now
        if self._people is not None and now is not None:
            keys = {name: self.key(name) for name in levels}
            self._note({name: told[key] for name, key in keys.items() if key in told}, seconds, now)

        def write() -> None:
            if told or not levels:
                self.connection.write(told, seconds)
            elif (leave := getattr(self.connection, "leave", None)) is not None:
                leave()

        try:
            self._answered(write)
        except Exception as error:  # a device that made something else of it did not take it, and holds that
            if not isinstance(error, NotAsTold):
                self._note_taken(levels)
                raise
            if not self._note_rounded(error, levels, told, self._note_taken(levels, error.names)):
                raise
            return
        self._note_taken(levels)

    def _note_rounded(
        self,
        error: NotAsTold,
        levels: Mapping[str, float | None],
        told: Mapping[str, float | None],
        held: Mapping[str, float],
    ) -> bool:
        """Whether all that `held` another value only rounded what they were `told`, which is said and noted."""
        of = [name for name in levels if self.key(name) in error.names]
        for name in of:
            value, took = told.get(self.key(name)), held.get(self.key(name), math.nan)
            if value is None or not abs(took - value) <= self._rounded(name):
                return False
        for name in of:
            if name in self._told:
                self._told[name] = replace(self._told[name], seen=True, took=held[self.key(name)])
            if name not in self._rounds:
                self._rounds.add(name)
                _LOG.warning("%s rounds its command: %s", name, error)
        return bool(of)

    def to_set(self, levels: Mapping[str, float | None]) -> dict[str, float | None]:
        """What the connection is told of levels, see `Connection.write`, by its own names.

        One command of a machine is set once, under its name; it is left alone where one of what it feeds is. What
        people set by hand lately is not in it, and stays as it is, also when the building is given back.
        """
        told: dict[str, float | None] = {}
        for name, value in levels.items():
            key = self.key(name)
            told[key] = None if key in told and told[key] is None else value
        if self._people is not None and self.now is not None:
            for name in self._people.by_hand(self.now):
                told.pop(self.key(name), None)
        return told

    @property
    def puts_back(self) -> bool:
        """Whether the connection can set again what devices held (`put_back`), and not only give them back."""
        return hasattr(self.connection, "put_back")

    def put_back(self, held: Mapping[str, float]) -> None:
        """Set again what devices held, by the connection's names; raises as `write`."""
        self._answered(lambda: self.connection.put_back(held))  # type: ignore[attr-defined]

    def leave(self) -> None:
        """Tell the connection that nothing is held, since people set it; raises as `write`."""
        if (leave := getattr(self.connection, "leave", None)) is not None:
            self._answered(leave)

    def held(self, keys: Sequence[str]) -> dict[str, float]:
        """What devices say that they hold of `keys`, the connection's names; none where they do not say it."""
        says = getattr(self.connection, "present", None)
        if says is None:
            return {}
        try:
            return dict(self._answered(lambda: says(list(keys))))
        except Exception as error:  # somebody's connection may raise anything
            _LOG.info("what the devices hold is not known (%s: %s)", type(error).__name__, error)
            return {}

    def _answered(self, call: Callable[[], Any]) -> Any:
        """What a call of the connection answers, in time; raises what it raises."""
        try:
            return self._calls(self._writer, call, self._answer_s)
        except Crashed as crashed:  # such as an interrupt
            raise (crashed.__cause__ or crashed) from None

    def zone_of(self, name: str) -> str:
        """The room that an actuator serves."""
        own = self._rules.actuators.get(name)
        return next(iter(self._rules.zones)) if own is None or own.zone is None else own.zone

    def machines_of(self, names: Sequence[str]) -> tuple[str, ...]:
        """The machines that feed actuators."""
        own, first = self._rules.actuators, next(iter(self._rules.machines), "")
        return tuple(dict.fromkeys((own[name].machine if name in own else None) or first for name in names))

    def key(self, name: str) -> str:
        """What the connection calls the command of an actuator: that of a machine for several rooms is the machine."""
        found = self._rules.command_of(name)
        kind, _, of = found[0].partition(".") if found else ("", "", "")
        return of if kind == "machines" else name

    @property
    def told(self) -> tuple[LastTold, ...]:
        """What commands were told last and may be held yet: what differs from it somebody set by hand."""
        return tuple(self._told.values())

    def remember(self, told: Sequence[LastTold]) -> None:
        """Go on from what an earlier controller of the building was `told`."""
        names = (*self.names, TANK_NAME)
        self._told = {one.name: one for one in told if one.name in names and self.command_of(one.name)}

    def _note(self, levels: Mapping[str, float | None], seconds: float, now: pd.Timestamp) -> None:
        until = (now + pd.Timedelta(seconds=seconds)).isoformat()
        for name, value in levels.items():
            if value is None or self.command_of(name) is None:
                self._told.pop(name, None)
            elif (told := self._told.get(name)) is None or told.value != value:
                self._told[name] = LastTold(name, value, self._commanded(name), until)
            else:
                self._told[name] = replace(told, until=until)

    def _note_taken(self, names: Iterable[str], besides: Sequence[str] = ()) -> dict[str, float]:
        """Note what devices made of what they were told just now, of those that say what they hold (`present`).

        Returns what they hold, and what those do that the connection names so `besides`.
        """
        new = [name for name in names if name in self._told and not self._told[name].seen]
        asked = list(dict.fromkeys([*map(self.key, new), *besides]))
        held = self.held(asked) if asked else {}
        for name in new:
            value, told, near = held.get(self.key(name), math.nan), self._told[name], self.nearness(name)
            if near is None or not math.isfinite(value) or told.holds(value, near):
                continue
            if not abs(value - told.before) <= near:  # else it may not have taken it yet
                self._told[name] = replace(told, seen=True, took=value)
        return held

    def _commanded(self, name: str) -> float:
        """The command as it was read last; NaN where it was not."""
        return float("nan") if self._measured is None else _last_command(self._measured, name)

    def _set_by_hand(self, measured: Measurements, now: pd.Timestamp) -> tuple[str, ...]:
        """Notes on commands that are not what was set, nor what was before: somebody set them, and is respected.

        What was before may be read yet where a device did not take ours; once it did, any other value is a person's.
        """
        if self._people is None:
            return ()
        notes = []
        for name in dict(self._told):
            value = _last_command(measured, name)
            if self._reverts(name, value, now):
                notes.append(
                    f"{name}: for {_REVERTED} steps or more it says what stood there before, not what was set: it does "
                    "not take its command, or gives it back; look at its mode, its app and what else sets it"
                )
            self._compare(name, value, now)
        self._set_again(measured, now)
        for name, (value, until) in self._people.by_hand(now).items():
            command = self.command_of(name)
            what = f"{value:g}" if command is None else command.in_words(value)
            zone = self._rules.time.zone or "UTC"
            notes.append(f"{name}: {what} was set by hand: left alone until {until.tz_convert(zone):%a %H:%M}")
        return tuple(notes)

    def _set_again(self, measured: Measurements, now: pd.Timestamp) -> None:
        """Keep what was set by hand anew where another value is read than was read before: a person's too."""
        assert self._people is not None
        by_hand = self._people.by_hand(now)
        self._hand_read = {name: value for name, value in self._hand_read.items() if name in by_hand}
        for name, (value, _) in by_hand.items():
            read, near = _last_command(measured, name), self.nearness(name)
            if near is None or not math.isfinite(read) or name in self._told:
                continue
            if abs(read - value) > near and abs(self._hand_read.get(name, math.nan) - value) <= near:
                self._people.set_by_hand(name, value := read, now)
            if abs(read - value) <= near:
                self._hand_read[name] = value

    def notice(self, now: pd.Timestamp) -> None:
        """Note what was set by hand until `now`, since the last reading, of devices that say it (`present`)."""
        if self._people is None or self.now is None or not self._told:
            return
        held = self.held([self.key(name) for name in self._told])
        for name in dict(self._told):
            self._compare(name, float(held.get(self.key(name), float("nan"))), now)

    def nearness(self, name: str) -> float | None:
        """How far what a device holds may be from the command that it was set to; None where a level is set."""
        if (command := self.command_of(name)) is None:
            return None
        near = 0.51 * float(getattr(command, "step", 1.0))
        return max(near, _HALVED_K) if isinstance(command, TemperatureCommand) else near

    def ours(self, told: Mapping[str, float | None]) -> dict[str, list[tuple[float, float | None]]]:
        """Values by which devices show that they hold what they were `told`, and how near, by the connection's names:
        what was set, and what they made of it.
        """
        out: dict[str, list[tuple[float, float | None]]] = {}
        for name in (*self.names, TANK_NAME):
            value, near = told.get(key := self.key(name)), self.nearness(name)
            if value is None:
                continue
            noted = self._told.get(name)
            took = [] if noted is None or not math.isfinite(noted.took) else [(noted.took, near)]
            out[key] = [*out.get(key, [(value, near)]), *took]
        return out

    def _compare(self, name: str, value: float, now: pd.Timestamp) -> None:
        """Keep `value` as a person's where it is neither what was set nor what was before; NaN: not known."""
        told, near = self._told[name], self.nearness(name)
        if near is None or not math.isfinite(value) or self._people is None:
            return
        left_s = (pd.Timestamp(told.until) - now).total_seconds()
        # It ended by itself, or the watchdog gave it back; nothing is set for so long, but the clock may be set back.
        if not 0.0 <= left_s <= 2.0 * self._step_s:
            del self._told[name]
        elif told.holds(value, near):
            self._told[name] = replace(told, seen=True)
        elif not told.seen and abs(value - told.value) <= self._rounded(name) and not abs(value - told.before) <= near:
            self._told[name] = replace(told, seen=True, took=value)
        elif told.seen or (math.isfinite(told.before) and abs(value - told.before) > near):
            self._people.set_by_hand(name, value, now)
            del self._told[name]

    def _reverts(self, name: str, value: float, now: pd.Timestamp) -> bool:
        """Whether a device that says `value` (NaN: nothing) has not held its commands for so long that it is said."""
        told, near = self._told[name], self.nearness(name)
        if near is None or not math.isfinite(value) or now > pd.Timestamp(told.until):
            return False
        if told.holds(value, near):
            self._reverted[name] = 0
        elif abs(value - told.before) <= near:
            self._reverted[name] = self._reverted.get(name, 0) + 1
        return self._reverted.get(name, 0) >= _REVERTED

    def _rounded(self, name: str) -> float:
        """How far from its command a device may be that rounds it."""
        return _ROUNDED_K if isinstance(self.command_of(name), TemperatureCommand) else 0.0

    def _of_windows(self, names: Sequence[str]) -> list[str]:
        """Notes on open windows."""
        zone = self._rules.time.zone or "UTC"
        until = {z: self.origin + pd.Timedelta(seconds=one.until_s) for z, one in self._windows.items()}
        return [
            f"{names[z]}: {one.why}; nothing is needed and nothing is learned there until "
            f"{until[z].tz_convert(zone):%H:%M}, or until it comes back"
            for z, one in self._windows.items()
        ]

    def _call(self, what: str) -> Any:
        try:
            return self._calls(self._reader, getattr(self.connection, what), self._answer_s)
        except NoConnection:
            raise
        except Exception as error:  # somebody's connection may raise anything
            raise PlantError(f"the connection gives no {what} ({type(error).__name__}: {error})") from error


def _last_command(measured: Measurements, name: str) -> float:
    """The command as it was read last; NaN where it was not."""
    if name == TANK_NAME:
        return float("nan") if measured.tank is None else float(measured.tank.command[-1])
    was = measured.commands.get(name)
    return float("nan") if was is None else float(was.at[-1])


def _doubt_of_outdoors(record: Record, ahead: Boundary) -> tuple[str, ...]:
    """A note where the outdoor temperature is far from its forecast for now: another unit, place or column."""
    measured = record.T_out_C[-steps_in(_LATELY_S, record.step_s) :]
    known, given = measured[np.isfinite(measured)], float(ahead.T_out_C[0])
    if not known.size or not math.isfinite(given):
        return ()
    now_C = float(np.median(known))
    if abs(now_C - given) <= _FAR_K:
        return ()
    found = f"outdoors it is {now_C:.1f} °C as measured and {given:.1f} °C by the forecast"
    for what, one, other in (("measured", now_C, given), ("in the forecast", given, now_C)):
        if abs(in_celsius(one) - other) < _NEAR_K:
            return (Note(f"{found}: °F {what}? set unit", f"outdoors: °F {what}"),)
    doubt = f"{found}: is the sensor in the sun, at a warm wall, or another one, or the forecast of another place?"
    return (Note(doubt, "outdoors: another place"),)


def _duration(seconds: float) -> str:
    return f"{seconds / 3600.0:.3g} h" if seconds >= 3600.0 else f"{seconds / 60.0:.3g} min"


def _until(record: Record, now_s: float, left_out: Sequence[str]) -> Record:
    """`record` cut at `now_s`, or lengthened to it by steps that were not measured; `left_out` may say why it ends."""
    step_s = record.step_s
    missing = round((now_s - float(record.time_s[-1])) / step_s)
    if missing <= 0:
        if record.n_steps + missing < 1:
            raise DataError(f"the measurements begin at {record.stamps()[0]}, after now: is the zone of the map right?")
        return record.slice(0, record.n_steps + missing)
    if missing * step_s > _OLDEST_DAYS * DAY_S:
        raise DataError(
            f"the measurements end at {record.stamps()[-1]}, {duration(missing * step_s)} ago: does the logger run?"
            + "".join(f"\n  {note}" for note in left_out[:_MOST_SAID])
        )

    def longer(values: Array) -> Array:
        return np.concatenate([values, np.full((*values.shape[:-1], missing), np.nan)], axis=-1)

    values: dict[str, Any] = {name: longer(getattr(record, name)) for name in (*SAMPLED, *ACTING)}
    if record.meter_W.size:
        values["meter_W"] = longer(record.meter_W)
    values["time_s"] = np.append(record.time_s, record.time_s[-1] + step_s * np.arange(1, missing + 1))
    return replace(record, **values)


def _with_applied(record: Record, applied: Sequence[Applied]) -> Array:
    """Levels (A, n) of `record`; where they were not measured, the mean of what was set over the whole step."""
    u, step_s = np.array(record.u), record.step_s
    total, known_s = np.zeros(u.shape), np.zeros(u.shape)
    for action in applied:
        begun = np.maximum(record.time_s[:-1], action.start_s)
        shared_s = np.clip(np.minimum(record.time_s[1:], action.start_s + action.duration_s) - begun, 0.0, None)
        for a, level in enumerate(action.u):
            if level is not None:
                total[a] += level * shared_s
                known_s[a] += shared_s
    whole = np.isnan(u) & (known_s > step_s - 1.0)
    u[whole] = (total[whole] / known_s[whole]) if whole.any() else 0.0
    return u


_LOG = logging.getLogger(__name__)
# After a longer pause too much has changed.
_OLDEST = pd.Timedelta(days=1)


@dataclass(frozen=True)
class SetCommand:
    """The command `value` of an actuator that has been set `since` a time, to hold `until` another, ISO 8601."""

    name: str
    value: float
    since: str
    until: str


@dataclass(frozen=True)
class Kept:
    """The controller's state `before` and `after` the decision at `instant`, and levels `applied` so far.

    Seconds count from `origin`; both times in ISO 8601. `of` tells controllers apart. `commands`: what is set now;
    `told`: see `LiveBuilding.told`.
    """

    origin: str
    instant: str
    before: object
    after: object
    applied: tuple[Applied, ...]
    of: str = ""
    commands: tuple[SetCommand, ...] = ()
    told: tuple[LastTold, ...] = ()

    def __post_init__(self) -> None:
        """Raise `ValueError` for a time that is none, or a number that is not finite."""
        ends = [at for one in self.commands for at in (one.since, one.until)] + [one.until for one in self.told]
        for at in (self.origin, self.instant, *ends):
            if pd.Timestamp(at).tzinfo is None:
                raise ValueError(f"{at!r} is no time with a zone")
        levels = [u for one in self.applied for u in (one.start_s, one.duration_s, *one.u) if u is not None]
        values = [one.value for one in self.commands] + [one.value for one in self.told]
        if not all(map(math.isfinite, [*levels, *values])):
            raise ValueError("what was set is not finite")

    def state_at(self, instant: pd.Timestamp) -> object:
        """The state to decide with at `instant`; the step that was decided already is decided once more."""
        return self.before if instant == pd.Timestamp(self.instant) else self.after


_FORMAT = StateFormat((*STATE_CLASSES, ProbingState, LevelsState, RoomsState, Kept, Applied, SetCommand, LastTold))


class KeptState:
    """The file at `path`, of the `controller` with this digest of model and options. It stops no control: what is wrong
    with the file is in the log."""

    def __init__(self, path: Path, controller: str) -> None:
        self._path, self._controller = path, controller
        self._failed = False

    def load(self, now: pd.Timestamp) -> Kept | None:
        """What was kept less than a day ago of the same controller; None where there is none."""
        if not self._path.exists():
            return None
        try:
            kept = _FORMAT.read(self._path)
        except InputError as error:
            _LOG.warning("%s: begun anew", error)
            return None
        if not isinstance(kept, Kept) or kept.of != self._controller:
            wrong = "another model or other options: begun anew"
        elif now - pd.Timestamp(kept.instant) > _OLDEST:
            wrong = f"{kept.instant}, more than a day ago: begun anew"
        elif now < pd.Timestamp(kept.instant):
            wrong = f"{kept.instant}, which is to come: was the clock set back? Begun anew"
        else:
            _LOG.info("goes on from the state of %s in %s", kept.instant, self._path)
            return kept
        _LOG.warning("%s is of %s", self._path, wrong)
        return None

    def save(self, content: Kept) -> None:
        """Keep what is known; a first failure is in the log."""
        try:
            _FORMAT.write(self._path, replace(content, of=self._controller))
        except (StorageError, TypeError) as error:
            if not self._failed:
                _LOG.warning("the state is not kept, and a restart begins anew: %s", error)
            self._failed = True


def real_run(
    out: Path,
    model: Path | None,
    map_file: Path,
    rules: MeasurementMap,
    options: MPCConfig,
    connection: str,
    controller: str = "thermoforce_mpc",
) -> RealRun:
    """The run of a controller with the model in the folder `model`, if any, of which a copy is kept in `out`.

    Raises `ArtifactError` where the model is damaged.
    """
    spec = ControllerSpec(name=controller, options=options.model_dump(mode="json", exclude_unset=True))
    models = {} if model is None else {spec.name: _kept_model(out, model)}
    return RealRun(
        name=map_file.stem,
        zone=rules.time.zone or "UTC",
        currency=rules.currency or UNNAMED_CURRENCY,
        scenario=Scenario(testcase=map_file.stem, controller=spec, baselines=()),
        command=("tf-mpc", *sys.argv[1:]),
        connection=connection,
        models=models,
    )


def _kept_model(out: Path, model: Path) -> dict[str, Any]:
    """What the journal says of a model, of which a copy is kept in the folder `out` under a name of its own."""
    thermal, sha256 = load_model(model), file_sha256(model / JSON_NAME)
    name = f"model-{sha256[:8]}"
    refused = ""
    if not (out / name / JSON_NAME).is_file():
        try:
            thermal.save(out / name)
        except StorageError as error:
            refused = str(error)
    of = {"sha256": sha256, "refused": refused, "origin": plain_json(origin(thermal))}
    return {"folder": None if refused else name, **of}
