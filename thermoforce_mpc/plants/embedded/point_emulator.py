"""Emulators that act through the points of their test case's file, as a service and an FMU do."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from boptest_client import Point
from thermoforce_mpc.boundary.forecast_error import forecast_weather
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import Array, Block, Boundary, Measurement, Record
from thermoforce_mpc.plants.boptest.points import check_points
from thermoforce_mpc.plants.embedded.cases import CASES
from thermoforce_mpc.plants.embedded.emulator import Emulator
from thermoforce_mpc.plants.records import acting_means, boundary, inputs, mean_levels, measurement, past_record
from thermoforce_mpc.plants.shell import RoomSetpointShell
from thermoforce_mpc.scenario.testcase import TestCase

_WEATHER = {"TDryBul": "K", "HGloHor": "W/m2"}


class PointEmulator(Emulator, RoomSetpointShell):
    """Emulator of `bestest_hydronic` or `bestest_air`, whose levels act by the points that a test case file names.

    ```python
    with PointEmulator(load_testcase("bestest_air"), synthetic_weather(climate=CONTINENTAL)) as plant:
        window = plant.period("peak_cool_day")
        plant.reset(window.start_s, window.warmup_s)
        measurement = plant.advance(u=-0.2, duration_s=900, command=(21.0, 24.0))
    ```
    """

    _changing = (*Emulator._changing, "_T_zone_C", "_last")

    def __init__(self, testcase: TestCase, weather: Weather, **options: Any) -> None:
        """Build the plant that `testcase.plant` names for a weather year; options as of `Emulator`.

        Raises `ConfigError` where `testcase` names a point that the plant has not, or one in another unit.
        """
        case = CASES[testcase.plant or testcase.name]
        self._points = testcase.points
        self._names, self._u_min = self._points.layout.names, self._points.layout.u_min
        self._T_zone_C: Array = np.full(len(self._points.zones), math.nan)
        self._last: Measurement | None = None
        self._columns = dict(case.measurements)
        self._columns |= {f"{name}_u": column for (name, *_), column in zip(case.overwrites, case.applied, strict=True)}
        super().__init__(case, weather, **options)
        told = {name: Point(name, _unit(column), "", None, None) for name, column in case.measurements.items()}
        given = {f"{name}_activate": Point(f"{name}_activate", None, "", None, None) for name in case.limits}
        for name, (low, high) in case.limits.items():
            given[f"{name}_u"] = Point(f"{name}_u", "K" if low > 1.0 else "1", "", low, high)
        forecast = {name: Point(name, _forecast_unit(name), "", None, None) for name in (*self.scheduled, *_WEATHER)}
        check_points(testcase, given, told, forecast, f"the embedded plant '{case.name}'")

    def _asked(self, block: Block) -> dict[str, float]:
        """Overwritten points of a block, by BOPTEST's names."""
        asked = inputs(self._points, block, self._T_zone_C, self._last)
        return {name: asked[f"{name}_u"] for name in self._limits if asked.get(f"{name}_activate")}

    def _run(self, block: Block) -> None:
        self._samples.append(*self._simulated(self._asked(block), block.duration_s))

    def _measured(self, before_s: float) -> Measurement:
        """See `PlantShell`; the zone temperature serves the actuator's map next."""
        acting = None
        if before_s < self._now_s:
            edges, record = np.array([before_s, self._now_s]), self._record(before_s)
            acting = acting_means(record, self._points, mean_levels(record, self._points, edges, "_u"), edges)
        row = self._samples.rows[-1].tolist()
        values = {name: row[self._column[column]] for name, column in self._columns.items()}
        self._last = measurement(self._now_s, values, self._points, acting)
        self._T_zone_C = self._last.T_zone_C
        return self._last

    def _boundary(self, time_s: Array) -> Boundary:
        p = self._points
        weather = forecast_weather(self.weather, self._forecast_error, time_s)
        names = [name for name in p.forecast(self._price) if name not in _WEATHER]
        values = {name: np.asarray(self.scheduled[name](time_s), dtype=np.float64) for name in names}
        return boundary(time_s, values, p, self._price, weather)

    def _past(self, edges: Array) -> Record:
        record = self._record(self._begin_s)
        return past_record(record, self._points, mean_levels(record, self._points, edges, "_u"), edges)

    def _record(self, start_s: float) -> dict[str, Array]:
        """Points by name, with 'time', from `start_s` to now."""
        time_s, rows = self._samples.between(start_s, self._now_s)
        return {"time": time_s} | {name: rows[:, self._column[column]] for name, column in self._columns.items()}


def _unit(column: str) -> str | None:
    """Unit of a column of the record, as far as a test case file asks for it."""
    return "K" if column.startswith("T_") else "W" if column.startswith("P_") else "W/m2" if column == "solar" else None


def _forecast_unit(name: str) -> str | None:
    return _WEATHER.get(name, "K" if name.endswith("Setp[1]") else None)
