"""A zone on EnergyPlus whose callback never returns: in the engine's warm-up, or from a step on."""

from __future__ import annotations

import time
from dataclasses import dataclass

from thermoforce_mpc.plants.energyplus.plant import LiveZone, ZoneActing


@dataclass(frozen=True)
class HangingZone(LiveZone):
    """`hangs_at`: number of the step from midnight; -1 is the warm-up."""

    hangs_at: int = -1

    def acting(self):
        return _Hanging(self.job, self.hangs_at)


class _Hanging(ZoneActing):
    def __init__(self, job, hangs_at):
        super().__init__(job)
        self._hangs_at = hangs_at

    def __call__(self, step, demand, last):
        if step >= self._hangs_at:
            time.sleep(3600.0)
        return super().__call__(step, demand, last)
