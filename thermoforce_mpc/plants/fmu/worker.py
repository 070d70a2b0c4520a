"""Process that runs one FMU: `python -m thermoforce_mpc.plants.fmu.worker`, with messages over standard streams.

An FMU is third-party machine code that may print, crash, or keep state between two runs of a process, so every start
gets a new process. Messages are pickled tuples; `WorkerProcess` is the client.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
from collections.abc import Mapping, Sequence
from queue import SimpleQueue
from typing import Any, BinaryIO

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.plants.fmu.messages import Job, Stretch


class _Slave:
    """FMU instance whose signals are addressed by name."""

    def __init__(self, job: Job, start_s: float) -> None:
        from fmpy.fmi2 import FMU2Slave

        self._job = job
        self._fmu = FMU2Slave(guid=job.guid, modelIdentifier=job.model_identifier, unzipDirectory=job.folder)
        self._fmu.instantiate()
        self._fmu.setupExperiment(tolerance=job.tolerance, startTime=start_s)
        self._fmu.enterInitializationMode()
        self._fmu.exitInitializationMode()
        self._now_s = start_s
        self._recorded = [job.outputs[name] for name in job.recorded]

    def start(self) -> Stretch:
        return Stretch(np.array([self._now_s]), np.array([self._read(self._recorded)]), self._final())

    def advance(self, inputs: Mapping[str, float], time_s: Array) -> Stretch:
        """Set `inputs`, and simulate from one of the times to the next."""
        for name, value in inputs.items():
            self._write(*self._job.inputs[name], value)
        rows = np.empty((len(time_s), len(self._recorded)))
        for i, reached_s in enumerate(time_s):
            self._fmu.doStep(self._now_s, float(reached_s) - self._now_s)
            self._now_s = float(reached_s)
            rows[i] = self._read(self._recorded)
        return Stretch(time_s, rows, self._final())

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
    """Answer requests until the other end closes the stream, which also ends an FMU that hangs."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the other end too, which then ends this one
    # Output of the FMU must not reach the message channel: standard output is redirected to standard error.
    channel = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    requests: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_receive, args=(sys.stdin.buffer, requests), daemon=True).start()
    slave: _Slave | None = None
    while True:
        request = requests.get()
        try:
            if request[0] == "start":
                slave = _Slave(request[1], request[2])
                answer: Any = slave.start()
            elif slave is not None:
                answer = slave.advance(request[1], request[2])
            else:
                raise RuntimeError("asked to advance before it was started")
        except Exception as error:  # any error of the FMU or FMPy is reported by the client
            answer = f"{type(error).__name__}: {error}"
        pickle.dump(answer, channel, protocol=pickle.HIGHEST_PROTOCOL)
        channel.flush()


def _receive(stream: BinaryIO, requests: SimpleQueue[Any]) -> None:
    """Queue what comes; at the end of the stream end the process.

    Libraries are not unloaded: those of others tend to crash then, and nothing is left to save.
    """
    try:
        while True:
            requests.put(pickle.load(stream))
    finally:
        os._exit(0)


if __name__ == "__main__":
    main()
