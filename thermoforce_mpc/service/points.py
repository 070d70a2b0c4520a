"""Every point of the test case: names, units and limits at the wire (BOPTEST test case documentation), and values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.plants.embedded import EmbeddedPlant, schedule
from thermoforce_mpc.plants.embedded.emulator import MEASUREMENTS, OVERWRITES
from thermoforce_mpc.service.weather_signals import WEATHER_SIGNALS, measurement_name
from thermoforce_mpc.types import Array

_KELVIN = 273.15
# Occupants' gains, W a person: 60 % of the sensible part radiates.
_RADIANT_W, _CONVECTIVE_W, _LATENT_W = 43.8, 29.2, 45.0


@dataclass(frozen=True)
class PointInfo:
    """What the service tells about a point."""

    unit: str | None
    description: str
    minimum: float | None = None
    maximum: float | None = None

    def as_json(self, *, limits: bool) -> dict[str, str | float | None]:
        """With limits for inputs and measurements, without for forecast points."""
        said: dict[str, str | float | None] = {"Description": self.description, "Unit": self.unit}
        return said | {"Minimum": self.minimum, "Maximum": self.maximum} if limits else said


_OVERWRITE_TEXT = {
    "oveHeaPumY": ("1", "Heat pump modulating signal for compressor speed, 0 (off) to 1 (full capacity)"),
    "oveTSet": ("K", "Zone operative temperature set-point"),
    "ovePum": ("1", "Emission circuit pump, off (0) or on (1)"),
    "oveFan": ("1", "Heat pump evaporator fan, off (0) or on (1)"),
}
# Column of the emulator's record that holds the signal in force, whoever decided it.
INPUT_COLUMNS = {"oveHeaPumY_u": "level", "oveTSet_u": "T_setpoint", "ovePum_u": "pump", "oveFan_u": "fan"}

INPUTS: dict[str, PointInfo] = {}
for _name, _low, _high in OVERWRITES:
    _unit, _text = _OVERWRITE_TEXT[_name]
    INPUTS[f"{_name}_u"] = PointInfo(_unit, _text, _low, _high)
    INPUTS[f"{_name}_activate"] = PointInfo(None, f"1 overwrites with {_name}_u, 0 leaves it to native control", 0, 1)

_MEASUREMENT_TEXT = {
    "reaTZon_y": ("K", "Zone operative temperature"),
    "reaPHeaPum_y": ("W", "Heat pump electrical power"),
    "reaPFan_y": ("W", "Electrical power of the heat pump evaporator fan"),
    "reaPPumEmi_y": ("W", "Emission circuit pump electrical power"),
    "reaQHeaPumCon_y": ("W", "Heat pump thermal power exchanged in the condenser"),
    "reaQFloHea_y": ("W", "Floor heating thermal power released to the zone"),
    "reaTSup_y": ("K", "Supply water temperature to the radiant floor"),
    "reaTRet_y": ("K", "Return water temperature from the radiant floor"),
    "reaCOP_y": ("1", "Heat pump COP"),
    "reaTSetHea_y": ("K", "Zone operative temperature set-point for heating"),
    "reaCO2RooAir_y": ("ppm", "CO2 concentration in the zone"),
}
_EVAPORATOR, _COOLING = "reaQHeaPumEva_y", "reaTSetCoo_y"
_STATION = {measurement_name(signal): signal for signal in WEATHER_SIGNALS}

MEASUREMENT_POINTS: dict[str, PointInfo] = dict(
    sorted(
        {
            **{name: PointInfo(unit, text) for name, (unit, text) in _MEASUREMENT_TEXT.items()},
            _EVAPORATOR: PointInfo(
                "W", "Heat pump thermal power exchanged in the evaporator (negative: out of the air)"
            ),
            _COOLING: PointInfo("K", "Zone operative temperature set-point for cooling"),
            **{
                name: PointInfo(WEATHER_SIGNALS[signal].unit, f"{WEATHER_SIGNALS[signal].description} measurement")
                for name, signal in _STATION.items()
            },
        }.items()
    )
)


def recorded_points(plant: EmbeddedPlant, names: list[str], start_s: float, final_s: float) -> dict[str, Array]:
    """Recorded samples of measurements and inputs between two times, with 'time'; names must be known."""
    record = plant.recorded(start_s, final_s)
    time_s = record["time"]

    def series(name: str) -> Array:
        if name in INPUT_COLUMNS:
            return record[INPUT_COLUMNS[name]]
        if name in MEASUREMENTS:
            return record[MEASUREMENTS[name]]
        if name in _STATION:
            return WEATHER_SIGNALS[_STATION[name]].at(plant.weather, time_s)
        if name == _EVAPORATOR:
            return -record["Q_evaporator"]
        # Left is the cooling set-point, which nothing follows in a house without cooling.
        return schedule.bounds_C(time_s)[1] + _KELVIN

    return {name: series(name) for name in names} | {"time": time_s}


_People = Callable[[Array], Array]


def _per_person(watts: float) -> _People:
    return lambda time_s: schedule.PEOPLE * watts * schedule.occupied_sample(time_s)


_FORECAST_CLOCK: Mapping[str, tuple[PointInfo, _People]] = {
    "Occupancy[1]": (PointInfo("number of people", "Number of occupants of the zone"), _per_person(1.0)),
    "InternalGainsRad[1]": (PointInfo("W", "Radiative internal gains of the zone"), _per_person(_RADIANT_W)),
    "InternalGainsCon[1]": (PointInfo("W", "Convective internal gains of the zone"), _per_person(_CONVECTIVE_W)),
    "InternalGainsLat[1]": (PointInfo("W", "Latent internal gains of the zone"), _per_person(_LATENT_W)),
    "LowerSetp[1]": (PointInfo("K", "Lower comfort bound"), lambda t: schedule.bounds_C(t)[0] + _KELVIN),
    "UpperSetp[1]": (PointInfo("K", "Upper comfort bound"), lambda t: schedule.bounds_C(t)[1] + _KELVIN),
    "UpperCO2[1]": (PointInfo("ppm", "Upper CO2 bound"), lambda t: np.full(t.shape, schedule.CO2_LIMIT_PPM)),
    "EmissionsElectricPower": (
        PointInfo("kgCO2/kWh", "CO2 emitted to produce one kWh of electricity"),
        lambda t: np.full(t.shape, tariffs.EMISSION_KG_PER_KWH),
    ),
}
_PRICES = {
    "PriceElectricPowerConstant": "constant",
    "PriceElectricPowerDynamic": "dynamic",
    "PriceElectricPowerHighlyDynamic": "highly_dynamic",
}

FORECAST_POINTS: dict[str, PointInfo] = dict(
    sorted(
        {
            **{name: info for name, (info, _) in _FORECAST_CLOCK.items()},
            **{
                name: PointInfo("($/Euro)/kWh", f"Electricity price, {tariff} tariff")
                for name, tariff in _PRICES.items()
            },
            **{name: PointInfo(signal.unit, signal.description) for name, signal in WEATHER_SIGNALS.items()},
        }.items()
    )
)


def forecast_points(plant: EmbeddedPlant, names: list[str], horizon_s: float, interval_s: float) -> dict[str, Array]:
    """Forecast of each point from now, with 'time'; dry bulb and global irradiance carry the scenario's errors."""
    steps = np.arange(int(horizon_s / interval_s + 1e-9) + 1, dtype=np.float64)
    time_s: Array = plant.now_s + steps * interval_s
    erring: dict[str, Array] = {}
    if {"TDryBul", "HGloHor"} & set(names) and horizon_s >= interval_s:
        boundary = plant.forecast(horizon_s, interval_s)
        erring = {"TDryBul": boundary.T_out_C + _KELVIN, "HGloHor": boundary.solar_W_m2}

    def series(name: str) -> Array:
        if name in erring:
            return erring[name]
        if name in _PRICES:
            return plant.tariff(_PRICES[name])(time_s)
        if name in _FORECAST_CLOCK:
            return np.asarray(_FORECAST_CLOCK[name][1](time_s), dtype=np.float64)
        return WEATHER_SIGNALS[name].at(plant.weather, time_s)

    return {name: series(name) for name in names} | {"time": time_s}
