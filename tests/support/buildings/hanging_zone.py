"""A zone on EnergyPlus whose callback never returns: in the engine's warm-up, or from a step on."""

from __future__ import annotations

import os
import time
from pathlib import Path

from thermoforce_mpc.plants.energyplus import zone
from thermoforce_mpc.plants.energyplus.zone import EnergyPlusPlant, ZoneActing
from thermoforce_mpc.plants.testcases import load_testcase


class Hanging(ZoneActing):
    """`hangs_at`: number of the step from midnight; -1 is the warm-up. `mark`: file to write when it hangs."""

    def __init__(self, job, hangs_at=-1, mark=None):
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
    zone.ZoneActing = lambda job: Hanging(job, mark=mark)
    EnergyPlusPlant(load_testcase("energyplus:heating_chicago")).reset(0.0, 0.0)
