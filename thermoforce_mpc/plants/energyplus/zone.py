"""Single-zone house as an epJSON dictionary, whose only heat source or sink a callback sets; its climates and PI loop.

`zone.epJSON` holds all that its variants have in common. The heat enters as `OtherEquipment` (negative for cooling),
partly as radiation, so the room responds as to a radiator or a cooled ceiling. An ideal-loads system would reach the
set-point within one step.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from typing import Any, Literal

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.plants.energyplus.engine import WEATHER_SENSORS, Reading, Wiring, weather_reading

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
