"""A simulation in a process of its own, asked by pickled messages over its standard streams.

Simulations are third-party machine code that may print, crash, hang, or keep state between two runs of a process, so
every run gets a new process. Every answer has a time limit, and one that takes long is said in the log. A long stretch
is asked for in pieces of `PIECE_S` of the building's time, so that one limit tells a process that hangs, or gets ever
slower, from a warm-up that is long.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from fnmatch import fnmatchcase
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any

from boptest_client import safe_text
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.dependencies import SWITCHES
from thermoforce_mpc.errors import PlantError, left_to_parent
from thermoforce_mpc.registry import names_in

_LOG = logging.getLogger(__name__)

# Longest time for a piece, s: a simulation that is slower than the building itself does not come to an end.
PATIENCE_S = 900.0
PIECE_S = 900.0
# A process that starts has this long at least, s.
START_S = 60.0
# A wait is said after this time, or half of the limit if that is sooner, and again whenever it has doubled, s.
_SAID_AFTER_S = 60.0
# An end, and what a killed process leaves unread, are waited for this long, s.
_END_S = 5.0

_SAID_BYTES = 500

PASSED = "TF_MPC_PASS"
"""Variable with names, separated by commas, of others that workers get too: `LM_LICENSE_FILE, DYMOLA_*`."""
_NEEDED = (
    "PATH", "HOME", "USER", "LANG", "LANGUAGE", "LC_*", "TZ", "LD_LIBRARY_PATH", "LD_PRELOAD", "XDG_CACHE_HOME",
    "PYTHON*", "VIRTUAL_ENV", "CONDA_PREFIX", "COVERAGE_*", "OMP_*", "OPENBLAS_*", "MKL_*", "NUMBA_*",
)  # fmt: skip


class WorkerProcess:
    """Process of one run of `what`; `patience_s` for a piece of `PIECE_S`, s; `now_s`: time of the run, s."""

    def __init__(self, module: str, what: str, work_folder: Path, patience_s: float = PATIENCE_S) -> None:
        """Start `main` of `module`; `work_folder` is its working directory, and where it puts temporary files."""
        self._what, self.patience_s, self.now_s = what, patience_s, 0.0
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        root = str(Path(__file__).resolve().parents[2])
        handed = _handed()
        path = os.pathsep.join([root, *filter(None, [handed.get("PYTHONPATH")])])
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"from {module} import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            cwd=work_folder,
            env={**handed, "PYTHONPATH": path, "TMPDIR": str(work_folder)},
        )

    @property
    def closed(self) -> bool:
        """Whether it was closed, or failed, which closes it."""
        return self._said.closed

    def ask(self, phase: str, request: object, *, doing: str = "simulate", limit_s: float | None = None) -> Any:
        """The answer to `request`; without one the process is closed: an incomplete step cannot be continued.

        `phase` and `doing` name it in messages, such as 'step from' and 'simulate'. Raises `PlantError` where it
        failed, or took more than `limit_s`, by default its patience.
        """
        if self.closed:
            raise PlantError(f"{self._what} was closed; reset the plant to start it again")
        try:
            return self._answer(phase, request, doing, limit_s or self.patience_s)
        except BaseException:
            self.close()
            raise

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

    def _answer(self, phase: str, request: object, doing: str, limit_s: float) -> Any:
        when = f"day {self.now_s / DAY_S:g}"
        whose = f"{self._what}'" if self._what.endswith("s") else f"{self._what}'s"
        answer: Future[Any] = Future()
        reader = threading.Thread(target=self._exchange, args=(request, answer), daemon=True)
        reader.start()
        try:
            _wait(answer, f"{whose} {phase} {when}", limit_s)
        except BaseException:  # also Ctrl-C
            self._process.kill()
            reader.join(_END_S)
            raise
        try:
            said = answer.result()
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            raise PlantError(f"{whose} process {self._end()} at {when}{self._last_words()}") from error
        if isinstance(said, Failed):
            why = f"{safe_text(said.why)}{self.advice(said.why)}{self._last_words()}"
            raise PlantError(f"{self._what} could not {doing} at {when}: {why}")
        return said

    def advice(self, why: str) -> str:
        """What to do about a failure, for the end of its message."""
        return ""

    def _exchange(self, request: object, answer: Future[Any]) -> None:
        try:
            assert self._process.stdin is not None  # both are pipes
            assert self._process.stdout is not None
            pickle.dump(request, self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
            self._process.stdin.flush()
            answer.set_result(pickle.load(self._process.stdout))  # trusted: from our own process
        except BaseException as error:  # raised again where it is waited for
            answer.set_exception(error)

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
        size = os.fstat(self._said.fileno()).st_size
        said = os.pread(self._said.fileno(), _SAID_BYTES, max(size - _SAID_BYTES, 0))
        text = safe_text(said.decode(errors="replace").strip())
        return f"\nIts last output (of {size:,} bytes):\n{text}" if text else ""


def _handed() -> dict[str, str]:
    """Environment of a worker: what Python and libraries need, and what `PASSED` names; no token, key or password.

    A simulation is native code of this user and could read more elsewhere; what it is not handed it does not log.
    """
    named = names_in(os.environ.get(PASSED))
    wanted = [*_NEEDED, *(switch.variable for switch in SWITCHES), *named]
    return {key: value for key, value in os.environ.items() if any(fnmatchcase(key, name) for name in wanted)}


def _wait(answer: Future[Any], what: str, limit_s: float) -> None:
    """Wait for `answer`, and say so; raises `PlantError` at the limit."""
    began, say_s = time.monotonic(), min(limit_s / 2.0, _SAID_AFTER_S)
    while not wait([answer], max(began + min(say_s, limit_s) - time.monotonic(), 0.0)).done:
        if time.monotonic() - began >= limit_s:
            raise PlantError(f"{what} took more than {limit_s:g} s and was ended (plant.patience_min allows more)")
        _LOG.warning("%s takes %.3g s already; it is ended after %g s", what, time.monotonic() - began, limit_s)
        say_s *= 2.0


class Failed:
    """Answer of a worker that failed, with the error in words."""

    def __init__(self, error: BaseException) -> None:
        self.why = f"{type(error).__name__}: {error}"


def channel() -> tuple[Callable[[], Any], Callable[[Any], None]]:
    """Receive a request and send an answer, in the worker; the end of the stream ends its process, also if it hangs."""
    left_to_parent()
    # Output of the simulation must not reach the messages: standard output is redirected to standard error.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    requests: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_receive, args=(requests,), daemon=True).start()

    def send(answer: Any) -> None:
        pickle.dump(answer, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()

    return requests.get, send


def _receive(requests: SimpleQueue[Any]) -> None:
    """Queue what comes; at the end of the stream end the process without unloading libraries, which tend to crash."""
    try:
        while True:
            requests.put(pickle.load(sys.stdin.buffer))
    finally:
        os._exit(0)
