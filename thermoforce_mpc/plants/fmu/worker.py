"""Process that runs one FMU: `python -m thermoforce_mpc.plants.fmu.worker`; `FmuProcess` is the client."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.plants.fmu.messages import Job, Stretch
from thermoforce_mpc.plants.worker_process import Failed, channel


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


if __name__ == "__main__":
    main()
