"""A BOPTEST service with an FMU inside: the documented protocol over a real socket, the test case's own physics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from boptest_server import Service, rejected

from boptest_client import Point
from thermoforce_mpc.plants.fmu.archive import read_archive, unpack
from thermoforce_mpc.plants.fmu.process import FmuProcess

_OVERWRITTEN = "_activate"


class FmuTest:
    """One selected test. As in the service, the value of an overwrite point, whoever set it, is read at its `_u`."""

    def __init__(self, fmu: Path, folder: Path) -> None:
        self.archive = archive = read_archive(fmu)
        self._job = archive.job(folder / "fmu", tuple(archive.outputs))
        for name in ("fmu", "work"):
            (folder / name).mkdir(parents=True)
        unpack(archive, folder / "fmu")
        self._folder = folder
        self._worker: FmuProcess | None = None

    def initialize(self, start_s: float, warmup_s: float) -> dict[str, float]:
        self.close()
        self._worker = FmuProcess(self._job, self._folder / "work")
        self.time_s = max(start_s - warmup_s, 0.0)
        self._stretches = [self._worker.start(self.time_s)]
        return self.advance({}, start_s - self.time_s)

    def advance(self, inputs: dict[str, float], step_s: float) -> dict[str, float]:
        assert self._worker is not None  # started by `initialize`
        # The service lets go of what is not sent again.
        sent = {name: 0.0 for name in self.archive.inputs if name.endswith(_OVERWRITTEN)} | inputs
        self._stretches.append(self._worker.advance(sent, step_s))
        self.time_s = float(self._stretches[-1].time_s[-1])
        final = self._stretches[-1].final
        return {self.answered_as(name): value for name, value in final.items()} | {"time": self.time_s}

    def answered_as(self, output: str) -> str:
        point = output.removesuffix("_y")
        return f"{point}_u" if f"{point}{_OVERWRITTEN}" in self.archive.inputs else output

    def recorded(self, names: list[str], start_s: float, final_s: float) -> dict[str, list[float]]:
        time_s = np.concatenate([stretch.time_s for stretch in self._stretches])
        rows = np.vstack([stretch.rows for stretch in self._stretches])
        within = (time_s >= start_s - 1e-6) & (time_s <= final_s + 1e-6)
        column = {self.answered_as(name): i for i, name in enumerate(self.archive.outputs)}
        return {name: rows[within, column[name]].tolist() for name in names} | {"time": time_s[within].tolist()}

    def close(self) -> None:
        if self._worker is not None:
            self._worker.close()


class FmuService(Service):
    """Start days only; no forecast errors."""

    def __init__(self, name: str, fmu: Path, folder: Path) -> None:
        super().__init__(offers=(name,))
        self._fmu, self._folder = fmu, folder

    def _new(self, name: str) -> FmuTest:
        return FmuTest(self._fmu, self._folder / f"test {len(self.tests)}")

    def _name(self, testid: str, test: FmuTest, body: Any) -> Any:
        return {"name": self.offers[0]}

    def _inputs(self, testid: str, test: FmuTest, body: Any) -> Any:
        return _described(test.archive.points(test.archive.inputs))

    def _measurements(self, testid: str, test: FmuTest, body: Any) -> Any:
        points = test.archive.points(test.archive.outputs)
        return _described({name: point for name, point in points.items() if test.answered_as(name) == name})

    def _forecast_points(self, testid: str, test: FmuTest, body: Any) -> Any:
        return {name: {"Unit": test.archive.boundary.unit(name)} for name in test.archive.boundary.series}

    def _initialize(self, testid: str, test: FmuTest, body: Any) -> Any:
        return test.initialize(body["start_time"], body["warmup_period"])

    def _scenario(self, testid: str, test: FmuTest, body: Any) -> Any:
        if body.get("time_period"):
            raise rejected("Scenario parameter time_period: start days only")
        return body

    def _advance(self, testid: str, test: FmuTest, body: Any) -> Any:
        return test.advance(body, self.steps[testid])

    def _forecast(self, testid: str, test: FmuTest, body: Any) -> Any:
        times = test.time_s + np.arange(0.0, body["horizon"] + 1.0, body["interval"])
        at = test.archive.boundary.at
        return {name: at(name, times).tolist() for name in body["point_names"]} | {"time": times.tolist()}

    def _results(self, testid: str, test: FmuTest, body: Any) -> Any:
        return test.recorded(body["point_names"], body["start_time"], body["final_time"])

    def _kpi(self, testid: str, test: FmuTest, body: Any) -> Any:
        return {"tdis_tot": 0.0, "cost_tot": 0.0, "ener_tot": 0.0}

    def _stop(self, testid: str, test: FmuTest, body: Any) -> Any:
        test.close()
        return super()._stop(testid, test, body)


def _described(points: dict[str, Point]) -> dict[str, dict[str, Any]]:
    return {
        p.name: {"Unit": p.unit, "Description": p.name, "Minimum": p.minimum, "Maximum": p.maximum}
        for p in points.values()
    }
