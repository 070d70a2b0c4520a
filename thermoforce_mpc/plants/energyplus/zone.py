"""Single-zone house of the interventional suite as an epJSON dictionary, with its climates and PI loop, and as a plant.

`zone.epJSON` holds all that its variants have in common. The heat enters as `OtherEquipment` (negative for cooling),
partly as radiation, so the room responds as to a radiator or a cooled ceiling; its only source or sink is a callback.
An ideal-loads system would reach the set-point within one step.

The plant adds the electric power of a machine with a fixed fraction of the Carnot efficiency, comfort bounds, tariffs
and a forecast.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, timedelta
from pathlib import Path
from typing import Any, Literal

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, ZERO_C_K, Array, Block, Measurement, PlantInfo, Record
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.energyplus.engine import WEATHER_SENSORS, Reading, Wiring, weather_reading
from thermoforce_mpc.plants.energyplus.process import RUN_DAYS, EnginePlant, SimulatedBuilding
from thermoforce_mpc.plants.kpis import EnergySupply
from thermoforce_mpc.plants.points import interval_means
from thermoforce_mpc.scenario.testcase import EnergyPlusZone, TestCase

EpJson = dict[str, dict[str, dict[str, Any]]]

HVAC = "HVAC"
GAINS = "GAINS"
ZONE = "ZONE"
# A year of 365 days, as TMY3 years, that begins on a Monday.
YEAR = 2018
# Height of the windows, m; share of `ZoneSpec.window_m2`, axis along the wall and middle, m, of each.
_WINDOW_HEIGHT_M = 1.5
_WINDOWS = {"South window": (1.0, "x", 4.0), "West window": (1.0 / 3.0, "y", 3.0)}


@dataclass(frozen=True)
class ZoneSpec:
    """Parameters of a single-zone house.

    Attributes:
        weather: part of the name of the TMY3 file, such as 'Chicago-OHare'.
        mode: 'heating' or 'cooling'.
        capacity_W: maximum heat flow of the source, W thermal.
        insulation_m: thickness of the walls' insulation, m (0.04 W/mK); the roof has 1.5 times as much.
        slab_m: thickness of the concrete floor inside the insulation, m.
        window_m2: area of the south window, m²; the west window has a third of it.
        window_shgc: solar heat gain coefficient of the glazing.
        gains_W: full internal gains, W.
        steps_per_hour: data steps per hour; the source is constant over a step.
        engine_steps_per_hour: zone time steps of the engine, a multiple of `steps_per_hour`. With 15-min ones the
        engine
            subdivides only steps with large changes, so the response to an action would depend on its size.
        floor_area_m2: floor area of the model, m².
    """

    weather: str
    mode: Literal["heating", "cooling"]
    capacity_W: float
    insulation_m: float
    slab_m: float = 0.10
    window_m2: float = 6.0
    window_shgc: float = 0.45
    gains_W: float = 400.0
    steps_per_hour: int = 4
    engine_steps_per_hour: int = 12
    floor_area_m2: float = 48.0

    @property
    def step_s(self) -> float:
        """Length of a data step, s."""
        return 3600.0 / self.steps_per_hour

    @property
    def sign(self) -> int:
        """+1 heating, −1 cooling."""
        return 1 if self.mode == "heating" else -1


def zone_model(spec: ZoneSpec, first_day: int, days: int) -> EpJson:
    """Return the model of `spec` for a run of `days` from `first_day` (0 is 1 January) of a year without leap day."""
    model: EpJson = json.loads(Path(__file__).with_name("zone.epJSON").read_text(encoding="utf-8"))
    begin = date(YEAR, 1, 1) + timedelta(days=first_day)
    for name, day in (("begin", begin), ("end", begin + timedelta(days=days - 1))):
        parts = {"month": day.month, "day_of_month": day.day, "year": day.year}
        model["RunPeriod"]["Run"] |= {f"{name}_{part}": value for part, value in parts.items()}
    model["Timestep"]["Timestep 1"]["number_of_timesteps_per_hour"] = spec.engine_steps_per_hour
    materials = model["Material"]
    materials["Wall insulation"]["thickness"] = materials["Floor insulation"]["thickness"] = spec.insulation_m
    materials["Roof insulation"]["thickness"] = 1.5 * spec.insulation_m
    materials["Slab"]["thickness"] = spec.slab_m
    model["WindowMaterial:SimpleGlazingSystem"]["Glazing"]["solar_heat_gain_coefficient"] = spec.window_shgc
    for name, (share, axis, middle_m) in _WINDOWS.items():
        window, half_m = model["FenestrationSurface:Detailed"][name], share * spec.window_m2 / _WINDOW_HEIGHT_M / 2.0
        for corner in (f"vertex_{i}_{axis}_coordinate" for i in range(1, 5)):
            window[corner] = middle_m + (half_m if window[corner] > middle_m else -half_m)
    return model


ClimateName = Literal["heating_chicago", "cooling_phoenix", "small_office"]

# Hours of the day during which the comfort set-point holds.
COMFORT_H = (5.0, 23.0)


@dataclass(frozen=True)
class Climate:
    """Zone, first day of the probing part (from 0) and set-points of one building.

    `comfort_C` holds from 05:00 to 23:00, which contains every evaluation window with its horizon; `setback_C` at
    night.
    """

    name: ClimateName
    label: str
    spec: ZoneSpec
    first_day: int
    comfort_C: float
    setback_C: float

    @property
    def sign(self) -> int:
        """+1 heating, −1 cooling."""
        return self.spec.sign


CLIMATES: dict[ClimateName, Climate] = {
    "heating_chicago": Climate(
        "heating_chicago",
        "Heating (Chicago)",
        ZoneSpec("Chicago-OHare", "heating", capacity_W=4000.0, insulation_m=0.10),
        first_day=344,  # 11 December
        comfort_C=21.0,
        setback_C=19.0,
    ),
    "cooling_phoenix": Climate(
        "cooling_phoenix",
        "Cooling (Phoenix)",
        ZoneSpec("Phoenix", "cooling", capacity_W=3500.0, insulation_m=0.08, window_shgc=0.35),
        first_day=155,  # 5 June
        comfort_C=25.0,
        setback_C=27.0,
    ),
}


def base_setpoint(climate: Climate, n_days: int) -> Array:
    """Return the occupants' set-points over `n_days` from midnight, °C, one per step."""
    step_h = climate.spec.step_s / HOUR_S
    hour = np.arange(round(n_days * 24 / step_h)) * step_h % 24.0
    comfortable = (hour >= COMFORT_H[0]) & (hour < COMFORT_H[1])
    return np.where(comfortable, climate.comfort_C, climate.setback_C)


def gains(climate: Climate, first_day: int, n_days: int, seed: int) -> Array:
    """Return internal gains as a fraction of the full gains, one per step; a day has the same gains in every run.

    A daily profile times random daily and hourly factors, an unmeasured disturbance for every model.
    """
    step_h = climate.spec.step_s / HOUR_S
    per_day = round(24 / step_h)
    hour = np.arange(per_day) * step_h
    profile = np.where((hour >= 6) & (hour < 9), 0.7, np.where((hour >= 16) & (hour < 23), 0.8, 0.3))
    days = []
    for day in range(first_day, first_day + n_days):
        rng = np.random.default_rng([seed, day])
        hourly = rng.uniform(0.6, 1.4) * rng.lognormal(0.0, 0.4, 24)
        days.append(np.clip(profile * np.repeat(hourly, round(1 / step_h)), 0.0, 2.0))
    return np.concatenate(days)


# PI loop of a zone's own control: u per K, and reset time, s.
_U_PER_K, _RESET_S = 0.35, 5400.0


def _read(value: Mapping[str, float]) -> Reading:
    return weather_reading(value, value["T_zone"])


ZONE_WIRING: Wiring[Reading] = Wiring(
    sensors={"T_zone": ("Zone Mean Air Temperature", ZONE)} | WEATHER_SENSORS,
    actuators={name: ("OtherEquipment", "Power Level", name) for name in (HVAC, GAINS)},
    read=_read,
)


@dataclass(frozen=True)
class ZoneJob:
    """Simulation job from midnight of `first_day`; `setpoint_C` and `gains` (fraction of the full ones) (n_steps,).

    Runs that must be equal up to an intervention need the same length: the engine's results differ by microkelvins
    between run periods with different last days.
    """

    spec: ZoneSpec
    first_day: int
    setpoint_C: Array
    gains: Array

    @property
    def n_steps(self) -> int:
        """Number of steps recorded."""
        return int(self.setpoint_C.size)


class PiPolicy:
    """PI loop on a job's set-points, signed for heating or cooling; its integral is clamped at a limit of u."""

    def __init__(self, job: ZoneJob) -> None:
        self._job, self._sign, self._integral = job, job.spec.sign, 0.0

    def __call__(self, step: int, T_zone_C: float) -> float:
        """Return u of this step."""
        job = self._job
        error = self._sign * (float(job.setpoint_C[max(step, 0)]) - T_zone_C)
        proposed = self._integral + error * _U_PER_K * job.spec.step_s / _RESET_S
        u = _U_PER_K * error + proposed
        if 0.0 <= u <= 1.0:
            self._integral = proposed
        elif u > 1.0:
            u, self._integral = 1.0, min(self._integral, proposed)
        else:
            u, self._integral = 0.0, max(self._integral, proposed)
        return u


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
