"""Weather signals with the names and units of the test case's forecast and weather station."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import psychrolib

from thermoforce_mpc.boundary.weather.solar import sun_position
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import HOUR_S, YEAR_S, ZERO_C_K, Array

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


def _zenith(weather: Weather, time_s: Array) -> Array:
    return sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h).zenith


def _declination(weather: Weather, time_s: Array) -> Array:
    return sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h).declination


def _hour_angle(weather: Weather, time_s: Array) -> Array:
    """Hour angle, rad, not wrapped to ±π: like solar time, it increases from day to day."""
    return sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h).hour_angle


def _solar_time(weather: Weather, time_s: Array) -> Array:
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    return np.asarray((sun.hour_angle * 24.0 / (2 * np.pi) + 12.0) * HOUR_S)


def _sky_K(weather: Weather, time_s: Array) -> Array:
    return weather.sky_temperature_C(time_s) + ZERO_C_K


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
    "TBlaSky": WeatherSignal("K", _sky_K),
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
    "solAlt": WeatherSignal("rad", lambda w, t: np.pi / 2 - _zenith(w, t)),
    "solDec": WeatherSignal("rad", _declination),
    "solHouAng": WeatherSignal("rad", _hour_angle),
    "solTim": WeatherSignal("s", _solar_time),
    "solZen": WeatherSignal("rad", _zenith),
    "winDir": WeatherSignal("rad", _column("wind_from_rad")),
    "winSpe": WeatherSignal("m/s", _column("wind_m_s")),
}


def measurement_name(signal: str) -> str:
    """Weather station name of the forecast signal `signal`."""
    return f"weaSta_reaWea{signal[0].upper()}{signal[1:]}_y"
