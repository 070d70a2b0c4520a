"""The doors between the rooms: small structural protocols. One implementation is one file, named in one registry."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from thermoforce_mpc.data import (
    Array,
    Boundary,
    FreeForecast,
    Measurement,
    Observation,
    Period,
    Plan,
    PlantInfo,
    Record,
)


@runtime_checkable
class Plant(Protocol):
    """A building that can be run: emulator, service, FMU or engine. Raises `PlantError` when it fails."""

    @property
    def info(self) -> PlantInfo:
        """Which plant, weather and version this is."""
        ...

    def period(self, name: str) -> Period:
        """The scored window called `name`: 'peak_heat_day', 'typical_heat_day', or a start day such as '44'."""
        ...

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """Start at `start_s` after `warmup_s` of native control; KPIs count from `start_s` on."""
        ...

    def advance(self, u: float | None, duration_s: float) -> Measurement:
        """Hold `u` in [0, 1] (None: native control) for `duration_s` seconds."""
        ...

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """Boundary conditions from now to `horizon_s` ahead, every `interval_s`."""
        ...

    def past(self, step_s: float) -> Record:
        """What is known since the start of the warm-up, at `step_s`; one instant where the plant keeps no record."""
        ...

    def kpis(self) -> dict[str, float]:
        """BOPTEST's KPIs since the end of the warm-up: ener_tot, cost_tot, tdis_tot, emis_tot, pele_tot, ..."""
        ...

    def close(self) -> None:
        """Release what the plant holds; safe to call twice."""
        ...


@runtime_checkable
class FreeResponse(Protocol):
    """What the zone would do without us. Never sees the control."""

    @property
    def name(self) -> str:
        """Name in the registry."""
        ...

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """Forecast the control-free temperature over the steps of `boundary`.

        `free_C` (n + 1,) is the control-free history T − F at the boundaries of `history` (NaN gaps
        allowed); of `history` only
        time and weather may be used. Returns N = `boundary.n_steps` values, at the end of each step.
        """
        ...


@runtime_checkable
class FollowingFreeResponse(FreeResponse, Protocol):
    """A free response that learns from the forecasts of a run: what it learned is a value that the run carries along.

    Its `forecast` is that of a run which begins.
    """

    def follow(self, free_C: Array, history: Record, boundary: Boundary, state: object) -> tuple[FreeForecast, object]:
        """As `forecast`, with what the last call of this run gave (None begins a run); and what to give to the next."""
        ...


@runtime_checkable
class Controller(Protocol):
    """Everything that decides an action. It holds no state of a run: that travels in the plans."""

    @property
    def name(self) -> str:
        """Name in the registry."""
        ...

    @property
    def step_s(self) -> float:
        """How long a plan is followed before the next is asked for, s."""
        ...

    @property
    def horizon_s(self) -> float:
        """How far ahead the controller wants its boundary forecast, s (at least one step)."""
        ...

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """Decide. Never raises for a failed solve: the plan's status says which fallback level acted, and why.

        `state` is the `Plan.state` of the last plan of this run, None begins a run. The same observation and state give
        the same plan.
        """
        ...
