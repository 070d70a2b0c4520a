"""The two EnergyPlus buildings: zones, climates, set-points and internal gains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.plants.energyplus.zone import ZoneSpec

ClimateName = Literal["heating_chicago", "cooling_phoenix", "small_office"]

# Hours of the day during which the comfort set-point holds.
COMFORT_H = (5.0, 23.0)


@dataclass(frozen=True)
class Climate:
    """Zone, first day of the probing part (day of the year, from 0) and set-points of one building.

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
        return 1 if self.spec.mode == "heating" else -1


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
