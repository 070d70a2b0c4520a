"""Structural protocols between packages: `Plant`, `FreeResponse` and its kinds, `Controller`, `Connection` and
`Provider`.

Each free response, controller and connection is one file, listed in one registry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard, runtime_checkable

from thermoforce_mpc.data import (
    Array,
    Boundary,
    Commands,
    FreeForecast,
    Levels,
    Measurement,
    Observation,
    Period,
    Plan,
    PlantInfo,
    Record,
)
from thermoforce_mpc.execution.cooperative import Computation

if TYPE_CHECKING:
    from datetime import datetime
    from pathlib import Path

    import pandas as pd


@runtime_checkable
class Plant(Protocol):
    """Simulated building: embedded emulator, BOPTEST service, FMU or EnergyPlus. Raises `PlantError` on failure."""

    @property
    def info(self) -> PlantInfo:
        """Plant kind, test case, weather and version."""

    def period(self, name: str) -> Period:
        """Return the scored window `name`: 'peak_heat_day', 'typical_heat_day', or a start day such as '44'."""

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """Start at `start_s` (s since 1 January) after `warmup_s` s of native control; KPIs count from `start_s`."""

    def advance(self, u: Levels, duration_s: float) -> Measurement:
        """Apply the levels `u` (A,) in [0, 1] (None: native control) for `duration_s` s; a number for one actuator."""

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """Return boundary conditions from now to `horizon_s` ahead, every `interval_s` s.

        What is not known is NaN, or left out at the end. Raises `NoForecast` where there is none, though the plant can
        be advanced: a run goes on without for a while.
        """

    def past(self, step_s: float) -> Record:
        """Return the record since the start of the warm-up at `step_s` s; one instant if the plant keeps no record."""

    def kpis(self) -> dict[str, float]:
        """Return BOPTEST's KPIs since the end of the warm-up: ener_tot, cost_tot, tdis_tot, emis_tot, pele_tot, ..."""

    def close(self) -> None:
        """Release processes, files and connections; safe to call twice."""


@runtime_checkable
class RoomSetpointPlant(Plant, Protocol):
    """Plant whose own loops keep a heating and a cooling set-point of the room."""

    def advance(self, u: Levels, duration_s: float, command: Commands = None) -> Measurement:
        """Let the loops keep `command` (A,), heating and cooling set-point of each actuator, °C, for `duration_s` s.

        `u` (A,) are the levels that are planned, below 0 for cooling; their sign says which loop may act, 0 both.
        """


@runtime_checkable
class TankPlant(Plant, Protocol):
    """Plant one of whose machines heats a tank of hot water, too."""

    def tank_now(self) -> tuple[float, bool]:
        """Temperature of the tank, °C, NaN where it is not known, and whether it is charged."""

    def set_tank(self, command: float | None) -> None:
        """What is set at the tank from now on, in the unit of its command; None leaves it to the device."""


@runtime_checkable
class OutlivingPlant(Plant, Protocol):
    """Plant that goes on existing where the process that runs it dies: a service."""

    def go_on(
        self,
        last: Measurement,
        *,
        start_s: float,
        warmup_s: float,
        price: str,
        periods: Mapping[str, Period],
        anywhere: bool = False,
    ) -> None:
        """Take the plant up after `last`, the last measurement that was received since the reset of these arguments.

        `periods` are the windows that were asked for by name. The next `advance` gives the answer of a step that was
        simulated and whose answer was lost. Raises `PlantError` where the plant stands elsewhere; `anywhere`: it may
        stand at any time after, and the next `advance` gives the readings there.
        """

    def leave(self) -> None:
        """Release connections only, so that the plant can be taken up again; `close` does nothing after it."""


@runtime_checkable
class RestartingPlant(Plant, Protocol):
    """Simulated plant that starts its simulation again, in another way, where it fails: an FMU.

    What was returned before stays; the plant goes on from the repeated course, which differs a little.
    """

    @property
    def restarts(self) -> tuple[str, ...]:
        """When and how it was started again since the reset, in words."""

    def restart_as(self, restarts: Sequence[str]) -> None:
        """Be started again in the next reset or advance, so that `restarts` are these: a run that is repeated."""


@runtime_checkable
class FreeResponse(Protocol):
    """Forecaster of the free response, a zone's temperature without control action. It never receives the control."""

    @property
    def name(self) -> str:
        """Name in the registry."""

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """Forecast the free response of one zone over the steps of `boundary`.

        `free_C` (n + 1,), °C, is the past free response T − F at the times of `history` (NaN gaps allowed). Only time
        and weather of `history` may be used. Returns N = `boundary.n_steps` values, one at the end of each step.
        """


@runtime_checkable
class FollowingFreeResponse(FreeResponse, Protocol):
    """Free response that learns from its own forecasts during a run; the run carries the learned state.

    `forecast` gives the forecast at the start of a run.
    """

    def follow(self, free_C: Array, history: Record, boundary: Boundary, state: object) -> tuple[FreeForecast, object]:
        """Forecast as `forecast` does, given the state of the last call (None: start of a run); also return the new."""


@runtime_checkable
class ComputedFreeResponse(FreeResponse, Protocol):
    """Free response that asks for its work, so that many forecasts share one pass (`thermoforce_mpc.execution`)."""

    def following(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> Computation[tuple[FreeForecast, object]]:
        """Forecast as `FollowingFreeResponse.follow` does, as a computation."""


@runtime_checkable
class Controller(Protocol):
    """Controller: decides the actuators' levels. It holds no state of a run; `Plan.state` carries it."""

    @property
    def name(self) -> str:
        """Name in the registry."""

    @property
    def step_s(self) -> float:
        """Control step, s: time between two calls of `plan`."""

    @property
    def horizon_s(self) -> float:
        """Length of the boundary forecast the controller needs, s (at least one step)."""

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """Return the plan for an observation.

        A failed solve does not raise: the plan's status gives the fallback level used and the reason. `state` is the
        `Plan.state` of the last plan of this run, None at its start. Same observation and state, same plan.
        """


@runtime_checkable
class Connection(Protocol):
    """A real building, as `tf-mpc control` sees it; any exception means that it cannot be reached at present.

    It may also say what it sets, `sets() -> Path | str | tuple[str, ...]`, such as the file, or host and topic of each:
    no two controllers set one of them at a time. Without that, those with the same options are taken to set the same.
    One that must ask for each column has `reads(columns)`, which gets those of the map before the first call. Where
    people set everything by hand, one that gives things back by itself is told with `leave()` that nothing is held.
    `present(names)` says what devices hold now of what `write` sets, by name and in its unit, without those that do not
    say it: what is neither that nor what was before, somebody set by hand. `put_back(held)` sets again, without end,
    what devices held by `present` before a trial. `time_zone()` is the home's, such as Europe/Brussels, '' for none: a
    map by another clock is doubted.
    """

    def measurements(self) -> pd.DataFrame | str | Path:
        """What was measured lately, a row per time, up to now or nearly so: a day at least, better four weeks.

        A table or the file with it; columns, units and clock are those of the building's map (docs/reference/map.md).
        Where a data frame's `attrs["units"]` names the unit of a column, that one counts, or is refused.
        """

    def forecast(self) -> pd.DataFrame | str | Path:
        """Weather, and prices and bounds where the map has them as columns, from now or before, a day or two ahead."""

    def write(self, levels: Mapping[str, float | None], seconds: float) -> None:
        """Set the level of each actuator, in [0, 1], by its name in the map; None gives it back to its own control.

        Of an actuator with a command in the map it is the command: temperatures in °C, whatever the map's `unit` is for
        what is read and shown, an offset in K.
        `seconds`: how long this holds. Where nothing else was written by then, the building should take over itself.
        """

    def close(self) -> None:
        """Release what was opened; safe to call twice. The actuators were given back before."""


@dataclass(frozen=True)
class Answer:
    """What a provider knows: `table`, a row per instant (index in UTC), until when it is `fresh`, if it says that.

    A price holds for `holds_s` s from its row on; weather is that of the instant. `unchanged`: as asked before.
    """

    table: pd.DataFrame
    holds_s: float = 0.0
    fresh: datetime | None = None
    state: Mapping[str, str] = field(default_factory=dict)
    unchanged: bool = False


class Provider(Protocol):
    """Weather, or prices, of the next days from a service; any exception means that it gave none at present.

    It is asked no more than once in 5 min, and what it answered is kept, with its age, for when it does not.
    """

    def answer(self, now: pd.Timestamp, state: dict[str, str]) -> Answer:
        """What is known at `now`, from then or before; `state`: that of its last answer, such as Last-Modified."""


def outlives(plant: Plant) -> TypeGuard[OutlivingPlant]:
    """Whether `plant` is an `OutlivingPlant`, also one that hands on what it is asked for (`__getattr__`)."""
    return hasattr(plant, "go_on") and hasattr(plant, "leave")


def has_tank(plant: Plant) -> TypeGuard[TankPlant]:
    """Whether `plant` is a `TankPlant`, also one that hands on what it is asked for (`__getattr__`)."""
    return hasattr(plant, "tank_now") and hasattr(plant, "set_tank")


def can_restart(plant: Plant) -> TypeGuard[RestartingPlant]:
    """Whether `plant` is a `RestartingPlant`, also one that hands on what it is asked for (`__getattr__`)."""
    return hasattr(plant, "restarts") and hasattr(plant, "restart_as")


class StandsFor:
    """What stands in the place of `inside`: it has what that has, but for the names that its class defines.

    Each is of a class of its own: since Python 3.12 `isinstance` of a protocol does not ask `__getattr__`.
    """

    def __new__(cls, inside: object = None, *_: object) -> StandsFor:
        """One of a class that names what `inside` has (None: that is being copied)."""
        others = {name: _OfInside(name) for name in dir(inside) if not (name.startswith("_") or hasattr(cls, name))}
        return super().__new__(type(cls.__name__, (cls,), others))

    def __init__(self, inside: Any) -> None:
        self._inside = inside

    def __getattr__(self, name: str) -> Any:
        if name == "_inside":  # not made yet: while it is copied
            raise AttributeError(name)
        return getattr(self._inside, name)


class _OfInside:
    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, owner: StandsFor | None, kind: type | None = None) -> Any:
        return self if owner is None else getattr(owner._inside, self._name)
