"""EnergyPlus zone behind the `Plant` protocol: the building, gains and climates of the interventional suite.

The plant adds the electric power of a machine with a fixed fraction of the Carnot efficiency, comfort bounds, tariffs
and a forecast.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from thermoforce_mpc.data import DAY_S, ZERO_C_K, Array, Block, Measurement, PlantInfo, Record
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.energyplus.engine import Reading
from thermoforce_mpc.plants.energyplus.process import RUN_DAYS, EnginePlant, SimulatedBuilding
from thermoforce_mpc.plants.energyplus.zone import (
    CLIMATES,
    GAINS,
    HVAC,
    ZONE_WIRING,
    PiPolicy,
    ZoneJob,
    base_setpoint,
    gains,
    zone_model,
)
from thermoforce_mpc.plants.kpis import EnergySupply
from thermoforce_mpc.plants.records import interval_means
from thermoforce_mpc.scenario.testcase import EnergyPlusZone, TestCase

_STEPS_PER_HOUR = 12
_GAINS_SEED = 1


def electric_power_W(zone: EnergyPlusZone, mode: str, heat_W: Array, T_out_C: Array) -> Array:
    """Return electric power for heat of either sign, W: a share of Carnot's, at a lift of `least_lift_K` or more."""
    supply_K = zone.supply_C + ZERO_C_K
    lift = (zone.supply_C - T_out_C) if mode == "heating" else (T_out_C - zone.supply_C)
    return np.asarray(np.abs(heat_W) * np.maximum(lift, zone.least_lift_K) / (zone.carnot_share * supply_K))


class ZoneActing:
    """`acting` of a single zone, told a level in [0, 1]: the heat of its source and the internal gains, W."""

    def __init__(self, job: ZoneJob) -> None:
        self._job, self._policy = job, PiPolicy(job)
        self._sign = job.spec.sign

    def __call__(self, step: int, demand: float | None, last: Reading | None) -> tuple[dict[str, float], float]:
        """Return the heat of each actuated source, W, and the level; the PI loop runs on while a level is told."""
        spec = self._job.spec
        native = self._policy(step, last.T_zone_C if last else float(self._job.setpoint_C[0]))
        u = native if demand is None else demand
        gains = float(self._job.gains[max(step, 0)])
        return {HVAC: self._sign * u * spec.capacity_W, GAINS: gains * spec.gains_W}, u


class EnergyPlusPlant(EnginePlant[float, Reading]):
    """EnergyPlus zone of the interventional suite.

    ```python
    with EnergyPlusPlant(load_testcase("energyplus:heating_chicago")) as plant:
        plant.reset(start_s=10 * 86400, warmup_s=7 * 86400)
        measurement = plant.advance(u=0.5, duration_s=900)
    ```
    """

    def __init__(self, testcase: TestCase, **options: Any) -> None:
        """`options`: see `EnginePlant`.

        Raises `ConfigError` where the test case has no `energyplus` section or not the zone's actuator, or the engine
        is missing.
        """
        if testcase.energyplus is None:
            raise ConfigError(f"test case '{testcase.name}' has no `energyplus` section: it is of another plant")
        self._zone = testcase.energyplus
        full_W = CLIMATES[self._zone.climate].spec.capacity_W
        maximum = float(getattr(testcase.actuator, "maximum", math.nan))
        if maximum != full_W:
            raise ConfigError(
                f"test case '{testcase.name}': actuator.maximum is {maximum:g}, but the zone "
                f"'{self._zone.climate}' has a source of {full_W:g} W at u = 1: write that"
            )
        self._periods = self._zone.periods
        spec = CLIMATES[self._zone.climate].spec
        self._spec = replace(spec, steps_per_hour=_STEPS_PER_HOUR, engine_steps_per_hour=_STEPS_PER_HOUR)
        self._climate = replace(CLIMATES[self._zone.climate], spec=self._spec)
        super().__init__(testcase, self._spec.weather, **options)

    @property
    def info(self) -> PlantInfo:
        """Building, weather and engine version."""
        what = f"EnergyPlus zone of {self._spec.floor_area_m2:g} m2 with {self._spec.capacity_W:g} W"
        return self._info(self.testcase.name, what)

    def _building(self, first_day: int) -> SimulatedBuilding[float, Reading]:
        climate, spec = self._climate, self._spec
        setpoint_C = base_setpoint(climate, RUN_DAYS) + self._zone.native_margin_K * spec.sign
        job = ZoneJob(spec, first_day, setpoint_C, gains(climate, first_day, RUN_DAYS, _GAINS_SEED))
        model = json.dumps(zone_model(spec, first_day, RUN_DAYS))
        return SimulatedBuilding(first_day, spec.step_s, job.n_steps, model, self._file, ZONE_WIRING, ZoneActing(job))

    def _demand(self, block: Block) -> float | None:
        return block.u[0]

    def _row(self, reading: Reading, acted: float | None) -> Sequence[float]:
        return reading.T_zone_C, reading.T_out_C, reading.solar_W_m2, acted or 0.0

    def _people(self, time_s: Array) -> Array:
        return np.zeros((1, time_s.size))

    def _past(self, edges: Array) -> Record:
        record = self._record()
        T_zone, T_out, solar = (np.interp(edges, record["time"], record[name]) for name in ("T", "T_out", "solar"))
        return Record(edges, T_zone, T_out, solar, **self._means(record, edges))

    def _heat_and_power(self, rows: Array) -> tuple[Array, Array]:
        """Heat and electric power of the step that ends at each sample, W."""
        heat_W = self._spec.sign * self._spec.capacity_W * rows[:, 3]
        return heat_W, electric_power_W(self._zone, self.testcase.mode, heat_W, rows[:, 1])

    def _supplies(self, time_s: Array, rows: Array) -> list[EnergySupply]:
        return [EnergySupply("ElectricPower", self._heat_and_power(rows)[1], *self._bought(time_s), of_steps=True)]

    def _bounds(self, time_s: Array) -> tuple[Array, Array]:
        """The suite's set-points on the machine's side, `band_K` beyond on the other."""
        day = base_setpoint(self._climate, 1)
        machine = day[np.floor(np.mod(time_s, DAY_S) / self._spec.step_s + 1e-6).astype(int) % day.size]
        far = np.full(time_s.size, self._climate.comfort_C + self._spec.sign * self._zone.band_K)
        return (machine, far) if self._spec.sign > 0 else (far, machine)

    def _record(self, last: int = 0) -> dict[str, Array]:
        """The record by name, all of it or the `last` samples."""
        self._check_started()
        rows = self._samples.rows[-last:]
        names = ("T", "T_out", "solar", "u", "heat", "power")
        columns = (*rows.T, *self._heat_and_power(rows))
        return {"time": self._samples.times[-last:], **dict(zip(names, columns, strict=True))}

    def _measured(self, before_s: float) -> Measurement:
        n = round((self._now_s - before_s) / self._spec.step_s)
        record = self._record(n + 1)
        T, T_out, solar = (float(record[name][-1]) for name in ("T", "T_out", "solar"))
        m = self.testcase.metered
        points = {
            m.zone_temperature: T + ZERO_C_K,
            m.outdoor_temperature: T_out + ZERO_C_K,
            m.solar: solar,
            m.electric_power[0]: float(record["power"][-1]),
        }
        now = Measurement(self._now_s, np.array([T]), T_out, solar, points=points)
        return replace(now, **self._means(record, np.array([before_s, self._now_s]))) if n else now

    def _means(self, record: dict[str, Array], edges: Array) -> dict[str, Any]:
        names = {"u": "u", "power_W": "power", "heat_W": "heat"}
        return {name: interval_means(record, [column], edges) for name, column in names.items()}
