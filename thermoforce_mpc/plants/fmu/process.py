"""Client of `worker`: starts the FMU's process, sends requests, and reports its failure as `PlantError`."""

from __future__ import annotations

import contextlib
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from boptest_client import safe_text
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.fmu.messages import SAMPLE_S, Job, Stretch
from thermoforce_mpc.plants.waiting import PATIENCE_S, PIECE_S, START_S, wait_for

_SAID_BYTES = 500
_END_S = 5.0


class WorkerProcess:
    """Process of one run of an FMU; it is never used for a second run."""

    def __init__(self, job: Job, work_folder: Path, patience_s: float = PATIENCE_S) -> None:
        """Start the process; `work_folder` is its working directory, where the FMU may write files.

        `patience_s`: longest time for a quarter of an hour of the building's time, and for its start (or 60 s), s.
        """
        self._job, self._patience_s = job, patience_s
        self._now_s = 0.0
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        root = str(Path(__file__).resolve().parents[3])
        path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        self._process = subprocess.Popen(
            [sys.executable, "-m", "thermoforce_mpc.plants.fmu.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            cwd=work_folder,
            env={**os.environ, "PYTHONPATH": path},
        )

    @property
    def closed(self) -> bool:
        """Whether it was closed, or failed, which closes it."""
        return self._said.closed

    def start(self, start_s: float) -> Stretch:
        """Load and initialise the FMU at `start_s`; raises `PlantError`."""
        self._now_s = start_s
        limit_s = max(self._patience_s, START_S)
        return self._ask("be loaded", "start at", ("start", self._job, start_s), limit_s)

    def advance(self, inputs: Mapping[str, float], duration_s: float) -> Stretch:
        """Set inputs by name and simulate; raises `PlantError`."""
        n = max(int(duration_s / SAMPLE_S + 1e-9), 1)
        times_s = self._now_s + np.arange(1.0, n + 1.0) * (duration_s / n)
        parts: list[Stretch] = []
        for times in np.split(times_s, range(int(PIECE_S / SAMPLE_S), n, int(PIECE_S / SAMPLE_S))):
            # Inputs are set once: an FMU may take each setting for an event.
            request = ("advance", {} if parts else dict(inputs), times)
            parts.append(self._ask("simulate", "step from", request, self._patience_s))
            self._now_s = float(times[-1])
        return Stretch(times_s, np.vstack([part.rows for part in parts]), parts[-1].final)

    def close(self) -> None:
        """End the process; safe to call twice."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._said.close()

    def _ask(self, doing: str, phase: str, request: tuple[Any, ...], limit_s: float) -> Stretch:
        """The answer to `request`; without one the process is closed: an incomplete step cannot be continued."""
        if self.closed:
            raise PlantError("the FMU was closed; reset the plant to start it again")
        try:
            return self._answer(doing, phase, request, limit_s)
        except BaseException:
            self.close()
            raise

    def _answer(self, doing: str, phase: str, request: tuple[Any, ...], limit_s: float) -> Stretch:
        when = f"day {self._now_s / DAY_S:g}"
        try:
            answer = wait_for(
                lambda: self._exchanged(request), self._process.kill, f"the FMU's {phase} {when}", limit_s
            )
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            raise PlantError(f"the FMU's process {self._end()} at {when}{self._last_words()}") from error
        if isinstance(answer, Stretch):
            return answer
        raise PlantError(
            f"the FMU could not {doing} at {when}: {safe_text(answer)}"
            f"{missing_library(str(answer))}{self._last_words()}"
        )

    def _exchanged(self, request: tuple[Any, ...]) -> Any:
        assert self._process.stdin is not None  # both are pipes
        assert self._process.stdout is not None
        pickle.dump(request, self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
        self._process.stdin.flush()
        return pickle.load(self._process.stdout)  # trusted: from our own process

    def _end(self) -> str:
        try:
            code = self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            return "stopped answering"
        if code < 0:
            with contextlib.suppress(ValueError):
                return f"was ended by signal {signal.Signals(-code).name}"
        return f"ended with code {code}"

    def _last_words(self) -> str:
        """Return the last of what the FMU and its process printed."""
        size = os.fstat(self._said.fileno()).st_size
        said = os.pread(self._said.fileno(), _SAID_BYTES, max(size - _SAID_BYTES, 0)) if hasattr(os, "pread") else b""
        text = safe_text(said.decode(errors="replace").strip())
        return f"\nIts last output (of {size:,} bytes):\n{text}" if text else ""


def missing_library(error: str) -> str:
    """What to do about a system library that the loader did not find, or an empty string."""
    library = re.search(r"(\S+\.so[.\d]*): cannot open shared object file", error)
    if library is None:
        return ""
    package = "; on Debian and Ubuntu: apt-get install libgfortran5" if "libgfortran.so.5" in library[1] else ""
    return f"; the FMU was compiled with {library[1]}, which this machine lacks: install it{package}"
