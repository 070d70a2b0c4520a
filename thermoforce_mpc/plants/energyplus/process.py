"""Client of `live`: starts the engine's process, sends requests, and reports its failure as `PlantError`."""

from __future__ import annotations

import multiprocessing
from typing import Generic

from boptest_client import safe_text
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import InputError, PlantError
from thermoforce_mpc.plants.energyplus.live import Advance, Building, Stretch, U, serve
from thermoforce_mpc.plants.energyplus.simulate import R
from thermoforce_mpc.plants.waiting import PATIENCE_S, PIECE_S, START_S, wait_for

# Length of the engine's run period, days: a year plus warm-up and forecast.
RUN_DAYS = 400
_END_S = 5.0


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

    def __init__(self, building: Building[U, R], patience_s: float = PATIENCE_S) -> None:
        """Start the process and wait for the end of the engine's warm-up; raises `PlantError`.

        `patience_s`: longest time for a quarter of an hour of the building's time, and for its start (or 60 s), s.
        """
        self._building, self._patience_s = building, patience_s
        self._steps = 0
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=serve, args=(other,), daemon=True)
        self._process.start()
        other.close()
        self._closed = False
        # The building is large: as an argument of the process it would be written without a limit.
        self.first: R = self._asked("warm-up before", max(patience_s, START_S), building).readings[0]

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
            PlantError: the engine failed or took too long, or its run period is over.
        """
        n = whole_steps("step", duration_s, self.step_s)
        if self._closed:
            raise PlantError("EnergyPlus was closed; reset the plant to start it again")
        if self._steps + n > self._building.n_steps:
            raise self._failed(f"has {self._building.n_steps - self._steps} of {n} steps left: its run period is over")
        most = max(int(PIECE_S / self.step_s), 1)
        pieces = [self._advance(demand, min(most, n - i)) for i in range(0, n, most)]
        return Stretch(
            tuple(reading for piece in pieces for reading in piece.readings),
            tuple(acted for piece in pieces for acted in piece.acted),
        )

    def _advance(self, demand: U | None, n: int) -> Stretch[U, R]:
        stretch = self._asked("step from", self._patience_s, Advance(demand, n))
        self._steps += n
        return stretch

    def close(self) -> None:
        """End the process; safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._pipe.close()
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()

    def _asked(self, phase: str, limit_s: float, request: Advance[U] | Building[U, R]) -> Stretch[U, R]:
        """The answer to `request`; without one the process is closed."""
        what = f"EnergyPlus' {phase} day {self.now_s / DAY_S:g}"
        try:
            answer = wait_for(lambda: self._exchanged(request), self._process.kill, what, limit_s)
        except (EOFError, OSError) as error:
            raise self._failed("ended without an answer") from error
        except BaseException:
            self.close()
            raise
        if isinstance(answer, Stretch):
            return answer
        raise self._failed(f"failed: {safe_text(answer)}")

    def _exchanged(self, request: object) -> object:
        self._pipe.send(request)
        return self._pipe.recv()

    def _failed(self, what: str) -> PlantError:
        """End the process, since an incomplete step cannot be continued, and return the error to raise."""
        day = self.now_s / DAY_S
        self.close()
        return PlantError(f"EnergyPlus {what} (day {day:g}); reset the plant to start it again")
