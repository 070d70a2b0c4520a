"""A zone on EnergyPlus whose callback never returns: in the engine's warm-up, or from a step on."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

from thermoforce_mpc.plants.energyplus import plant
from thermoforce_mpc.plants.energyplus.plant import EnergyPlusPlant, LiveZone, ZoneActing
from thermoforce_mpc.plants.testcases import load_testcase


@dataclass(frozen=True)
class HangingZone(LiveZone):
    """`hangs_at`: number of the step from midnight; -1 is the warm-up. `mark`: file to write when it hangs."""

    hangs_at: int = -1
    mark: str | None = None

    def acting(self):
        return _Hanging(self.job, self.hangs_at, self.mark)


class _Hanging(ZoneActing):
    def __init__(self, job, hangs_at, mark):
        super().__init__(job)
        self._hangs_at, self._mark = hangs_at, mark

    def __call__(self, step, demand, last):
        if step >= self._hangs_at:
            if self._mark:
                Path(self._mark).write_text(str(os.getpid()))
            time.sleep(3600.0)
        return super().__call__(step, demand, last)


def hang(mark: str) -> None:
    """Start an engine that hangs, in this process; it writes its process number to the file `mark`."""
    plant.LiveZone = lambda job: HangingZone(job, mark=mark)
    EnergyPlusPlant(load_testcase("energyplus:heating_chicago")).reset(0.0, 0.0)
