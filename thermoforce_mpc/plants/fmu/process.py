"""Process of one run of an FMU; `worker` is the other end."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from thermoforce_mpc.plants.fmu.messages import SAMPLE_S, Job, Stretch
from thermoforce_mpc.plants.waiting import PATIENCE_S, PIECE_S, START_S
from thermoforce_mpc.plants.worker_process import WorkerProcess


class FmuProcess(WorkerProcess):
    """See `WorkerProcess`."""

    def __init__(self, job: Job, work_folder: Path, patience_s: float = PATIENCE_S) -> None:
        """Start the process; the FMU may write files in `work_folder`."""
        super().__init__("thermoforce_mpc.plants.fmu.worker", "the FMU", work_folder, patience_s)
        self._job = job

    def start(self, start_s: float) -> Stretch:
        """Load and initialise the FMU at `start_s`; raises `PlantError`."""
        self.now_s = start_s
        request, limit_s = (self._job, start_s), max(self.patience_s, START_S)
        found: Stretch = self.ask("start at", request, doing="be loaded", limit_s=limit_s)
        return found

    def advance(self, inputs: Mapping[str, float], duration_s: float) -> Stretch:
        """Set inputs by name and simulate; raises `PlantError`."""
        n = max(int(duration_s / SAMPLE_S + 1e-9), 1)
        times_s = self.now_s + np.arange(1.0, n + 1.0) * (duration_s / n)
        parts: list[Stretch] = []
        for times in np.split(times_s, range(int(PIECE_S / SAMPLE_S), n, int(PIECE_S / SAMPLE_S))):
            # Inputs are set once: an FMU may take each setting for an event.
            parts.append(self.ask("step from", ({} if parts else dict(inputs), times)))
            self.now_s = float(times[-1])
        return Stretch(times_s, np.vstack([part.rows for part in parts]), parts[-1].final)

    def advice(self, why: str) -> str:
        """See `WorkerProcess`: what to do about a system library that the loader did not find."""
        return missing_library(why)


def missing_library(error: str) -> str:
    """What to do about a system library that the loader did not find, or an empty string."""
    library = re.search(r"(\S+\.so[.\d]*): cannot open shared object file", error)
    if library is None:
        return ""
    package = "; on Debian and Ubuntu: apt-get install libgfortran5" if "libgfortran.so.5" in library[1] else ""
    return f"; the FMU was compiled with {library[1]}, which this machine lacks: install it{package}"
