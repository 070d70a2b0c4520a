"""Worker process of the EnergyPlus plant: one engine run whose actuator level is set step by step over a pipe.

The engine owns the main loop, so its callback blocks until the next request. A process runs one simulation and ends
with it, or when the other end closes the pipe.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection

from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.plants.energyplus.engine import weather_file
from thermoforce_mpc.plants.energyplus.simulate import Job, PiPolicy, Reading, run_engine
from thermoforce_mpc.plants.energyplus.zone import GAINS, HVAC, zone_model


@dataclass(frozen=True)
class Advance:
    """Request: apply `u` in [0, 1] (None: the thermostat's PI loop) for `steps` steps."""

    u: float | None
    steps: int


@dataclass(frozen=True)
class Stretch:
    """Answer: the reading at the end of each step, and the actuator level of each step."""

    readings: tuple[Reading, ...]
    u: tuple[float, ...]


class Live:
    """`Driver` that answers requests from a pipe; the first answer is the state after the engine's warm-up."""

    def __init__(self, job: Job, pipe: Connection) -> None:
        self._job, self._pipe = job, pipe
        self._policy = PiPolicy(job)
        self._sign = 1.0 if job.spec.mode == "heating" else -1.0
        self._last: Reading | None = None
        self._request = Advance(None, 0)
        self._answer: list[tuple[Reading, float]] = []
        self._step = 0
        self._acting = 0.0
        self._closed = False

    @property
    def done(self) -> bool:
        """Whether the other end closed the pipe, or the run period is over."""
        return self._closed or self._step >= self._job.n_steps

    def begin(self, warming_up: bool) -> dict[str, float]:
        """Return the heat of each actuated source over the next step, W; wait for a request if the last is done."""
        if self.done:
            return {HVAC: 0.0, GAINS: 0.0}
        if not warming_up and len(self._answer) >= self._request.steps:
            self._receive()
        step = -1 if warming_up else self._step
        T = self._last.T_zone_C if self._last else float(self._job.setpoint_C[0])
        native = self._policy(step, T)
        told = None if warming_up else self._request.u
        self._acting = native if told is None else told
        spec = self._job.spec
        gains = float(self._job.gains[max(step, 0)])
        return {HVAC: self._sign * self._acting * spec.capacity_W, GAINS: gains * spec.gains_W}

    def end(self, warming_up: bool, read: Callable[[], Reading]) -> bool:
        """Store the reading at the end of the step; return True when the run may stop."""
        self._last = reading = read()
        if not warming_up and not self._closed:
            self._step += 1
            self._answer.append((reading, self._acting))
            if self._step >= self._job.n_steps:
                self._send()
        return self.done

    def _receive(self) -> None:
        if self._last is None:
            raise RuntimeError("the engine asked for an action before its warm-up")
        if self._answer:
            self._send()
        else:
            self._pipe.send(Stretch((self._last,), (math.nan,)))
        try:
            self._request = self._pipe.recv()
        except EOFError:
            self._closed = True
        self._answer = []

    def _send(self) -> None:
        self._pipe.send(Stretch(tuple(r for r, _ in self._answer), tuple(u for _, u in self._answer)))


def serve(job: Job, pipe: Connection) -> None:
    """Run the simulation of `job` in this process, answering over `pipe`; errors are sent as text."""
    days = math.ceil(job.n_steps * job.spec.step_s / DAY_S)
    try:
        model = json.dumps(zone_model(job.spec, job.first_day, days))
        run_engine(model, weather_file(job.spec.weather), Live(job, pipe))
    except (BrokenPipeError, KeyboardInterrupt):
        return
    except Exception as error:  # any error is reported by the other end
        try:
            pipe.send(f"{type(error).__name__}: {error}")
        except OSError:
            return
    finally:
        pipe.close()
