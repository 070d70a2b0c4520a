"""BOPTEST test case run from its FMU, without the service. Temperatures are K in the FMU and °C in the package."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from boptest_client import Point
from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.boundary.periods import centred_window
from thermoforce_mpc.data import ZERO_C_K, Array, Block, Boundary, Measurement, Period, PlantInfo, Record
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.boptest.points import check_points
from thermoforce_mpc.plants.checks import day_period
from thermoforce_mpc.plants.fmu.archive import read_archive, unpack
from thermoforce_mpc.plants.fmu.process import FmuRun
from thermoforce_mpc.plants.fmu.scores import KpiOutputs
from thermoforce_mpc.plants.records import acting_means, boundary, inputs, mean_levels, measurement, past_record
from thermoforce_mpc.plants.shell import RoomSetpointShell, Samples, WithProcess
from thermoforce_mpc.plants.worker_process import PATIENCE_S
from thermoforce_mpc.scenario.testcase import TestCase


class FmuPlant(WithProcess[FmuRun], RoomSetpointShell):
    """Test case in an FMU, run by FMPy in its own process.

    ```python
    with FmuPlant(Path("wrapped.fmu"), testcase) as plant:
        window = plant.period("peak_heat_day")
        plant.reset(window.start_s, window.warmup_s)
        measurement = plant.advance(u=0.5, duration_s=900)
    ```

    Results are sampled every 30 s, as in BOPTEST. Boundary data, KPI signals and scenario days come from the FMU's
    resources. Where a step fails or takes too long, the FMU is started again, see `FmuRun`.
    """

    def __init__(
        self,
        path: Path,
        testcase: TestCase,
        *,
        forecast_error: ForecastError | None = None,
        patience_s: float = PATIENCE_S,
    ) -> None:
        """Read the FMU and check that it has every point of `testcase` in the expected unit; it starts at `reset`.

        Args:
            forecast_error: weather forecast errors; default: a perfect forecast.
            patience_s: longest time for a quarter of an hour of the building's time, and for the FMU's start, s.

        Raises:
            ConfigError: the file is not a usable FMU, or `testcase` does not fit it.
        """
        self.testcase = testcase
        self._forecast_error, self._patience_s = forecast_error, patience_s
        self._restarts: list[str] = []  # of the runs before the present one
        self._told_restarts: Sequence[str] = ()
        self._archive = archive = read_archive(path)
        forecast = {name: Point(name, archive.boundary.unit(name), "", None, None) for name in archive.boundary.series}
        given, outputs = (
            {name: signal.point for name, signal in signals.items()} for signals in (archive.inputs, archive.outputs)
        )
        check_points(testcase, given, outputs, forecast, f"the FMU {path}")
        self._points = testcase.points
        self._names, self._u_min = self._points.layout.names, self._points.layout.u_min
        echoes = [f"{name}_y" for name in self._points.sensed]
        for echo in echoes:
            if echo not in archive.outputs:
                raise ConfigError(f"the FMU {path} has no output '{echo}': the applied level cannot be recorded")
        self._scores = KpiOutputs(archive, testcase)
        p = self._points
        kept = [*p.temperatures, p.outdoor_temperature, p.solar, *echoes, *p.flows]
        self._kept = tuple(dict.fromkeys([*kept, *self._scores.signals]))
        self._T_zone_C: Array = np.full(len(p.zones), math.nan)
        self._last: Measurement | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="tf-mpc-fmu-", ignore_cleanup_errors=True)
        try:
            for part in ("fmu", "work"):
                (Path(self._folder.name) / part).mkdir()
            unpack(archive, Path(self._folder.name) / "fmu")
        except BaseException:
            self._folder.cleanup()
            raise

    @property
    def info(self) -> PlantInfo:
        """FMU file, its name and hash, and when it was started again."""
        archive = self._archive
        restarts = "; ".join([*self._restarts, *self.restarts])
        return PlantInfo(
            kind="fmu",
            testcase=archive.name,
            description=f"FMU {archive.path}, made by {archive.tool}" + (restarts and f"; {restarts}"),
            weather="the test case's own weather",
            version=archive.sha256[:12],
            details={"path": str(archive.path), "sha256": archive.sha256, "restarts": restarts},
        )

    @property
    def restarts(self) -> tuple[str, ...]:
        """See `RestartingPlant.restarts`."""
        return () if self._process is None else self._process.restarts

    def restart_as(self, restarts: Sequence[str]) -> None:
        """See `RestartingPlant.restart_as`."""
        self._told_restarts = restarts

    def period(self, name: str) -> Period:
        """Return the window of a scenario in the FMU's days.json, or of a start day; raises `InputError`."""
        days = self._archive.days
        return centred_window(name, days[name]) if name in days else day_period(name, days)

    def _check_reset(self, start_s: float, warmup_s: float, price: str) -> None:
        super()._check_reset(start_s, warmup_s, price)
        self._archive.boundary.at(self._points.forecast_outdoor, np.array([start_s]))  # else a `WeatherError`

    def _begin(self) -> None:
        self._end()
        folder = Path(self._folder.name)
        self._process = FmuRun(self._archive.job(folder / "fmu", self._kept), folder / "work", self._patience_s)
        first = self._process.start(self._now_s)
        self._samples, self._final = Samples(self._now_s, first.rows[0]), first.final

    def _boundary(self, time_s: Array) -> Boundary:
        self._check_started()
        p, at = self._points, self._archive.boundary.at

        def outdoor_C(at_s: Array) -> Array:
            return at(p.forecast_outdoor, at_s) - ZERO_C_K

        def solar_W_m2(at_s: Array) -> Array:
            return at(p.forecast_solar, at_s)

        if self._forecast_error:
            T_out, solar = self._forecast_error.apply(time_s, outdoor_C, solar_W_m2)
        else:
            T_out, solar = outdoor_C(time_s), solar_W_m2(time_s)
        values = {name: at(name, time_s) for name in p.forecast(self._price)}
        return boundary(time_s, values, p, self._price, (T_out, solar))

    def _past(self, edges: Array) -> Record:
        record = self._record()
        return past_record(record, self._points, mean_levels(record, self._points, edges, "_y"), edges)

    def kpis(self) -> dict[str, float]:
        """Return BOPTEST's KPIs since the end of the warm-up, from the 30-s record; raises as `past` does."""
        return self._scores.kpis(self._record(), self._start_s, self._price)

    def close(self) -> None:
        """End the FMU's process and remove the unpacked files; safe to call twice."""
        self._end()
        self._folder.cleanup()

    def _end(self) -> None:
        self._restarts += self.restarts
        super().close()

    def _run(self, block: Block) -> None:
        asked = inputs(self._points, block, self._T_zone_C, self._last)
        stretch = self._running.advance(asked, block.duration_s, self._told_restarts)
        self._told_restarts = ()
        self._samples.append(stretch.time_s, stretch.rows)
        self._now_s, self._final = float(stretch.time_s[-1]), stretch.final

    def _measured(self, before_s: float) -> Measurement:
        """See `PlantShell`; the zone temperature serves the actuator's map next."""
        acting = None
        if before_s < self._now_s:
            edges, record = np.array([before_s, self._now_s]), self._record(before_s)
            acting = acting_means(record, self._points, mean_levels(record, self._points, edges, "_y"), edges)
        self._last = measurement(self._now_s, self._final, self._points, acting)
        self._T_zone_C = self._last.T_zone_C
        return self._last

    def _record(self, start_s: float = 0.0) -> dict[str, Array]:
        """Recorded signals by name, with 'time', from `start_s` to now."""
        self._check_started()
        time_s, rows = self._samples.between(start_s, self._now_s)
        return {"time": time_s} | {name: rows[:, i] for i, name in enumerate(self._kept)}
