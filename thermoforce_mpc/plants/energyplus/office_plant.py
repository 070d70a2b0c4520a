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
from thermoforce_mpc.plants.energyplus.process import RUN_DAYS, EnginePlant, SimulatedBuilding, whole_steps
from thermoforce_mpc.plants.kpis import EnergySupply
from thermoforce_mpc.plants.shell import RoomSetpointShell
from thermoforce_mpc.scenario.actuator import RoomSetpoints
from thermoforce_mpc.scenario.testcase import TestCase

# Two weeks from a Monday without holidays: first day of the year, from 0.
PERIODS = {"peak_heat_day": 28, "cold_day": 343, "mix_day": 98, "peak_cool_day": 196}

_Z = len(office.ZONES)
_FLOOR_AREA_M2 = np.array([zone.floor_area_m2 for zone in office.ZONES])
_FULL_W = np.array([zone.heating_W for zone in office.ZONES])


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
        self._names, self._u_min = self._points.layout.names, self._points.layout.u_min

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

    def _building(self, first_day: int) -> SimulatedBuilding[tuple[float, ...], office.OfficeReading]:
        return office.office_building(first_day, RUN_DAYS)

    def _demand(self, block: Block) -> tuple[float, ...]:
        setpoints_C = np.full(2 * _Z, math.nan)
        for a, (level, told, one) in enumerate(zip(block.u, block.command, self._points.actuators, strict=True)):
            actuator = one.actuator
            if level is None or not isinstance(actuator, RoomSetpoints):
                continue
            values = actuator.inputs(level, told if isinstance(told, tuple) else None)
            setpoints_C[a] = values[f"{actuator.heating}_u"] - ZERO_C_K
            setpoints_C[_Z + a] = values[f"{actuator.cooling}_u"] - ZERO_C_K
        return tuple(setpoints_C.tolist())

    def _row(self, reading: office.OfficeReading, acted: tuple[float, ...] | None) -> Sequence[float]:
        return reading

    def _people(self, time_s: Array) -> Array:
        return np.asarray(_FLOOR_AREA_M2[:, None] / office.AREA_PER_PERSON_M2 * self._schedules.occupancy(time_s))

    def _heating_price(self, time_s: Array) -> Array:
        return np.full(time_s.size, tariffs.GAS)

    def _past(self, edges: Array) -> Record:
        self._check_started()
        n = edges.size - 1
        every = whole_steps("history in steps", edges[1] - edges[0], office.STEP_S) if n else 1
        rows = self._samples.rows[-1 - n * every :]

        def means(place: slice) -> Array:
            return np.ascontiguousarray(rows[1:, place].reshape(n, every, 2 * _Z).mean(axis=1).T)

        T_zone, T_out, solar = (rows[::every, place].T.copy() for place in (office.T_ZONE, office.T_OUT, office.SOLAR))
        return Record(
            edges, T_zone, T_out, solar, **self._acting(means(office.HEAT), means(office.POWER)), names=self._names
        )

    def _supplies(self, time_s: Array, rows: Array) -> list[EnergySupply]:
        power = rows[:, office.POWER]
        gas = np.full(time_s.size, tariffs.GAS), np.full(time_s.size, tariffs.GAS_EMISSION_KG_PER_KWH)
        return [
            EnergySupply("GasPower", power[:, :_Z].sum(axis=1), *gas, of_steps=True),
            EnergySupply("ElectricPower", power[:, _Z:].sum(axis=1), *self._bought(time_s), of_steps=True),
        ]

    def _bounds(self, time_s: Array) -> tuple[Array, Array]:
        return self._schedules.bounds_C(time_s)

    def _measured(self, before_s: float) -> Measurement:
        steps, row = round((self._now_s - before_s) / office.STEP_S), self._samples.rows[-1]
        means = self._samples.rows[-steps:].mean(axis=0) if steps else np.full(row.size, math.nan)
        return Measurement(
            time_s=self._now_s,
            T_zone_C=row[office.T_ZONE].copy(),
            T_out_C=float(row[office.T_OUT]),
            solar_W_m2=float(row[office.SOLAR]),
            **self._acting(means[office.HEAT], means[office.POWER]),
            names=self._names,
        )

    def _acting(self, heat_W: Array, power_W: Array) -> dict[str, Any]:
        """Levels, heat and power of each unit, (Z,) or (Z, n), from those of burners and coils, (2 Z,) or (2 Z, n)."""
        heat, power = heat_W[:_Z] + heat_W[_Z:], power_W[:_Z] + power_W[_Z:]
        return {"u": np.clip(heat.T / _FULL_W, self._u_min, 1.0).T, "heat_W": heat, "power_W": power}
