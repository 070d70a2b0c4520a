"""What simulated plants share: the checks of what they are asked, the clock, the samples so far, and giving back.

A plant of its own physics extends `PlantShell`; one that is reached otherwise needs only the `Plant` protocol.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, Self, TypeVar, cast

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.data import SINGLE, Array, Block, Boundary, Commands, Levels, Measurement, Names, Record
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.checks import check_levels, check_start, forecast_times, record_times
from thermoforce_mpc.plants.kpis import Between, CountedKpis
from thermoforce_mpc.scenario.building import PRICES, Price

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
