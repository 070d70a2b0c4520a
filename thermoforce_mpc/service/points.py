"""Points of the test case: names, units and limits as in BOPTEST's documentation, and their values."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.data import HOUR_S, ZERO_C_K, Array
from thermoforce_mpc.plants.embedded import EmbeddedPlant, schedule
from thermoforce_mpc.plants.embedded.emulator import MEASUREMENTS, OVERWRITES
from thermoforce_mpc.service import descriptions
from thermoforce_mpc.service.weather_signals import WEATHER_SIGNALS, measurement_name

# Occupants' gains, W per person: 60 % of the sensible part is radiative.
_RADIANT_W, _CONVECTIVE_W, _LATENT_W = 43.8, 29.2, 45.0


@dataclass(frozen=True)
class PointInfo:
    """Unit, description and limits of a point."""

    unit: str | None
    description: str
    minimum: float | None = None
    maximum: float | None = None

    def as_json(self, *, limits: bool) -> dict[str, str | float | None]:
        """As JSON object, with limits (inputs and measurements) or without (forecast points)."""
        content: dict[str, str | float | None] = {"Description": self.description, "Unit": self.unit}
        return content | {"Minimum": self.minimum, "Maximum": self.maximum} if limits else content


_OVERWRITE_UNIT = {"oveHeaPumY": "1", "oveTSet": "K", "ovePum": "1", "oveFan": "1"}
# Column of the emulator's record with the applied signal, overwritten or native.
INPUT_COLUMNS = {"oveHeaPumY_u": "level", "oveTSet_u": "T_setpoint", "ovePum_u": "pump", "oveFan_u": "fan"}

INPUTS: dict[str, PointInfo] = {}
for _name, _low, _high in OVERWRITES:
    _text = descriptions.OVERWRITES[_name]
    INPUTS[f"{_name}_u"] = PointInfo(_OVERWRITE_UNIT[_name], _text, _low, _high)
    INPUTS[f"{_name}_activate"] = PointInfo(None, f"Activation for {_text}")

_MEASUREMENT_UNIT = {
    "reaTZon_y": "K",
    "reaPHeaPum_y": "W",
    "reaPFan_y": "W",
    "reaPPumEmi_y": "W",
    "reaQHeaPumCon_y": "W",
    "reaQHeaPumEva_y": "W",  # negative: heat taken from the air
    "reaQFloHea_y": "W",
    "reaTSup_y": "K",
    "reaTRet_y": "K",
    "reaCOP_y": "1",
    "reaTSetHea_y": "K",
    "reaTSetCoo_y": "K",
    "reaCO2RooAir_y": "ppm",
}
_EVAPORATOR = "reaQHeaPumEva_y"
_SET_POINTS = ("reaTSetHea_y", "reaTSetCoo_y")
_STATION = {measurement_name(signal): signal for signal in WEATHER_SIGNALS}

MEASUREMENT_POINTS: dict[str, PointInfo] = dict(
    sorted(
        {
            **{name: PointInfo(unit, descriptions.MEASUREMENTS[name]) for name, unit in _MEASUREMENT_UNIT.items()},
            **{
                name: PointInfo(WEATHER_SIGNALS[signal].unit, descriptions.STATION[signal])
                for name, signal in _STATION.items()
            },
        }.items()
    )
)


def recorded_points(plant: EmbeddedPlant, names: list[str], record: Mapping[str, Array]) -> dict[str, Array]:
    """Values of measurements and inputs, (n,), at the n samples of a plant record, with 'time'; names must be known."""
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
        # Remaining: the set-points of the schedule. The heating control follows its set-point with an offset or an
        # overwrite; the cooling set-point has no effect, since the house has no cooling.
        return schedule.set_points_C(schedule.occupied(time_s))[_SET_POINTS.index(name)] + ZERO_C_K

    return {name: series(name) for name in names} | {"time": time_s}


_People = Callable[[Array], Array]


def _per_person(watts: float) -> _People:
    return lambda time_s: schedule.PEOPLE * watts * schedule.occupied_sample(time_s)


# Unit and value at times (n,), s, of the points that depend on time alone.
_FORECAST_CLOCK: Mapping[str, tuple[str, _People]] = {
    "Occupancy[1]": ("number of people", _per_person(1.0)),
    "InternalGainsRad[1]": ("W", _per_person(_RADIANT_W)),
    "InternalGainsCon[1]": ("W", _per_person(_CONVECTIVE_W)),
    "InternalGainsLat[1]": ("W", _per_person(_LATENT_W)),
    "LowerSetp[1]": ("K", lambda t: schedule.bounds_C(t)[0] + ZERO_C_K),
    "UpperSetp[1]": ("K", lambda t: schedule.bounds_C(t)[1] + ZERO_C_K),
    "UpperCO2[1]": ("ppm", lambda t: np.full(t.shape, schedule.CO2_LIMIT_PPM)),
    "EmissionsElectricPower": ("kgCO2/kWh", lambda t: np.full(t.shape, tariffs.EMISSION_KG_PER_KWH)),
}
_PRICES = {
    "PriceElectricPowerConstant": "constant",
    "PriceElectricPowerDynamic": "dynamic",
    "PriceElectricPowerHighlyDynamic": "highly_dynamic",
}

_FORECAST_UNIT = (
    {name: unit for name, (unit, _) in _FORECAST_CLOCK.items()}
    | dict.fromkeys(_PRICES, "($/Euro)/kWh")
    | {name: signal.unit for name, signal in WEATHER_SIGNALS.items()}
)
FORECAST_POINTS = {name: PointInfo(_FORECAST_UNIT[name], text) for name, text in descriptions.FORECAST.items()}


def forecast_points(
    plant: EmbeddedPlant, names: list[str], horizon_s: float, interval_s: float, erring_names: Collection[str] = ()
) -> dict[str, Array]:
    """Forecast of each point from now, with 'time'; `erring_names`: which of TDryBul and HGloHor have errors.

    Raises `InputError` where one of these is asked for beyond 48 h.
    """
    steps = np.arange(int(horizon_s / interval_s + 1e-9) + 1, dtype=np.float64)
    time_s: Array = plant.now_s + steps * interval_s
    erring: dict[str, Array] = {}
    if set(erring_names) & set(names):
        # A plant forecasts one interval at least; here the present alone may be asked for.
        boundary = plant.forecast(*((horizon_s, interval_s) if steps.size > 1 else (HOUR_S, HOUR_S)))
        series_of = {"TDryBul": boundary.T_out_C + ZERO_C_K, "HGloHor": boundary.solar_W_m2}
        erring = {name: series_of[name][: steps.size] for name in erring_names}

    def series(name: str) -> Array:
        if name in erring:
            return erring[name]
        if name in _PRICES:
            return plant.tariff(_PRICES[name])(time_s)
        if name in _FORECAST_CLOCK:
            return np.asarray(_FORECAST_CLOCK[name][1](time_s), dtype=np.float64)
        return WEATHER_SIGNALS[name].at(plant.weather, time_s)

    return {name: series(name) for name in names} | {"time": time_s}
