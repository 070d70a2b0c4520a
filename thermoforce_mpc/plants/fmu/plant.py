"""BOPTEST test case run from its FMU, without the service. Temperatures are K in the FMU and °C in the package.

The FMU names the signals of its KPIs, `thermoforce_mpc.plants.kpis` computes them.
"""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from boptest_client import Point
from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.boundary.periods import centred_window
from thermoforce_mpc.data import ZERO_C_K, Array, Block, Boundary, Measurement, Period, PlantInfo, Record
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.fmu.archive import FmuArchive, read_archive, unpack
from thermoforce_mpc.plants.fmu.process import FmuRun
from thermoforce_mpc.plants.kpis import PEAKS, EnergySupply, Violation, building_kpis
from thermoforce_mpc.plants.points import (
    acting_means,
    boundary,
    check_points,
    inputs,
    mean_levels,
    measurement,
    past_record,
)
from thermoforce_mpc.plants.shell import RoomSetpointShell, Samples, WithProcess, day_period
from thermoforce_mpc.plants.worker_process import PATIENCE_S
from thermoforce_mpc.scenario.testcase import ForecastPoints, Price, TestCase

_ELECTRIC = "ElectricPower"
# BOPTEST's energy carriers. Fresh water is omitted: it has a cost but no energy, and no test case meters it.
_CARRIERS = (_ELECTRIC, "DistrictHeatingPower", "GasPower", "BiomassPower", "SolarThermalPower")
_THERMAL, _AIR_QUALITY = ("AirZoneTemperature", "OperativeZoneTemperature"), ("CO2Concentration",)


class KpiOutputs:
    """Outputs that make up each KPI, from the FMU's kpis.json or else from the test case file."""

    def __init__(self, archive: FmuArchive, testcase: TestCase) -> None:
        """Collect signals and series; raises `ConfigError` where one is missing or the floor areas differ."""
        self._boundary = archive.boundary
        self._area_m2 = testcase.area_m2
        if archive.area_m2 is not None and abs(archive.area_m2 - testcase.area_m2) > 0.01 * archive.area_m2:
            raise ConfigError(
                f"test case '{testcase.name}' has {testcase.area_m2:g} m2 of floor, "
                f"the FMU {archive.path} has {archive.area_m2:g} m2: this is another building"
            )
        self._prices, self._emissions = testcase.forecast.price, testcase.forecast.emission
        if archive.kpi_signals:  # BOPTEST bills each carrier at its own price, whichever the controller uses
            names = ForecastPoints()
            self._prices, self._emissions = names.price, names.emission
        listed = archive.kpi_signals
        if not listed:  # `metered` refuses several zones, whose bounds it would not name
            m = testcase.metered
            listed = {f"{_THERMAL[1]}[1]": (m.zone_temperature,), _ELECTRIC: m.electric_power}
        self._carriers = {name: signals for name, signals in listed.items() if name in _CARRIERS}
        self._thermal = _zones(listed, _THERMAL)
        self._air_quality = _zones(listed, _AIR_QUALITY)
        self.signals = tuple(
            signal
            for part in (self._carriers, self._thermal, self._air_quality)
            for group in part.values()
            for signal in group
        )
        missing = sorted(set(self.signals) - set(archive.outputs))
        if missing:
            raise ConfigError(
                f"{archive.path}: kpis.json names outputs that the FMU does not have: {', '.join(missing)}"
            )
        series = [f"UpperCO2[{zone}]" for zone in self._air_quality]
        series += [f"{end}Setp[{zone}]" for zone in self._thermal for end in ("Lower", "Upper")]
        series += [
            name for carrier in self._carriers for name in (self._emission(carrier), self._price(carrier, "constant"))
        ]
        self._boundary.require(series, "the KPIs")

    def kpis(self, record: Mapping[str, Array], start_s: float, price: Price) -> dict[str, float]:
        """Return the KPIs of the samples of `record` ('time' and outputs, (n,)) from `start_s`."""
        at = self._boundary.at
        scored = record["time"] >= start_s - 1e-6
        time_s = record["time"][scored]
        if time_s.size < 2:  # no step simulated yet: BOPTEST returns zeros
            names = ["ener_tot", "cost_tot", "emis_tot", *(PEAKS[name] for name in self._carriers if name in PEAKS)]
            names += ["tdis_tot"] * bool(self._thermal) + ["idis_tot"] * bool(self._air_quality)
            return dict.fromkeys(names, 0.0)
        supplies = [
            EnergySupply(
                carrier,
                np.sum([record[signal][scored] for signal in signals], axis=0),
                at(self._price(carrier, price), time_s),
                at(self._emission(carrier), time_s),
            )
            for carrier, signals in self._carriers.items()
        ]
        thermal = [
            Violation(
                zone, excess(record[signal][scored], at(f"LowerSetp[{zone}]", time_s), at(f"UpperSetp[{zone}]", time_s))
            )
            for zone, signals in self._thermal.items()
            for signal in signals
        ]
        air_quality = [
            Violation(zone, np.maximum(record[signal][scored] - at(f"UpperCO2[{zone}]", time_s), 0.0))
            for zone, signals in self._air_quality.items()
            for signal in signals
        ]
        return building_kpis(time_s, supplies=supplies, thermal=thermal, air_quality=air_quality, area_m2=self._area_m2)

    def _price(self, carrier: str, price: Price) -> str:
        return self._prices[price] if carrier == _ELECTRIC else f"Price{carrier}"

    def _emission(self, carrier: str) -> str:
        return self._emissions if carrier == _ELECTRIC else f"Emissions{carrier}"


def _zones(listed: Mapping[str, tuple[str, ...]], categories: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return signals by zone for the given categories, listed as 'Category[zone]'."""
    by_name: dict[str, tuple[str, ...]] = {}
    for name, signals in listed.items():
        match = re.fullmatch(r"(\w+)\[(\w+)\]", name)
        if match and match[1] in categories:
            by_name[match[2]] = by_name.get(match[2], ()) + signals
    return by_name


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
