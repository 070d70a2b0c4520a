"""Client of `live`: starts the engine's process, sends requests, and reports its failure as `PlantError`."""

from __future__ import annotations

import multiprocessing
from typing import Generic

from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import InputError, PlantError
from thermoforce_mpc.plants.energyplus.live import Advance, Building, Stretch, U, serve
from thermoforce_mpc.plants.energyplus.simulate import R

# Length of the engine's run period, days: a year plus warm-up and forecast.
RUN_DAYS = 400
_PATIENCE_S = 5.0


def whole_steps(what: str, duration_s: float, step_s: float) -> int:
    """Return a duration in steps of the engine; raises `InputError`, naming `what`, if it is no whole number."""
    n = round(duration_s / step_s)
    if abs(n * step_s - duration_s) > 1e-6 or bool(n) != bool(duration_s):
        raise InputError(f"{what} of {duration_s:g} s: expected a multiple of EnergyPlus' step of {step_s:g} s")
    return n


class EngineProcess(Generic[U, R]):
    """Process of one run of the engine; it is never used for a second run.

    `first` is the reading after the engine's warm-up, at midnight of the building's first day.
    """

    def __init__(self, building: Building[U, R]) -> None:
        """Start the process and wait for the end of the engine's warm-up; raises `PlantError`."""
        self._building = building
        self._steps = 0
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=serve, args=(building, other), daemon=True)
        self._process.start()
        other.close()
        self._closed = False
        self.first: R = self._answer().readings[0]

    @property
    def step_s(self) -> float:
        """Length of a step, s."""
        return self._building.step_s

    @property
    def now_s(self) -> float:
        """Time of the run, s since 1 January."""
        return self._building.first_day * DAY_S + self._steps * self._building.step_s

    def advance(self, demand: U | None, duration_s: float) -> Stretch[U, R]:
        """Do what is `demand` (None: the building's own control) for `duration_s`.

        Raises:
            InputError: the duration is no multiple of the engine's step.
            PlantError: the engine failed, or its run period is over.
        """
        n = whole_steps("step", duration_s, self.step_s)
        if self._closed:
            raise PlantError("EnergyPlus was closed; reset the plant to start it again")
        try:
            self._pipe.send(Advance(demand, n))
        except OSError as error:
            raise self._failed("process is not running") from error
        stretch = self._answer()
        if len(stretch.readings) != n:
            raise self._failed(f"simulated {len(stretch.readings)} of {n} steps: its run period is over")
        self._steps += n
        return stretch

    def close(self) -> None:
        """End the process; safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._pipe.close()
        self._process.join(_PATIENCE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()

    def _answer(self) -> Stretch[U, R]:
        try:
            answer = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise self._failed("ended without an answer") from error
        if isinstance(answer, Stretch):
            return answer
        raise self._failed(f"failed: {answer}")

    def _failed(self, what: str) -> PlantError:
        """End the process, since an incomplete step cannot be continued, and return the error to raise."""
        day = self.now_s / DAY_S
        self.close()
        return PlantError(f"EnergyPlus {what} (day {day:g}); reset the plant to start it again")
