"""Points of the test case: names, units and limits as in BOPTEST's documentation, and their values."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import psychrolib

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.weather.solar import Sun, sun_position
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import HOUR_S, YEAR_S, ZERO_C_K, Array
from thermoforce_mpc.plants.embedded import EmbeddedPlant, schedule
from thermoforce_mpc.plants.embedded.emulator import MEASUREMENTS, OVERWRITES

# Descriptions are part of the protocol: verbatim, typing errors included, from the replies of BOPTEST
# (github.com/ibpsa/project1-boptest) to /inputs, /measurements and /forecast_points of this test case.
_OVERWRITES = {
    "oveHeaPumY": (
        "1",
        "Heat pump modulating signal for compressor speed between 0 (not working) and 1 (working at maximum capacity)",
    ),
    "oveTSet": ("K", "Zone operative temperature setpoint"),
    "ovePum": ("1", "Integer signal to control the emission circuit pump either on or off"),
    "oveFan": ("1", "Integer signal to control the heat pump evaporator fan either on or off"),
}
_MEASUREMENTS = {
    "reaTZon_y": ("K", "Zone operative temperature"),
    "reaPHeaPum_y": ("W", "Heat pump electrical power"),
    "reaPFan_y": ("W", "Electrical power of the heat pump evaporator fan"),
    "reaPPumEmi_y": ("W", "Emission circuit pump electrical power"),
    "reaQHeaPumCon_y": ("W", "Heat pump thermal power exchanged in the condenser"),
    "reaQHeaPumEva_y": ("W", "Heat pump thermal power exchanged in the evaporator"),
    "reaQFloHea_y": ("W", "Floor heating thermal power released to the zone"),
    "reaTSup_y": ("K", "Supply water temperature to radiant floor"),
    "reaTRet_y": ("K", "Return water temperature from radiant floor"),
    "reaCOP_y": ("1", "Heat pump COP"),
    "reaTSetHea_y": ("K", "Zone operative temperature setpoint for heating"),
    "reaTSetCoo_y": ("K", "Zone operative temperature setpoint for cooling"),
    "reaCO2RooAir_y": ("ppm", "CO2 concentration in the zone"),
}
# Weather station; keys are the forecast names of the signals.
_STATION = {
    "HDifHor": "Horizontal diffuse solar radiation measurement",
    "HDirNor": "Direct normal radiation measurement",
    "HGloHor": "Global horizontal solar irradiation measurement",
    "HHorIR": "Horizontal infrared irradiation measurement",
    "TBlaSky": "Black-body sky temperature measurement",
    "TDewPoi": "Dew point temperature measurement",
    "TDryBul": "Outside drybulb temperature measurement",
    "TWetBul": "Wet bulb temperature measurement",
    "ceiHei": "Cloud cover ceiling height measurement",
    "cloTim": "Day number with units of seconds",
    "lat": "Latitude of the location",
    "lon": "Longitude of the location",
    "nOpa": "Opaque sky cover measurement",
    "nTot": "Sky cover measurement",
    "pAtm": "Atmospheric pressure measurement",
    "relHum": "Outside relative humidity measurement",
    "solAlt": "Solar altitude angle measurement",
    "solDec": "Solar declination angle measurement",
    "solHouAng": "Solar hour angle measurement",
    "solTim": "Solar time",
    "solZen": "Solar zenith angle measurement",
    "winDir": "Wind direction measurement",
    "winSpe": "Wind speed measurement",
}
_FORECAST = {
    "EmissionsElectricPower": "Kilograms of carbon dioxide to produce 1 kWh of electricity",
    "HDifHor": "Horizontal diffuse solar radiation",
    "HDirNor": "Direct normal radiation",
    "HGloHor": "Horizontal global radiation",
    "HHorIR": "Horizontal infrared irradiation",
    "InternalGainsCon[1]": "Convective internal gains of zone",
    "InternalGainsLat[1]": "Latent internal gains of zone",
    "InternalGainsRad[1]": "Radiative internal gains of zone",
    "LowerSetp[1]": "Lower temperature set point for thermal comfort of zone",
    "Occupancy[1]": "Number of occupants of zone",
    "PriceElectricPowerConstant": "Completely constant electricity price",
    "PriceElectricPowerDynamic": "Electricity price for a day/night tariff",
    "PriceElectricPowerHighlyDynamic": "Spot electricity price",
    "TBlaSky": "Black Sky temperature",
    "TDewPoi": "Dew point temperature",
    "TDryBul": "Dry bulb temperature at ground level",
    "TWetBul": "Wet bulb temperature",
    "UpperCO2[1]": "Upper CO2 set point for indoor air quality of zone",
    "UpperSetp[1]": "Upper temperature set point for thermal comfort of zone",
    "ceiHei": "Ceiling height",
    "cloTim": "One-based day number in seconds",
    "lat": "Latitude of the location",
    "lon": "Longitude of the location",
    "nOpa": "Opaque sky cover [0, 1]",
    "nTot": "Total sky Cover [0, 1]",
    "pAtm": "Atmospheric pressure",
    "relHum": "Relative Humidity",
    "solAlt": "Altitude angel",
    "solDec": "Declination angle",
    "solHouAng": "Solar hour angle.",
    "solTim": "Solar time",
    "solZen": "Zenith angle",
    "winDir": "Wind direction",
    "winSpe": "Wind speed",
}


# The test case's weather reader takes the pressure from a parameter, not from the file.
_PRESSURE_PA = 101_325.0
psychrolib.SetUnitSystem(psychrolib.SI)


class WeatherSignal(NamedTuple):
    """Weather signal: unit, and function of its values (n,) at times (n,), s."""

    unit: str
    at: Callable[[Weather, Array], Array]


def _column(name: str, shift: float = 0.0) -> Callable[[Weather, Array], Array]:
    return lambda weather, time_s: weather.at(name, time_s) + shift


def _constant(value: Callable[[Weather], float]) -> Callable[[Weather, Array], Array]:
    return lambda weather, time_s: np.full(np.shape(time_s), value(weather))


def _sun(weather: Weather, time_s: Array) -> Sun:
    return sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)


def _wet_bulb_K(weather: Weather, time_s: Array) -> Array:
    """Wet bulb temperature, K, from dry bulb, relative humidity and pressure (ASHRAE Fundamentals 2017, ch. 1)."""
    dry_C, humidity = weather.at("T_dry_C", time_s), weather.at("relative_humidity", time_s)
    return np.asarray(psychrolib.GetTWetBulbFromRelHum(dry_C, humidity, _PRESSURE_PA)) + ZERO_C_K


# Keys: forecast names.
WEATHER_SIGNALS: dict[str, WeatherSignal] = {
    "HDifHor": WeatherSignal("W/m2", _column("diffuse_W_m2")),
    "HDirNor": WeatherSignal("W/m2", _column("normal_W_m2")),
    "HGloHor": WeatherSignal("W/m2", _column("global_W_m2")),
    "HHorIR": WeatherSignal("W/m2", _column("infrared_W_m2")),
    "TBlaSky": WeatherSignal("K", lambda w, t: w.sky_temperature_C(t) + ZERO_C_K),
    "TDewPoi": WeatherSignal("K", _column("T_dew_C", ZERO_C_K)),
    "TDryBul": WeatherSignal("K", _column("T_dry_C", ZERO_C_K)),
    "TWetBul": WeatherSignal("K", _wet_bulb_K),
    "ceiHei": WeatherSignal("m", _column("ceiling_m")),
    "cloTim": WeatherSignal("s", lambda _, t: np.asarray(t % YEAR_S)),
    "lat": WeatherSignal("rad", _constant(lambda w: float(np.deg2rad(w.latitude_deg)))),
    "lon": WeatherSignal("rad", _constant(lambda w: float(np.deg2rad(w.longitude_deg)))),
    "nOpa": WeatherSignal("1", _column("opaque_cover")),
    "nTot": WeatherSignal("1", _column("total_cover")),
    "pAtm": WeatherSignal("Pa", _constant(lambda _: _PRESSURE_PA)),
    "relHum": WeatherSignal("1", _column("relative_humidity")),
    "solAlt": WeatherSignal("rad", lambda w, t: np.pi / 2 - _sun(w, t).zenith),
    "solDec": WeatherSignal("rad", lambda w, t: _sun(w, t).declination),
    # Not wrapped to ±π: like solar time, it increases from day to day.
    "solHouAng": WeatherSignal("rad", lambda w, t: _sun(w, t).hour_angle),
    "solTim": WeatherSignal("s", lambda w, t: np.asarray((_sun(w, t).hour_angle * 24.0 / (2 * np.pi) + 12.0) * HOUR_S)),
    "solZen": WeatherSignal("rad", lambda w, t: _sun(w, t).zenith),
    "winDir": WeatherSignal("rad", _column("wind_from_rad")),
    "winSpe": WeatherSignal("m/s", _column("wind_m_s")),
}


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


# Column of the emulator's record with the applied signal, overwritten or native.
INPUT_COLUMNS = {"oveHeaPumY_u": "level", "oveTSet_u": "T_setpoint", "ovePum_u": "pump", "oveFan_u": "fan"}

INPUTS: dict[str, PointInfo] = {}
for _name, _low, _high in OVERWRITES:
    _unit, _text = _OVERWRITES[_name]
    INPUTS[f"{_name}_u"] = PointInfo(_unit, _text, _low, _high)
    INPUTS[f"{_name}_activate"] = PointInfo(None, f"Activation for {_text}")

_EVAPORATOR = "reaQHeaPumEva_y"
_SET_POINTS = ("reaTSetHea_y", "reaTSetCoo_y")
# Forecast names of the signals of the weather station, by the names of its measurements.
_MEASURED = {f"weaSta_reaWea{signal[0].upper()}{signal[1:]}_y": signal for signal in WEATHER_SIGNALS}

MEASUREMENT_POINTS = {name: PointInfo(*told) for name, told in _MEASUREMENTS.items()}
MEASUREMENT_POINTS |= {name: PointInfo(WEATHER_SIGNALS[of].unit, _STATION[of]) for name, of in _MEASURED.items()}
MEASUREMENT_POINTS = dict(sorted(MEASUREMENT_POINTS.items()))


def recorded_points(plant: EmbeddedPlant, names: list[str], record: Mapping[str, Array]) -> dict[str, Array]:
    """Values of measurements and inputs, (n,), at the n samples of a plant record, with 'time'; names must be known."""
    time_s = record["time"]

    def series(name: str) -> Array:
        if name in INPUT_COLUMNS:
            return record[INPUT_COLUMNS[name]]
        if name in MEASUREMENTS:
            return record[MEASUREMENTS[name]]
        if name in _MEASURED:
            return WEATHER_SIGNALS[_MEASURED[name]].at(plant.weather, time_s)
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
FORECAST_POINTS = {name: PointInfo(_FORECAST_UNIT[name], text) for name, text in _FORECAST.items()}


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
