"""Process of one run of the engine; `worker` is the other end."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Generic

from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import InputError, PlantError
from thermoforce_mpc.plants.energyplus.live import Advance, Building, Stretch, U
from thermoforce_mpc.plants.energyplus.simulate import R
from thermoforce_mpc.plants.waiting import PATIENCE_S, PIECE_S, START_S
from thermoforce_mpc.plants.worker_process import WorkerProcess

# Length of the engine's run period, days: a year plus warm-up and forecast.
RUN_DAYS = 400


def whole_steps(what: str, duration_s: float, step_s: float) -> int:
    """Return a duration in steps of the engine; raises `InputError`, naming `what`, if it is no whole number."""
    n = round(duration_s / step_s)
    if abs(n * step_s - duration_s) > 1e-6 or bool(n) != bool(duration_s):
        raise InputError(f"{what} of {duration_s:g} s: expected a multiple of EnergyPlus' step of {step_s:g} s")
    return n


class EngineProcess(WorkerProcess, Generic[U, R]):
    """See `WorkerProcess`. `first`: reading after the engine's warm-up, at midnight of the building's first day."""

    def __init__(self, building: Building[U, R], patience_s: float = PATIENCE_S) -> None:
        """Start the process and wait for the end of the engine's warm-up; raises `PlantError`."""
        self._folder = tempfile.TemporaryDirectory(prefix="energyplus-", ignore_cleanup_errors=True)
        super().__init__("thermoforce_mpc.plants.energyplus.worker", "EnergyPlus", Path(self._folder.name), patience_s)
        self.step_s, self.now_s = building.step_s, building.first_day * DAY_S
        self._left = building.n_steps
        self.first: R = self.ask("warm-up before", building, limit_s=max(patience_s, START_S)).readings[0]

    def advance(self, demand: U | None, duration_s: float) -> Stretch[U, R]:
        """Do what is `demand` (None: the building's own control) for `duration_s`.

        Raises:
            InputError: the duration is no multiple of the engine's step.
            PlantError: the engine failed or took too long, or its run period is over.
        """
        n = whole_steps("step", duration_s, self.step_s)
        if n > self._left:
            raise PlantError(f"EnergyPlus has {self._left} of {n} steps left: its run period is over; reset the plant")
        most = max(int(PIECE_S / self.step_s), 1)
        pieces = [self._advance(demand, min(most, n - i)) for i in range(0, n, most)]
        return Stretch(
            tuple(reading for piece in pieces for reading in piece.readings),
            tuple(acted for piece in pieces for acted in piece.acted),
        )

    def _advance(self, demand: U | None, n: int) -> Stretch[U, R]:
        stretch: Stretch[U, R] = self.ask("step from", Advance(demand, n))
        self._left -= n
        self.now_s += n * self.step_s
        return stretch

    def close(self) -> None:
        """See `WorkerProcess.close`; the engine's files go too."""
        super().close()
        self._folder.cleanup()
