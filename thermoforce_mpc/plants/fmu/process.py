"""One run of an FMU: its process, what both ends of it say, and a new start where it fails."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from thermoforce_mpc.data import DAY_S, Array
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.worker_process import PATIENCE_S, PIECE_S, START_S, Failed, WorkerProcess, channel

# BOPTEST's sampling interval, s.
SAMPLE_S = 30.0


@dataclass(frozen=True)
class FmuJob:
    """FMU to load and outputs to record. `inputs` and `outputs` are (value reference, FMI type) by name."""

    folder: str
    guid: str
    model_identifier: str
    tolerance: float | None
    inputs: Mapping[str, tuple[int, str]]
    outputs: Mapping[str, tuple[int, str]]
    recorded: tuple[str, ...]


@dataclass(frozen=True)
class FmuStretch:
    """Result of one advance: times (n,) s, recorded outputs (n, columns), and all outputs at its end."""

    time_s: Array
    rows: Array
    final: Mapping[str, float]


class _Slave:
    """FMU instance whose signals are addressed by name."""

    def __init__(self, job: FmuJob, start_s: float) -> None:
        from fmpy.fmi2 import FMU2Slave

        self._job = job
        self._fmu = FMU2Slave(guid=job.guid, modelIdentifier=job.model_identifier, unzipDirectory=job.folder)
        self._fmu.instantiate()
        self._fmu.setupExperiment(tolerance=job.tolerance, startTime=start_s)
        self._fmu.enterInitializationMode()
        self._fmu.exitInitializationMode()
        self._now_s = start_s
        self._recorded = [job.outputs[name] for name in job.recorded]

    def start(self) -> FmuStretch:
        return FmuStretch(np.array([self._now_s]), np.array([self._read(self._recorded)]), self._final())

    def advance(self, inputs: Mapping[str, float], time_s: Array) -> FmuStretch:
        """Set `inputs`, and simulate from one of the times to the next."""
        for name, value in inputs.items():
            self._write(*self._job.inputs[name], value)
        rows = np.empty((len(time_s), len(self._recorded)))
        for i, reached_s in enumerate(time_s):
            self._fmu.doStep(self._now_s, float(reached_s) - self._now_s)
            self._now_s = float(reached_s)
            rows[i] = self._read(self._recorded)
        return FmuStretch(time_s, rows, self._final())

    def _final(self) -> dict[str, float]:
        outputs = self._job.outputs
        return dict(zip(outputs, self._read(list(outputs.values())), strict=True))

    def _read(self, signals: Sequence[tuple[int, str]]) -> list[float]:
        """Return values in the order of `signals`, with one FMI call per type."""
        values = [0.0] * len(signals)
        for kind in ("Real", "Integer", "Boolean"):
            places = [i for i, signal in enumerate(signals) if signal[1] == kind]
            if places:
                read = getattr(self._fmu, f"get{kind}")([signals[i][0] for i in places])
                for place, value in zip(places, read, strict=True):
                    values[place] = float(value)
        return values

    def _write(self, reference: int, kind: str, value: float) -> None:
        if kind == "Real":
            self._fmu.setReal([reference], [value])
        elif kind == "Boolean":
            self._fmu.setBoolean([reference], [bool(value)])
        else:
            self._fmu.setInteger([reference], [round(value)])


def main() -> None:
    """Answer requests: a job and its start, then inputs and times."""
    receive, send = channel()
    slave: _Slave | None = None
    while True:
        request = receive()
        try:
            if slave is None:
                slave = _Slave(*request)
                send(slave.start())
            else:
                send(slave.advance(*request))
        except Exception as error:  # any error of the FMU or FMPy is reported by the client
            send(Failed(error))


class FmuProcess(WorkerProcess):
    """See `WorkerProcess`."""

    def __init__(self, job: FmuJob, work_folder: Path, patience_s: float = PATIENCE_S) -> None:
        """Start the process; the FMU may write files in `work_folder`."""
        super().__init__(__name__, "the FMU", work_folder, patience_s)
        self._job = job

    def start(self, start_s: float) -> FmuStretch:
        """Load and initialise the FMU at `start_s`; raises `PlantError`."""
        self.now_s = start_s
        request, limit_s = (self._job, start_s), max(self.patience_s, START_S)
        found: FmuStretch = self.ask("start at", request, doing="be loaded", limit_s=limit_s)
        return found

    def advance(self, inputs: Mapping[str, float], duration_s: float) -> FmuStretch:
        """Set inputs by name and simulate; raises `PlantError`."""
        n = max(int(duration_s / SAMPLE_S + 1e-9), 1)
        times_s = self.now_s + np.arange(1.0, n + 1.0) * (duration_s / n)
        parts: list[FmuStretch] = []
        for times in np.split(times_s, range(int(PIECE_S / SAMPLE_S), n, int(PIECE_S / SAMPLE_S))):
            # Inputs are set once: an FMU may take each setting for an event.
            parts.append(self.ask("step from", ({} if parts else dict(inputs), times)))
            self.now_s = float(times[-1])
        return FmuStretch(times_s, np.vstack([part.rows for part in parts]), parts[-1].final)

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


_LOG = logging.getLogger(__name__)
# Tolerance that the others are relative to where the description has none: that of BOPTEST's test cases.
_TOLERANCE = 1e-6
# After these tolerances the same inputs would hang again: they come so much later, s, which no building notices.
_LATER_S = (60.0, 120.0)


class FmuRun:
    """Run of an FMU at the tolerance of its description, until a step fails, crashes the process or takes too long.

    A new process then repeats all stretches since the start at a tenth of the tolerance, and if one fails again at ten
    times the tolerance; then with the inputs of the stretch that failed a minute later, and two, those of the stretch
    before going on until then. Few FMUs can save their state, so this takes as long as it took until there. What was
    returned before is not taken back; the repeated course differs from it by the integration error, and by that minute.
    """

    def __init__(self, job: FmuJob, work_folder: Path, patience_s: float) -> None:
        """Start the process at `start`; `patience_s` as for `FmuProcess`."""
        tolerance = job.tolerance if job.tolerance and job.tolerance > 0.0 else _TOLERANCE
        self._job, self._folder, self._patience_s = job, work_folder, patience_s
        # Ways to go on, in turn: the tolerance, and how much later the latest inputs come, s.
        self._other = (
            (tolerance / 10.0, 0.0),
            (tolerance * 10.0, 0.0),
            *((tolerance / 10.0, later_s) for later_s in _LATER_S),
        )
        self._told: list[tuple[Mapping[str, float], float]] = []
        self._start_s = 0.0
        self._process: FmuProcess | None = None
        self.restarts: tuple[str, ...] = ()
        """When, why and with which tolerance it was started again."""

    def start(self, start_s: float) -> FmuStretch:
        """Load and initialise the FMU at `start_s`; raises `PlantError`, and is not tried again."""
        self._start_s = start_s
        return self._begin(self._job)[1]

    def advance(self, inputs: Mapping[str, float], duration_s: float, told: Sequence[str] = ()) -> FmuStretch:
        """Simulate; `told`: `restarts` in a run that is repeated; raises `PlantError` at the last tolerance."""
        if self._process is None or self._process.closed:
            raise PlantError("the FMU was closed; reset the plant to start it again")
        self._told.append((inputs, duration_s))
        try:
            if len(told) > len(self.restarts):
                return self._again(told)
            return self._process.advance(inputs, duration_s)
        except PlantError as error:
            return self._restarted(error)

    def close(self) -> None:
        """End the process; safe to call twice."""
        if self._process is not None:
            self._process.close()

    def _begin(self, job: FmuJob) -> tuple[FmuProcess, FmuStretch]:
        self.close()
        self._process = FmuProcess(job, self._folder, self._patience_s)
        return self._process, self._process.start(self._start_s)

    def _restarted(self, error: PlantError) -> FmuStretch:
        """The latest stretch at the next tolerance at which the run comes to its end; raises the last error."""
        while len(self.restarts) < len(self._other):
            tolerance, later_s = self._other[len(self.restarts)]
            if later_s and not self._may_come_later(later_s):
                break
            reason = str(error).splitlines()[0][:200]
            later = f" and its latest inputs {later_s:g} s later" * bool(later_s)
            restart = f"restarted with tolerance {tolerance:g}{later}: {reason}"
            days = sum(duration_s for _, duration_s in self._told) / DAY_S
            _LOG.warning("the FMU is %s; it repeats %.3g days", restart, days)
            try:
                return self._again((*self.restarts, restart))
            except PlantError as again:
                error = again
        raise PlantError(f"{error}\nIt had been {' and '.join(self.restarts)}") from error

    def _may_come_later(self, later_s: float) -> bool:
        """Whether inputs went before the latest ones, which hold for long enough."""
        return len(self._told) > 1 and self._told[-1][1] > 2.0 * later_s

    def _again(self, restarts: Sequence[str]) -> FmuStretch:
        """The latest stretch, in a new process that has repeated those before."""
        self.restarts = tuple(restarts)
        tolerance, later_s = self._other[min(len(restarts), len(self._other)) - 1]
        process, _ = self._begin(replace(self._job, tolerance=tolerance))
        *before, (inputs, duration_s) = self._told
        for told in before:
            process.advance(*told)
        if not (later_s and self._may_come_later(later_s)):
            return process.advance(inputs, duration_s)
        first = process.advance(before[-1][0], later_s)
        rest = process.advance(inputs, duration_s - later_s)
        # So it is repeated from now on.
        self._told[-1:] = [(before[-1][0], later_s), (inputs, duration_s - later_s)]
        return FmuStretch(
            np.concatenate([first.time_s, rest.time_s]), np.concatenate([first.rows, rest.rows]), rest.final
        )
