"""One engine run that is told step by step what to do.

The engine owns the main loop, so its callback blocks until the next request.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from thermoforce_mpc.plants.energyplus.simulate import R, R_contra, Wiring

# What a building is told for a step, such as a level; None leaves it to its own control.
U = TypeVar("U")


class Acting(Protocol[U, R_contra]):
    """Turns what a building is told into values of the engine's actuators, step by step, in the worker process."""

    def __call__(self, step: int, demand: U | None, last: R_contra | None) -> tuple[dict[str, float], U]:
        """Return the actuator values of a step, as `Driver.begin` does, and what acts.

        `step` is −1 while the engine warms up; `last` is the reading before the step, None before the first.
        """
        ...


class Building(Protocol[U, R]):
    """Building that a worker process simulates; picklable. Its run begins at midnight of `first_day`.

    `first_day` counts from 1 January (0), steps last `step_s` s, the zone time step of the engine's model.
    """

    @property
    def first_day(self) -> int:
        """Day of the year, from 0."""
        ...

    @property
    def step_s(self) -> float:
        """Length of a step, s."""
        ...

    @property
    def n_steps(self) -> int:
        """Length of the run, steps."""
        ...

    def model(self) -> str:
        """Return the engine's input of `n_steps` steps or more."""
        ...

    def weather(self) -> Path:
        """Return the weather file."""
        ...

    def wiring(self) -> Wiring[R]:
        """Return the sensors and actuators of the model."""
        ...

    def acting(self) -> Acting[U, R]:
        """Return the rule of a new run."""
        ...


@dataclass(frozen=True)
class Advance(Generic[U]):
    """Request: do what is `demand` (None: the building's own control) for `steps` steps."""

    demand: U | None
    steps: int


@dataclass(frozen=True)
class Stretch(Generic[U, R]):
    """Answer: the reading at the end of each step, and what acted in each step."""

    readings: tuple[R, ...]
    acted: tuple[U, ...]


class Live(Generic[U, R]):
    """`Driver` that answers requests; the first answer is the state after the engine's warm-up."""

    def __init__(self, building: Building[U, R], receive: Callable[[], Any], send: Callable[[Any], None]) -> None:
        self._n_steps, self._act = building.n_steps, building.acting()
        self._received, self._sent = receive, send
        self._last: R | None = None
        self._request = Advance[U](None, 0)
        self._answer: list[tuple[R, U]] = []
        self._now: U | None = None
        self._step = 0

    @property
    def done(self) -> bool:
        """Whether the run period is over."""
        return self._step >= self._n_steps

    def begin(self, warming_up: bool) -> dict[str, float]:
        """Return the actuator values of the next step; wait for a request if the last is done."""
        if not self.done and not warming_up and len(self._answer) >= self._request.steps:
            self._receive()
        if self.done:
            return {}
        demand = None if warming_up else self._request.demand
        values, self._now = self._act(-1 if warming_up else self._step, demand, self._last)
        return values

    def end(self, warming_up: bool, read: Callable[[], R]) -> bool:
        """Store the reading at the end of the step; return True when the run may stop."""
        self._last = reading = read()
        if not warming_up and self._now is not None:
            self._step += 1
            self._answer.append((reading, self._now))
            if self._step >= self._n_steps:
                self._send()
        return self.done

    def _receive(self) -> None:
        if self._last is None:
            raise RuntimeError("the engine asked for an action before its warm-up")
        if self._answer:
            self._send()
        else:
            self._sent(Stretch((self._last,), ()))
        self._request = self._received()
        self._answer = []

    def _send(self) -> None:
        self._sent(Stretch(tuple(r for r, _ in self._answer), tuple(u for _, u in self._answer)))
