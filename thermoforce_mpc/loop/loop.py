"""The loop of a controller, written once: read, believe, forecast, plan, check, apply, record.

A driver stands for what is controlled: a simulated plant, which is its own clock (`closed_loop`), or a real building
with a clock on the wall (`thermoforce_mpc.live`). It reads, applies and records; what is decided in between, and
what is known from step to step, is here.

The steps of a run: the latest in memory, the others in a file that ends with the process.
"""

from __future__ import annotations

import math
import os
import pickle
import resource
import tempfile
import time
import traceback
import weakref
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Protocol, TypeVar, overload

from thermoforce_mpc.data import DAY_S, SINGLE, Block, Boundary, Names, Observation, Plan, Record
from thermoforce_mpc.errors import ControllerRaised, InputError, ThermoForceError, raise_if_terminated
from thermoforce_mpc.files import storage_errors
from thermoforce_mpc.loop.inputs import OUTAGE_H, Forecasts, UnitDoubts
from thermoforce_mpc.plants.shell import check_levels
from thermoforce_mpc.protocols import Controller

# Steps in memory: two days in steps of a quarter of an hour. A step takes some 50 kB; with all of two weeks the default
# run has its peak at 502 MB instead of 467, and takes no less time (2026-11-29).
_IN_MEMORY = 192
# Later protocols give each small array to Python code of NumPy when a step is read: a quarter of the time of reading.
_PICKLED = 4

_Step = TypeVar("_Step")


class KeptSteps(Sequence[_Step]):
    """Steps that are appended and read in order.

    The file has no name and is written and read by this object alone.
    """

    def __init__(self, folder: Path | None = None, in_memory: int = _IN_MEMORY) -> None:
        """`folder` is where the file is made if there are more than `in_memory`, by default the system's for temporary
        files.
        """
        self._folder, self._most = folder, in_memory
        self._recent: list[_Step] = []
        self._places: list[int] = []
        self._file: Any = None

    def append(self, step: _Step) -> None:
        """Append one; raises `StorageError` where the file cannot be written."""
        self._recent.append(step)
        if len(self._recent) > self._most:
            self._write_step(self._recent[0])
            del self._recent[0]

    def __len__(self) -> int:
        """Number of steps."""
        return len(self._places) + len(self._recent)

    @overload
    def __getitem__(self, index: int) -> _Step: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[_Step, ...]: ...

    def __getitem__(self, index: int | slice) -> _Step | tuple[_Step, ...]:
        """One step, or those of a slice."""
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        at = range(len(self))[index]
        away = len(self._places)
        return self._recent[at - away] if at >= away else self._read_step(self._places[at])

    def __iter__(self) -> Iterator[_Step]:
        """All steps in order; those in the file are read one by one."""
        for place in self._places:
            yield self._read_step(place)
        yield from islice(self._recent, len(self._recent))

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process all of them go in memory."""
        return KeptSteps, (None, len(self)), None, iter(self)

    def _write_step(self, step: _Step) -> None:
        with storage_errors((self._folder or Path(tempfile.gettempdir())) / "steps of this run"):
            if self._file is None:
                self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 (closed with this object)
                weakref.finalize(self, _closed, self._file)
            place = self._file.seek(0, 2)
            self._file.write(pickle.dumps(step, protocol=_PICKLED))
            self._file.flush()
        self._places.append(place)

    def _read_step(self, place: int) -> _Step:
        self._file.seek(place)
        step: _Step = pickle.load(self._file)
        return step


def _closed(file: Any) -> None:
    with suppress(OSError):  # what a full disk did not take is lost with the run
        file.close()


CLOCK_TOLERANCE_S = 1e-6
"""Tolerance on times, s: shorter remainders are rounding errors of the clock."""
# With less memory than this no step is begun, MB: LLVM, which compiles in a first step, aborts the process where it
# gets none, and solvers hang where a thread cannot be started.
_LEAST_MB = 96.0


@dataclass(frozen=True)
class Believed:
    """What a step begins with.

    Attributes:
        history: the record as it is believed, implausible readings NaN.
        as_read: the record in which wrong units are looked for.
        notes: readings that were missing or rejected.
        left_s: time until the loop ends, s.
        u_min: lowest level of each actuator (A,), or of all.
        tank: temperature of a tank of hot water, °C, NaN where it is not known, and whether it is charged.
    """

    history: Record
    as_read: Record
    notes: tuple[str, ...]
    left_s: float
    u_min: float | Sequence[float]
    tank: tuple[float, bool] = (math.nan, False)


@dataclass(frozen=True)
class Decided:
    """What was decided in a step, before it acts.

    Attributes:
        index: number of the step.
        observation: what the plan was made on; None where nothing could be read.
        boundary: its forecast with holes filled.
        plan: the plan, without the controller's state.
        blocks: what is to be applied, checked.
        refused: why the plan was refused, '' where it was not.
        notes: of the readings, units and forecast.
        before, after: the controller's state; after a plan that was refused, see `not_followed`.
        forecast_seconds, plan_seconds: computing times, s.
    """

    index: int
    observation: Observation | None
    boundary: Boundary | None
    plan: Plan
    blocks: tuple[Block, ...]
    refused: str = ""
    notes: tuple[str, ...] = ()
    before: object = None
    after: object = None
    forecast_seconds: float = 0.0
    plan_seconds: float = 0.0


def not_followed(before: object, after: object) -> object:
    """The controller's state after a plan that did not act.

    It keeps what was learned of readings alone where its class can tell that apart, by a method of this name; else it
    is as `before`.
    """
    apart = getattr(after, "not_followed", None)
    return before if apart is None else apart()


class LoopDriver(Protocol):
    """What is controlled in a loop."""

    begun_anew: bool
    """Whether what was known is of times that come again: the controller then begins anew, too."""

    def begin(self) -> object:
        """Start, or take up what goes on; returns the controller's state to begin with."""

    def next_step(self) -> bool:
        """Return when the next step begins; False ends the loop."""

    def read(self) -> Believed:
        """What is known now."""

    def unfit(self, blocks: Sequence[Block]) -> str:
        """Why checked blocks are none for what is controlled, in words; empty where they may be applied."""

    def units(self) -> UnitDoubts | None:
        """What looks for wrong units, asked for once after the first reading."""

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`."""

    def instead(self, index: int, error: Exception, state: object) -> Decided | None:
        """What acts in the place of a decision that failed; raises `error` where that ends the loop.

        None: it is decided once more, by a controller that begins anew, since what it went on from may be wrong; not
        where `state` is None.
        """

    def act(self, decided: Decided) -> object:
        """Apply and record a decision; returns the controller's state to go on from."""

    def end(self) -> None:
        """Release what was taken; called however the loop ends, once it began."""


class Loop:
    """A controller on a driver; `outage_h`: how long the last forecast may stand in where there is none, h."""

    def __init__(self, driver: LoopDriver, controller: Controller, outage_h: float = OUTAGE_H) -> None:
        self._driver, self._controller = driver, controller
        self._new_forecasts = partial(Forecasts, driver, controller.horizon_s, controller.step_s, outage_h)
        self._forecasts = self._new_forecasts()
        self._units: UnitDoubts | None = None

    def run(self) -> object:
        """Step until the driver or a plan ends it; returns the controller's last state. Raises as the driver does."""
        driver, index = self._driver, 0
        state = driver.begin()
        try:
            while driver.next_step():
                raise_if_terminated()
                if driver.begun_anew:
                    state, self._forecasts = None, self._new_forecasts()
                try:
                    decided = self._decide(index, driver.read(), state)
                except Exception as error:
                    decided = driver.instead(index, error, state) or self._anew(index, state)
                if decided.plan.ends:
                    state = decided.after
                    break
                state = driver.act(decided)
                index += 1
                raise_if_terminated()
        finally:
            driver.end()
        return state

    def _anew(self, index: int, state: object) -> Decided:
        """The decision of a controller that begins anew; where that fails too, it was not the state."""
        driver = self._driver
        try:
            return self._decide(index, driver.read(), None)
        except Exception as error:
            if (instead := driver.instead(index, error, None)) is None:
                raise
            return replace(instead, before=state, after=state)

    def _decide(self, index: int, believed: Believed, state: object) -> Decided:
        """Forecast, plan and check."""
        check_memory()
        controller, history = self._controller, believed.history
        if index == 0:
            self._units = self._driver.units()
        t0 = time.perf_counter()
        forecast, boundary, gaps = self._forecasts.now(history)
        doubts = self._units.now(believed.as_read, boundary) if self._units else ()
        t1 = time.perf_counter()
        # The controller fills holes of the forecast itself, and says so.
        observation = Observation(history, forecast, *believed.tank)
        plan = _planned(controller, observation, state, index)
        t2 = time.perf_counter()
        # Records do not hold the controller's state, which grows with the run; only the latest is kept.
        plan, after = replace(plan, state=None), plan.state
        if plan.ends:
            return Decided(index, observation, boundary, plan, (), before=state, after=after)
        blocks, refused = checked_blocks(plan, controller.step_s, believed.left_s, believed.u_min, history.names)
        if not refused and (unfit := self._driver.unfit(blocks)):
            refused = f"refused {unfit}: native control instead"
            blocks = (Block.native(len(history.names.actuators), min(controller.step_s, believed.left_s)),)
        return Decided(
            index,
            observation,
            boundary,
            plan,
            blocks,
            refused,
            (*believed.notes, *doubts, *gaps),
            before=state,
            after=not_followed(state, after) if refused else after,
            forecast_seconds=round(t1 - t0, 6),
            plan_seconds=round(t2 - t1, 6),
        )


def checked_blocks(
    plan: Plan, step_s: float, remaining_s: float, u_min: float | Sequence[float] = 0.0, names: Names = SINGLE
) -> tuple[tuple[Block, ...], str]:
    """The blocks of `plan` cut to the window and "", or one step of native control and the reason for the refusal.

    Last check before the plant: there must be one level for each actuator of `names`, None or finite and in
    [`u_min`, 1] (`u_min` of all or of each), room set-points finite and in order; a duration must be finite and
    positive; the durations must sum to `step_s`. What is wrong with one actuator refuses the plan for all.
    """
    native = (Block.native(len(names.actuators), min(step_s, remaining_s)),)
    if not plan.blocks:
        return native, "the plan had no action: native control instead"
    if wrong := wrong_blocks(plan.blocks, step_s, u_min, names):
        return native, f"refused {wrong}: native control instead"
    cut: list[Block] = []
    left_s = remaining_s
    for block in plan.blocks:
        if left_s <= CLOCK_TOLERANCE_S:
            break
        cut.append(replace(block, duration_s=min(block.duration_s, left_s)))
        left_s -= block.duration_s
    return tuple(cut), ""


def wrong_blocks(blocks: Sequence[Block], duration_s: float, u_min: float | Sequence[float], names: Names) -> str:
    """What is wrong with blocks for `duration_s`, in words; empty where they may be applied."""
    try:
        for block in blocks:
            check_levels(block.u, block.duration_s, block.command, names=names, u_min=u_min)
    except InputError as error:
        return str(error)
    total_s = math.fsum(block.duration_s for block in blocks)
    if abs(total_s - duration_s) > CLOCK_TOLERANCE_S:
        return f"blocks of {total_s:g} s in all for a step of {duration_s:g} s"
    return ""


def _planned(controller: Controller, observation: Observation, state: object, index: int) -> Plan:
    """The controller's plan; raises `ControllerRaised` for whatever else it does."""
    at = f"{controller.name} in step {index}, day {observation.time_s / DAY_S:.3f}"
    try:
        plan = controller.plan(observation, state)
    except ThermoForceError:  # has its own exit code, and says what to do
        raise
    except Exception as error:
        last = "".join(traceback.format_tb(error.__traceback__)[1:][-3:]).rstrip()
        raise ControllerRaised(f"{at} raised {type(error).__name__}: {error}\n{last}") from error
    if not isinstance(plan, Plan):
        raise ControllerRaised(f"{at} returned a {type(plan).__name__}, not a Plan (docs/how-to/controller.md)")
    return plan


def check_memory() -> None:
    """Raise `MemoryError` where little memory is left, of the machine or of this process's limit; says how much."""
    left_MB = {}
    with suppress(OSError, ValueError, IndexError):  # where there is no /proc nothing is known
        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            left_MB["of this process's limit (ulimit -v)"] = (limit - used) / 1e6
        file = os.open("/proc/meminfo", os.O_RDONLY)
        try:
            available = os.read(file, 4096).partition(b"MemAvailable:")[2].split()[0]  # the whole table
        finally:
            os.close(file)
        left_MB["of the machine"] = int(available) * 1024 / 1e6
    for what, left in left_MB.items():
        if left < _LEAST_MB:
            there = f"{max(left, 0.0):.0f} MB of memory {what} are left"
            raise MemoryError(f"{there}, fewer than the {_LEAST_MB:g} that a step is begun with")
