"""EnergyPlus zone behind the `Plant` protocol; the engine runs in its own process.

Building, gains and climates are those of the interventional suite. The plant adds the electric power of a machine with
a fixed fraction of the Carnot efficiency, comfort bounds, tariffs and a forecast.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.data import DAY_S, ZERO_C_K, Array, Block, Boundary, Measurement, PlantInfo, Record
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.energyplus.climates import CLIMATES, base_setpoint, gains
from thermoforce_mpc.plants.energyplus.engine import engine_version, file_hash, weather_file
from thermoforce_mpc.plants.energyplus.live import Stretch
from thermoforce_mpc.plants.energyplus.process import RUN_DAYS
from thermoforce_mpc.plants.energyplus.shell import EnginePlant
from thermoforce_mpc.plants.energyplus.simulate import ZONE_WIRING, Job, PiPolicy, Reading, Wiring
from thermoforce_mpc.plants.energyplus.zone import GAINS, HVAC, zone_model
from thermoforce_mpc.plants.kpis import Supply, Violation, building_kpis, excess
from thermoforce_mpc.plants.records import interval_means
from thermoforce_mpc.scenario.testcase import EnergyPlusZone, TestCase

_STEPS_PER_HOUR = 12
_GAINS_SEED = 1


def electric_power_W(zone: EnergyPlusZone, mode: str, heat_W: Array, T_out_C: Array) -> Array:
    """Return the electric power for a heat flow of either sign, W: a fixed fraction of the Carnot efficiency.

    The temperature lift is that between supply and outdoor air, at least `least_lift_K`.
    """
    supply_K = zone.supply_C + ZERO_C_K
    lift = (zone.supply_C - T_out_C) if mode == "heating" else (T_out_C - zone.supply_C)
    return np.asarray(np.abs(heat_W) * np.maximum(lift, zone.least_lift_K) / (zone.carnot_share * supply_K))


@dataclass(frozen=True)
class LiveZone:
    """`Building` of a single zone: told a level in [0, 1], its own control is the PI loop of `simulate`."""

    job: Job

    @property
    def first_day(self) -> int:
        """Day of the year, from 0."""
        return self.job.first_day

    @property
    def step_s(self) -> float:
        """Length of a step, s."""
        return self.job.spec.step_s

    @property
    def n_steps(self) -> int:
        """Length of the run, steps."""
        return self.job.n_steps

    def model(self) -> str:
        """Return the model in epJSON."""
        return json.dumps(zone_model(self.job.spec, self.first_day, math.ceil(self.n_steps * self.step_s / DAY_S)))

    def weather(self) -> Path:
        """Return the weather file."""
        return weather_file(self.job.spec.weather)

    def wiring(self) -> Wiring[Reading]:
        """Return the sensors and actuators of the zone."""
        return ZONE_WIRING

    def acting(self) -> ZoneActing:
        """Return the rule of a new run."""
        return ZoneActing(self.job)


class ZoneActing:
    """`Acting` of a single zone: the heat of its source and the internal gains, W."""

    def __init__(self, job: Job) -> None:
        self._job, self._policy = job, PiPolicy(job)
        self._sign = 1.0 if job.spec.mode == "heating" else -1.0

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

        Raises:
            ConfigError: the test case has no `energyplus` section or not the zone's actuator, or the engine is not
                installed.
        """
        if testcase.energyplus is None:
            raise ConfigError(f"test case '{testcase.name}' has no `energyplus` section: it is of another plant")
        self._zone, self._climate = testcase.energyplus, CLIMATES[testcase.energyplus.climate]
        full_W = self._climate.spec.capacity_W
        maximum = float(getattr(testcase.actuator, "maximum", float("nan")))
        if maximum != full_W:
            raise ConfigError(
                f"test case '{testcase.name}': actuator.maximum is {maximum:g}, but the zone "
                f"'{testcase.energyplus.climate}' has a source of {full_W:g} W at u = 1: write that"
            )
        self._periods = self._zone.periods
        self._spec = replace(self._climate.spec, steps_per_hour=_STEPS_PER_HOUR, engine_steps_per_hour=_STEPS_PER_HOUR)
        super().__init__(testcase, self._spec.weather, **options)

    @property
    def info(self) -> PlantInfo:
        """Building, weather and engine version."""
        return PlantInfo(
            kind="energyplus",
            testcase=self.testcase.name,
            description=f"EnergyPlus zone of {self._spec.floor_area_m2:g} m2 with {self._spec.capacity_W:g} W",
            weather=self._file.stem,
            version=engine_version(),
            details={"weather_sha256": file_hash(self._file)},
        )

    def _building(self, first_day: int) -> LiveZone:
        climate = replace(self._climate, spec=self._spec)
        setpoint_C = base_setpoint(climate, RUN_DAYS) + self._zone.native_margin_K * climate.sign
        return LiveZone(Job(self._spec, first_day, setpoint_C, gains(climate, first_day, RUN_DAYS, _GAINS_SEED)))

    def _demand(self, block: Block) -> float | None:
        return block.u[0]

    def _first_row(self, reading: Reading, T_out_C: float, solar_W_m2: float) -> Array:
        return np.array([reading.T_zone_C, T_out_C, solar_W_m2, 0.0])

    def _rows(self, stretch: Stretch[float, Reading]) -> Array:
        return np.array(
            [
                (reading.T_zone_C, reading.T_out_C, reading.solar_W_m2, level)
                for reading, level in zip(stretch.readings, stretch.acted, strict=True)
            ]
        )

    def _boundary(self, time_s: Array) -> Boundary:
        T_out, solar = self._weather_ahead(time_s)
        lower, upper = self._bounds(time_s)
        return Boundary(
            time_s=time_s,
            T_out_C=T_out,
            solar_W_m2=solar,
            occupancy=np.zeros(time_s.size),
            lower_C=lower,
            upper_C=upper,
            price_per_kWh=self._tariffs[self._price](time_s),
            emission_kg_per_kWh=np.full(time_s.size, tariffs.EMISSION_KG_PER_KWH),
        )

    def _past(self, edges: Array) -> Record:
        record = self._record()
        T_zone, T_out, solar = (np.interp(edges, record["time"], record[name]) for name in ("T", "T_out", "solar"))
        u, power, heat = (interval_means(record, [name], edges) for name in ("u", "power", "heat"))
        return Record(edges, T_zone, T_out, solar, u, power, heat)

    def kpis(self) -> dict[str, float]:
        """Return BOPTEST's KPIs of energy and thermal comfort since the end of the warm-up, from the 5-min record."""
        record = self._record()
        scored = record["time"] >= self._start_s - 1e-6
        time_s = record["time"][scored]
        if time_s.size < 2:
            return dict.fromkeys(("ener_tot", "cost_tot", "emis_tot", "tdis_tot", "pele_tot"), 0.0)
        lower, upper = self._bounds(time_s)
        return building_kpis(
            time_s,
            supplies=[
                Supply(
                    "ElectricPower",
                    record["power"][scored],
                    self._tariffs[self._price](time_s),
                    np.full(time_s.size, tariffs.EMISSION_KG_PER_KWH),
                    of_steps=True,
                )
            ],
            thermal=[Violation("1", excess(record["T"][scored], lower, upper))],
            air_quality=[],
            area_m2=self.testcase.area_m2,
        )

    def _bounds(self, time_s: Array) -> tuple[Array, Array]:
        """Return comfort bounds, °C: the suite's set-points on the machine's side, `band_K` beyond on the other."""
        step_s = self._spec.step_s
        day = base_setpoint(replace(self._climate, spec=self._spec), 1)
        index = np.floor(np.mod(time_s, DAY_S) / step_s + 1e-6).astype(int) % day.size
        machine, other = day[index], self._climate.comfort_C + self._climate.sign * self._zone.band_K
        far = np.full(time_s.size, other)
        return (machine, far) if self._climate.sign > 0 else (far, machine)

    def _record(self, last: int = 0) -> dict[str, Array]:
        """Return the record by name, all of it or the `last` samples; power and heat of the step that ends at each."""
        self._check_started()
        rows = self._samples.rows[-last:]
        heat = self._climate.sign * self._spec.capacity_W * rows[:, 3]
        return {
            "time": self._samples.times[-last:],
            "T": rows[:, 0],
            "T_out": rows[:, 1],
            "solar": rows[:, 2],
            "u": rows[:, 3],
            "heat": heat,
            "power": electric_power_W(self._zone, self.testcase.mode, heat, rows[:, 1]),
        }

    def _measured(self, before_s: float) -> Measurement:
        n = round((self._now_s - before_s) / self._spec.step_s)
        record = self._record(n + 1)
        names = ("T", "T_out", "solar")
        T, T_out, solar = (float(record[name][-1]) for name in names)
        T_zone = np.array([T])
        m = self.testcase.metered
        points = {
            m.zone_temperature: T + ZERO_C_K,
            m.outdoor_temperature: T_out + ZERO_C_K,
            m.solar: solar,
            m.electric_power[0]: float(record["power"][-1]),
        }
        if before_s >= self._now_s:
            return Measurement(self._now_s, T_zone, T_out, solar, points=points)
        edges = np.array([before_s, self._now_s])
        u, power, heat = (interval_means(record, [name], edges) for name in ("u", "power", "heat"))
        return Measurement(self._now_s, T_zone, T_out, solar, u, power, heat, points=points)
