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

from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.fmu.messages import Job, Stretch

_SAID_BYTES = 2000
_PATIENCE_S = 5.0


class WorkerProcess:
    """Process of one run of an FMU; it is never used for a second run."""

    def __init__(self, job: Job, work_folder: Path) -> None:
        """Start the process; `work_folder` is its working directory, where the FMU may write files."""
        self._job = job
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

    def start(self, start_s: float) -> Stretch:
        """Load and initialise the FMU at `start_s`; raises `PlantError`."""
        self._now_s = start_s
        return self._ask("be loaded", ("start", self._job, start_s))

    def advance(self, inputs: Mapping[str, float], duration_s: float) -> Stretch:
        """Set inputs by name and simulate; raises `PlantError`."""
        stretch = self._ask("simulate", ("advance", dict(inputs), duration_s))
        self._now_s = float(stretch.time_s[-1])
        return stretch

    def close(self) -> None:
        """End the process; safe to call twice."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._said.close()

    def _ask(self, doing: str, request: tuple[Any, ...]) -> Stretch:
        if self._process.stdin is None or self._process.stdin.closed or self._process.stdout is None:
            raise PlantError("the FMU was closed; reset the plant to start it again")
        try:
            pickle.dump(request, self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
            self._process.stdin.flush()
            answer = pickle.load(self._process.stdout)  # trusted: from our own process
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            message = f"the FMU's process {self._end()} at day {self._now_s / DAY_S:g}{self._last_words()}"
            self.close()
            raise PlantError(message) from error
        if isinstance(answer, Stretch):
            return answer
        when = f"at day {self._now_s / DAY_S:g}"
        message = f"the FMU could not {doing} {when}: {answer}{missing_library(str(answer))}{self._last_words()}"
        self.close()  # an incomplete step cannot be continued
        raise PlantError(message)

    def _end(self) -> str:
        try:
            code = self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            return "stopped answering"
        if code < 0:
            with contextlib.suppress(ValueError):
                return f"was ended by signal {signal.Signals(-code).name}"
        return f"ended with code {code}"

    def _last_words(self) -> str:
        """Return the last 2000 bytes that the FMU and its process printed."""
        size = os.fstat(self._said.fileno()).st_size
        said = os.pread(self._said.fileno(), _SAID_BYTES, max(size - _SAID_BYTES, 0)) if hasattr(os, "pread") else b""
        text = said.decode(errors="replace").strip()
        return f"; its last output:\n{text}" if text else ""


def missing_library(error: str) -> str:
    """What to do about a system library that the loader did not find, or an empty string."""
    library = re.search(r"(\S+\.so[.\d]*): cannot open shared object file", error)
    if library is None:
        return ""
    package = "; on Debian and Ubuntu: apt-get install libgfortran5" if "libgfortran.so.5" in library[1] else ""
    return f"; the FMU was compiled with {library[1]}, which this machine lacks: install it{package}"
