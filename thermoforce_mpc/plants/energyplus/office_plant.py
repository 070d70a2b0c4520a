"""The DOE small office as a plant with five zones; the engine runs in its own process. Building: `office_model`.

One room thermostat per zone, whose own loops deliver the heat, with a level of either sign: a zone's unit has a burner
and a cooling coil, of which one works at a time; its level is heat over the burner's size, negative for cooling. Gas
and electricity of a unit are billed apart: while heating at the price of gas, while cooling at that of electricity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.data import ZERO_C_K, Array, Block, Measurement, PlantInfo, Record
from thermoforce_mpc.plants.energyplus import office_model as office
from thermoforce_mpc.plants.energyplus.engine import file_hash, reference_building
from thermoforce_mpc.plants.energyplus.process import RUN_DAYS, Building, EnginePlant, Stretch, whole_steps
from thermoforce_mpc.plants.kpis import Supply
from thermoforce_mpc.plants.shell import RoomSetpointShell
from thermoforce_mpc.scenario.actuator import RoomSetpoints
from thermoforce_mpc.scenario.testcase import TestCase

# Two weeks from a Monday without holidays: first day of the year, from 0.
PERIODS = {"peak_heat_day": 28, "cold_day": 343, "mix_day": 98, "peak_cool_day": 196}
# Share of people from which on the tight comfort band holds: weekdays 06:00 to 20:00, Saturdays 06:00 to 17:00.
OCCUPIED_FROM = 0.1

_Z = len(office.ZONES)
_FLOOR_AREA_M2 = np.array([zone.floor_area_m2 for zone in office.ZONES])
_FULL_W = np.array([zone.heating_W for zone in office.ZONES])
# Width of each signal in a row of the record, and its place; of heat and power those of gas come first.
_WIDTHS = {"T_zone_C": _Z, "T_out_C": 1, "solar_W_m2": 1, "heat_W": 2 * _Z, "power_W": 2 * _Z}
_ENDS = np.cumsum(list(_WIDTHS.values()))
_PLACE = {name: slice(int(end) - width, int(end)) for (name, width), end in zip(_WIDTHS.items(), _ENDS, strict=True)}


class SmallOfficePlant(EnginePlant[tuple[float, ...], office.OfficeReading], RoomSetpointShell):
    """DOE small office (Chicago, TMY3 weather of O'Hare); zones, actuators and machines are those of its test case."""

    _periods = PERIODS
    _zones = tuple(zone.name for zone in office.ZONES)
    _carriers = ("GasPower", "ElectricPower")

    def __init__(self, testcase: TestCase, **options: Any) -> None:
        """Read the weather and the schedules; `options`: see `EnginePlant`, as for errors."""
        super().__init__(testcase, office.WEATHER, **options)
        self._schedules = office.office_schedules()
        self._points = testcase.points
        self._names, self._lowest = self._points.layout.names, self._points.layout.lowest

    @property
    def info(self) -> PlantInfo:
        """Building, weather and engine version."""
        what = f"DOE small office of {self.testcase.area_m2:.0f} m2, five zones with a rooftop unit each"
        return self._info(
            "energyplus:small_office", what, building_sha256=file_hash(reference_building(office.BUILDING))
        )

    def _check_reset(self, start_s: float, warmup_s: float, price: str) -> None:
        super()._check_reset(start_s, warmup_s, price)
        for what, duration_s in (("start", start_s), ("warm-up", warmup_s)):
            whole_steps(what, duration_s, office.STEP_S)

    def _building(self, first_day: int) -> Building[tuple[float, ...], office.OfficeReading]:
        return office.office_building(first_day, RUN_DAYS)

    def _demand(self, block: Block) -> tuple[float, ...]:
        setpoints_C = np.full(2 * _Z, math.nan)
        for a, (level, band, one) in enumerate(zip(block.u, block.band_C, self._points.actuators, strict=True)):
            actuator = one.actuator
            if level is None or not isinstance(actuator, RoomSetpoints):
                continue
            values = actuator.inputs(level, band)
            setpoints_C[a] = values[f"{actuator.heating}_u"] - ZERO_C_K
            setpoints_C[_Z + a] = values[f"{actuator.cooling}_u"] - ZERO_C_K
        return tuple(setpoints_C.tolist())

    def _first_row(self, reading: office.OfficeReading, T_out_C: float, solar_W_m2: float) -> Array:
        (row,) = _rows_of([reading])
        row[_PLACE["T_out_C"]], row[_PLACE["solar_W_m2"]] = T_out_C, solar_W_m2
        return np.asarray(row)

    def _rows(self, stretch: Stretch[tuple[float, ...], office.OfficeReading]) -> Array:
        return _rows_of(stretch.readings)

    def _people(self, time_s: Array) -> Array:
        return np.asarray(_FLOOR_AREA_M2[:, None] / office.AREA_PER_PERSON_M2 * self._schedules.occupancy(time_s))

    def _heating_price(self, time_s: Array) -> Array:
        return np.full(time_s.size, tariffs.GAS)

    def _past(self, edges: Array) -> Record:
        self._check_started()
        n = edges.size - 1
        every = whole_steps("history in steps", edges[1] - edges[0], office.STEP_S) if n else 1
        rows = self._samples.rows[-1 - n * every :]

        def samples(name: str) -> Array:
            return np.ascontiguousarray(rows[::every, _PLACE[name]].T)

        def means(name: str) -> Array:
            acting = rows[1:, _PLACE[name]]
            return np.ascontiguousarray(acting.reshape(n, every, acting.shape[1]).mean(axis=1).T)

        return Record(
            time_s=edges,
            T_zone_C=samples("T_zone_C"),
            T_out_C=samples("T_out_C")[0],
            solar_W_m2=samples("solar_W_m2")[0],
            u=self._levels(means("heat_W")),
            heat_W=_of_units(means("heat_W")),
            power_W=_of_units(means("power_W")),
            names=self._names,
        )

    def _supplies(self, time_s: Array, rows: Array) -> list[Supply]:
        power = rows[:, _PLACE["power_W"]]
        gas = np.full(time_s.size, tariffs.GAS), np.full(time_s.size, tariffs.GAS_EMISSION_KG_PER_KWH)
        return [
            Supply("GasPower", power[:, :_Z].sum(axis=1), *gas, of_steps=True),
            Supply("ElectricPower", power[:, _Z:].sum(axis=1), *self._bought(time_s), of_steps=True),
        ]

    def _bounds(self, time_s: Array) -> tuple[Array, Array]:
        """Set-points while `OCCUPIED_FROM` of the people are in, else those of the night with its tolerance."""
        occupied = self._schedules.occupancy(time_s) >= OCCUPIED_FROM
        tight, wide = self._schedules.tight_C(), self._schedules.wide_C()
        return np.where(occupied, tight[0], wide[0]), np.where(occupied, tight[1], wide[1])

    def _measured(self, before_s: float) -> Measurement:
        steps, rows = round((self._now_s - before_s) / office.STEP_S), self._samples.rows
        heat_W, power_W = (
            rows[-steps:, _PLACE[name]].mean(axis=0) if steps else np.full(2 * _Z, np.nan)
            for name in ("heat_W", "power_W")
        )
        return Measurement(
            time_s=self._now_s,
            T_zone_C=rows[-1, _PLACE["T_zone_C"]].copy(),
            T_out_C=float(rows[-1, _PLACE["T_out_C"]][0]),
            solar_W_m2=float(rows[-1, _PLACE["solar_W_m2"]][0]),
            u=self._levels(heat_W),
            heat_W=_of_units(heat_W),
            power_W=_of_units(power_W),
            names=self._names,
        )

    def _levels(self, heat_W: Array) -> Array:
        """Levels (Z,) or (Z, n) by the heat of burners and coils, (2 Z,) or (2 Z, n)."""
        return np.clip(_of_units(heat_W).T / _FULL_W, self._lowest, 1.0).T


def _of_units(values: Array) -> Array:
    """Values (Z,) or (Z, n) of each zone's unit, from those of burners and electric parts, (2 Z,) or (2 Z, n)."""
    return np.asarray(values[:_Z] + values[_Z:])


def _rows_of(readings: Sequence[office.OfficeReading]) -> Array:
    """Rows (n, k) of readings, see `_PLACE`."""
    return np.array([np.hstack([getattr(reading, name) for name in _WIDTHS]) for reading in readings])
