"""One run of an FMU, from its start on. An FMU that fails is started again with another tolerance."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.fmu.messages import Job, Stretch
from thermoforce_mpc.plants.fmu.process import FmuProcess

_LOG = logging.getLogger(__name__)
# Tolerance that the others are relative to where the description has none: that of BOPTEST's test cases.
_TOLERANCE = 1e-6


class FmuRun:
    """Run of an FMU at the tolerance of its description, until a step fails, crashes the process or takes too long.

    A new process then repeats all stretches since the start at a tenth of the tolerance, and if one fails again at ten
    times the tolerance. Few FMUs can save their state, so this takes as long as it took until there. What was
    returned before is not taken back; the repeated course differs from it by the integration error, and the run goes
    on from there.
    """

    def __init__(self, job: Job, work_folder: Path, patience_s: float) -> None:
        """Start the process at `start`; `patience_s` as for `FmuProcess`."""
        tolerance = job.tolerance if job.tolerance and job.tolerance > 0.0 else _TOLERANCE
        self._job, self._folder, self._patience_s = job, work_folder, patience_s
        self._other = (tolerance / 10.0, tolerance * 10.0)
        self._told: list[tuple[Mapping[str, float], float]] = []
        self._start_s = 0.0
        self._process: FmuProcess | None = None
        self.restarts: tuple[str, ...] = ()
        """When, why and with which tolerance it was started again."""

    def start(self, start_s: float) -> Stretch:
        """Load and initialise the FMU at `start_s`; raises `PlantError`, and is not tried again."""
        self._start_s = start_s
        return self._begin(self._job)

    def advance(self, inputs: Mapping[str, float], duration_s: float, told: Sequence[str] = ()) -> Stretch:
        """Set inputs by name and simulate.

        Args:
            told: `restarts` after this stretch in a run that is repeated, which are not waited for again.

        Raises:
            PlantError: it failed at all tolerances.
        """
        process = self._running
        if process.closed:
            raise PlantError("the FMU was closed; reset the plant to start it again")
        self._told.append((inputs, duration_s))
        try:
            if len(told) > len(self.restarts):
                return self._again(told)
            return process.advance(inputs, duration_s)
        except PlantError as error:
            return self._restarted(error)

    def close(self) -> None:
        """End the process; safe to call twice."""
        if self._process is not None:
            self._process.close()

    @property
    def _running(self) -> FmuProcess:
        assert self._process is not None  # `start` comes first
        return self._process

    def _begin(self, job: Job) -> Stretch:
        self.close()
        self._process = FmuProcess(job, self._folder, self._patience_s)
        return self._process.start(self._start_s)

    def _restarted(self, error: PlantError) -> Stretch:
        """The latest stretch at the next tolerance at which the run comes to its end; raises the last error."""
        while len(self.restarts) < len(self._other):
            tolerance = self._other[len(self.restarts)]
            reason = str(error).splitlines()[0][:200]
            restart = f"restarted with tolerance {tolerance:g}: {reason}"
            days = sum(duration_s for _, duration_s in self._told) / DAY_S
            _LOG.warning("the FMU is %s; it repeats %.3g days", restart, days)
            try:
                return self._again((*self.restarts, restart))
            except PlantError as again:
                error = again
        raise PlantError(f"{error}\nIt had been {' and '.join(self.restarts)}") from error

    def _again(self, restarts: Sequence[str]) -> Stretch:
        """The latest stretch, in a new process that has repeated those before."""
        self.restarts = tuple(restarts)
        self._begin(replace(self._job, tolerance=self._other[min(len(restarts), len(self._other)) - 1]))
        for inputs, duration_s in self._told[:-1]:
            self._running.advance(inputs, duration_s)
        return self._running.advance(*self._told[-1])
