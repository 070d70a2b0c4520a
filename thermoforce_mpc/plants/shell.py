"""What simulated plants share: the checks of what they are asked, the clock, the samples so far, and giving back.

A plant of its own physics extends `PlantShell`; one that is reached otherwise needs only the `Plant` protocol, and the
checks, which stand first.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, Self, TypeVar, cast

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.data import (
    DAY_S,
    SINGLE,
    YEAR_S,
    Array,
    Block,
    Boundary,
    Commands,
    CommandValue,
    Levels,
    Measurement,
    Names,
    Period,
    Record,
    commands_of_each,
)
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.files import plain_number
from thermoforce_mpc.plants.kpis import Between, CountedKpis
from thermoforce_mpc.scenario.actuator import Actuator, RoomSetpoints
from thermoforce_mpc.scenario.building import PRICES, Price


def day_period(name: str, named: Iterable[str]) -> Period:
    """Return two weeks from start day `name`; raises `InputError`, with the windows `named`, for anything else."""
    if not is_day(name):
        raise InputError(f"period '{name}': expected {', '.join(named) or 'nothing else'} or a start day")
    day = float(name)
    if not 0.0 <= day < 365.0:
        raise InputError(f"period '{name}': a start day lies between 0 and 365")
    return Period(f"day {day:g}", day * DAY_S)


def is_day(name: str) -> bool:
    """Whether the name of a window is a number: its start day."""
    try:
        plain_number(name)
    except ValueError:
        return False
    return True


def check_start(start_s: float, warmup_s: float) -> None:
    """Raise `InputError` unless both are finite, nonnegative seconds and the start lies inside the year."""
    for label, value in (("start", start_s), ("warm-up", warmup_s)):
        if not (isinstance(value, int | float) and math.isfinite(value) and value >= 0):
            raise InputError(f"{label} of {value!r} s: expected a finite, nonnegative number of seconds")
    if start_s >= YEAR_S:
        raise InputError(f"start of {start_s:g} s lies beyond the year ({YEAR_S:g} s)")


def check_levels(
    u: Levels,
    duration_s: float,
    command: Commands = None,
    *,
    names: Names = SINGLE,
    u_min: float | Sequence[float] = 0.0,
) -> Block:
    """Return levels and commands as given to a plant, one entry for each of its A actuators.

    Args:
        u: levels (A,), None for the plant's own control; a number for one actuator, None for all.
        duration_s: how long to apply them, s.
        command: of each actuator, a number or a heating and a cooling set-point, °C, see `Block`; None for all.
        names: names of the actuators.
        u_min: lowest level, of all actuators or of each.

    Raises:
        InputError: entries that are not one per actuator, a level not in [`u_min`, 1], a command that is neither a
            finite number nor two rising ones, or a duration that is not positive and less than a year; names the
            actuator.
    """
    n, alone = len(names.actuators), len(names.actuators) == 1
    levels: tuple[Any, ...] = (None,) * n if u is None else (u,) if np.ndim(u) == 0 else tuple(u)  # type: ignore[arg-type]
    commands = commands_of_each(command, n)
    for what, values in (("levels", levels), ("commands", commands)):
        if len(values) != n:
            raise InputError(
                f"{what} of {len(values)} actuators: expected one for each of {', '.join(names.actuators)}"
            )
    each = (u_min,) * n if isinstance(u_min, _NUMBERS) else u_min
    for name, level, least, told in zip(names.actuators, levels, each, commands, strict=True):
        of = "" if alone else f" for '{name}'"
        if level is not None and not (is_number(level) and least <= level <= 1.0):
            raise InputError(f"level of {level!r}{of}: expected a number from {least:g} to 1, or None")
        if told is not None and np.shape(told) == (2,):
            if not (all(map(is_number, told)) and told[0] <= told[1]):
                raise InputError(
                    f"room set-points of {told!r} °C{of}: expected a heating set-point not above the cooling one"
                )
        elif told is not None and not is_number(told):
            raise InputError(f"command of {told!r}{of}: expected a finite number or two rising set-points, °C")
    if not (is_number(duration_s) and 0 < duration_s < YEAR_S):
        raise InputError(f"step of {duration_s!r} s: expected a positive number, less than a year")
    return Block(levels, float(duration_s), commands)


_NUMBERS = (int, float, np.number)


def is_number(value: Any) -> bool:
    """Whether `value` is a finite number."""
    return isinstance(value, _NUMBERS) and bool(np.isfinite(value))


def plant_inputs(
    actuator: Actuator | RoomSetpoints, u: float | None, command: CommandValue | None, T_zone_C: float
) -> dict[str, float]:
    """Return an actuator's inputs for a level with the room at `T_zone_C` or, for room set-points, the command, °C.

    Raises `InputError` for a command that the actuator does not have, or a level between the limits for a loop without
    set-points.
    """
    pair = command if isinstance(command, tuple) else None
    if command is not None and pair is None:
        raise InputError(f"command of {command!r}: the actuator takes levels or room set-points")
    if isinstance(actuator, RoomSetpoints):
        if pair is None and u is not None and u not in (-1.0, 0.0, 1.0) and u != actuator.u_min:
            raise InputError(f"level of {u:g} without room set-points: a loop can only be driven to its limits")
        return actuator.inputs(u, pair)
    if pair is not None:
        raise InputError(f"room set-points of {pair!r}: the actuator '{actuator.point}' has none")
    return actuator.inputs(u, T_zone_C)


def forecast_times(now_s: float, horizon_s: float, interval_s: float) -> Array:
    """Return the instants from `now_s` to `horizon_s` ahead every `interval_s`, s, shape (N + 1,).

    Raises `InputError` where horizon or interval is not positive, or the horizon is shorter than the interval.
    """
    if not (math.isfinite(horizon_s) and math.isfinite(interval_s) and 0 < interval_s <= horizon_s):
        raise InputError(f"forecast of {horizon_s!r} s every {interval_s!r} s: expected 0 < interval <= horizon")
    steps = np.arange(math.floor(horizon_s / interval_s + 1e-9) + 1, dtype=np.float64)
    return np.asarray(now_s + steps * interval_s, dtype=np.float64)


def check_record_step(step_s: float) -> None:
    """Raise `InputError` unless a record can be asked for at steps of `step_s`: finite and positive, s."""
    if not (math.isfinite(step_s) and step_s > 0):
        raise InputError(f"history at {step_s!r} s: expected a positive number of seconds")


def record_times(begin_s: float, now_s: float, step_s: float) -> Array:
    """Return the ends of steps back from `now_s` to `begin_s`, s, shape (n + 1,); raises as `check_record_step`."""
    check_record_step(step_s)
    n = math.floor((now_s - begin_s) / step_s + 1e-9)
    return np.asarray(now_s - np.arange(float(n), -1.0, -1.0) * step_s)


# Smallest time difference between two samples, s.
CLOCK_S = 1e-6


class Releasing:
    """Context manager that closes at its end."""

    def close(self) -> None:
        """Do nothing: the plant holds no resources."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class _Process(Protocol):
    def close(self) -> None: ...


P = TypeVar("P", bound=_Process)


class WithProcess(Releasing, Generic[P]):
    """Has a process of its own from its reset on."""

    _process: P | None = None

    @property
    def _running(self) -> P:
        self._check_started()
        return cast(P, self._process)

    def _check_started(self) -> None:
        if self._process is None:
            raise InputError("the plant has not been started: call reset() first")

    def close(self) -> None:
        """End the process; safe to call twice."""
        if self._process is not None:
            self._process.close()
            self._process = None


class PlantShell(Releasing, ABC):
    """A plant whose physics run in steps from a reset on; see `Plant` for what its methods do and raise."""

    _names: Names = SINGLE
    _u_min: float | Sequence[float] = 0.0
    _price: Price = "constant"
    _tariffs: Mapping[str, tariffs.Tariff]
    _start_s = _begin_s = _now_s = 0.0

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """Start at `start_s` after `warmup_s` of native control, shortened at the beginning of the year.

        Raises:
            InputError: a time is not a finite nonnegative number inside the year, or the tariff is unknown.
            PlantError: what simulates it failed.
        """
        self._check_reset(start_s, warmup_s, price)
        self._price = cast(Price, price)
        self._start_s = float(start_s)
        self._begin_s = self._now_s = max(self._start_s - float(warmup_s), 0.0)
        self._begin()
        if self._start_s > self._now_s:
            self._run(Block.native(len(self._names.actuators), self._start_s - self._now_s))
        return self._measured(self._now_s)

    def advance(self, u: Levels, duration_s: float) -> Measurement:
        """Apply the levels `u` in [0, 1] (None: native control) for `duration_s`.

        Raises:
            InputError: `u` or `duration_s` is out of range, or the plant was not reset.
            PlantError: what simulates it failed or took too long.
        """
        return self._advanced(check_levels(u, duration_s, names=self._names, u_min=self._u_min))

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """Return boundary conditions, with forecast errors if set; raises `InputError` as `forecast_times`."""
        return self._boundary(forecast_times(self._now_s, horizon_s, interval_s))

    def past(self, step_s: float) -> Record:
        """Return the record since the start of the warm-up, without the oldest partial step; raises `InputError`."""
        return self._past(record_times(self._begin_s, self._now_s, step_s))

    def _bought(self, time_s: Array) -> tuple[Array, Array]:
        """Price per kWh and emissions, kg/kWh, of electricity at times (n,)."""
        return self._tariffs[self._price](time_s), np.full(time_s.shape, tariffs.EMISSION_KG_PER_KWH)

    def _advanced(self, block: Block) -> Measurement:
        before_s = self._now_s
        self._run(block)
        return self._measured(before_s)

    def _check_reset(self, start_s: float, warmup_s: float, price: str) -> None:
        """Raise what `reset` raises before it changes anything."""
        check_start(start_s, warmup_s)
        if price not in PRICES:
            raise InputError(f"unknown tariff '{price}'; known: {', '.join(PRICES)}")

    def _spaced(self, duration_s: float, sample_s: float) -> Array:
        """Set the clock `duration_s` ahead; the times until then, equally spaced, as many as whole `sample_s`."""
        n = max(math.floor(duration_s / sample_s + 1e-9), 1)
        time_s = self._now_s + duration_s / n * np.arange(1.0, n + 1)
        self._now_s += duration_s
        time_s[-1] = self._now_s  # exact, without rounding
        return time_s

    @abstractmethod
    def _begin(self) -> None:
        """Put the plant at the begin of the warm-up, or before it."""

    @abstractmethod
    def _run(self, block: Block) -> None:
        """Simulate a block, and set the clock to its end."""

    @abstractmethod
    def _measured(self, before_s: float) -> Measurement:
        """The state now, with means since `before_s`; NaN where that is now."""

    @abstractmethod
    def _boundary(self, time_s: Array) -> Boundary:
        """The forecast of `time_s` (N + 1,), which begins now."""

    @abstractmethod
    def _past(self, edges: Array) -> Record:
        """The record of steps between `edges` (n + 1,), s."""


class RoomSetpointShell(PlantShell):
    """A `RoomSetpointPlant` in a shell."""

    def advance(self, u: Levels, duration_s: float, command: Commands = None) -> Measurement:
        """As `PlantShell.advance`, or with the room set-points `command`, °C."""
        return self._advanced(check_levels(u, duration_s, command, names=self._names, u_min=self._u_min))


@dataclass
class _Kept:
    """Arrays of samples with room for more, of which the first `n` are taken."""

    times: Array
    rows: Array
    n: int


class Samples:
    """Rows (n, k) at n rising times, s, in arrays that grow by doubling; copies share them until two add samples."""

    def __init__(self, time_s: float, row: Array) -> None:
        self._kept, self._n = _Kept(np.array([time_s]), row[None].copy(), 1), 1

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return copy.copy(self)

    @property
    def times(self) -> Array:
        """Times (n,), s."""
        return self._kept.times[: self._n]

    @property
    def rows(self) -> Array:
        """Rows (n, k)."""
        return self._kept.rows[: self._n]

    def append(self, time_s: Array, rows: Array) -> None:
        """Add samples."""
        begin, n = self._n, self._n + len(rows)
        if n > self._kept.times.size or begin < self._kept.n:
            size = max(2 * begin, n)
            kept = _Kept(np.empty(size), np.empty((size, rows.shape[1])), n)
            kept.times[:begin], kept.rows[:begin] = self.times, self.rows
            self._kept = kept
        self._kept.times[begin:n], self._kept.rows[begin:n] = time_s, rows
        self._kept.n = self._n = n

    def between(self, start_s: float, final_s: float) -> tuple[Array, Array]:
        """Times and rows between two times, both included."""
        first, last = np.searchsorted(self.times, [start_s - CLOCK_S, final_s + CLOCK_S])
        return self.times[first:last], self.rows[first:last]


@dataclass(frozen=True)
class Snapshot:
    """State, clock and record of a plant at one instant; opaque, for `BranchingShell.restore`."""

    values: Mapping[str, Any]


class BranchingShell(PlantShell):
    """A plant that keeps its samples, and can be put back to an instant."""

    _samples: Samples
    # KPIs so far, by tariff.
    _counted: dict[str, CountedKpis]
    # Names of what changes as time goes on.
    _changing: tuple[str, ...] = ("_now_s", "_begin_s", "_start_s", "_price", "_samples", "_counted")

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """A copy that goes on by itself. It shares building and weather: numba compiles anew for copies of arrays."""
        other = copy.copy(self)
        other.restore(self.snapshot())
        return other

    def snapshot(self) -> Snapshot:
        """Return a snapshot, to restore or branch from."""
        return Snapshot({name: copy.deepcopy(getattr(self, name)) for name in self._changing})

    def restore(self, snapshot: Snapshot) -> None:
        """Restore a snapshot of this plant, or of another one of the same building and weather."""
        vars(self).update(copy.deepcopy(dict(snapshot.values)))

    def _begin(self) -> None:
        self._samples, self._counted = Samples(self._begin_s, self._first_row()), {}

    def _kpis_so_far(self, between: Between) -> dict[str, float]:
        """KPIs since the end of the warm-up, from those of the samples `between` two times, see `CountedKpis`.

        Sums are cached: later calls read only the new samples, and those of a peak window that is not over.
        """
        counted = self._counted.get(self._price, CountedKpis(self._start_s))
        recent = self._samples.times[np.searchsorted(self._samples.times, counted.until_s) :]
        counted = counted.counting(counted.latest_edge_s(recent, self._start_s), between)
        self._counted[self._price] = counted
        return counted.up_to(self._now_s, between)

    @abstractmethod
    def _first_row(self) -> Array:
        """The sample at the begin, with the machine off; puts the state there."""
