"""The weather as the test case's weather station and forecast name it, in units of the wire."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from thermoforce_mpc.boundary.weather.solar import sun_position
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Array

_KELVIN = 273.15
_STEFAN_BOLTZMANN = 5.670374419e-8
# What the IBPSA weather reader assumes where a file has no ceiling height.
_CEILING_M = 20_000.0


class WeatherSignal(NamedTuple):
    """A signal: unit, and its value at times (n,) s."""

    unit: str
    at: Callable[[Weather, Array], Array]


def relative_humidity(T_dry_C: Array, T_dew_C: Array) -> Array:
    """Relative humidity from dry bulb and dew point, 0 to 1 (Magnus formula, coefficients of Alduchov 1996)."""
    return np.asarray(np.minimum(_vapour_pressure(T_dew_C) / _vapour_pressure(T_dry_C), 1.0))


def wet_bulb_C(T_dry_C: Array, T_dew_C: Array, pressure_Pa: Array) -> Array:
    """Wet-bulb temperature, °C, by the psychrometer equation (coefficient 6.62e-4 1/K), solved by bisection.

    It lies between dew point and dry bulb; forty halvings leave less than a nanokelvin.
    """
    vapour = _vapour_pressure(T_dew_C)
    low, high = np.minimum(T_dew_C, T_dry_C), np.array(T_dry_C, dtype=np.float64)
    for _ in range(40):
        middle = (low + high) / 2
        too_wet = _vapour_pressure(middle) - 6.62e-4 * pressure_Pa * (T_dry_C - middle) > vapour
        low, high = np.where(too_wet, low, middle), np.where(too_wet, middle, high)
    return np.asarray((low + high) / 2)


def _vapour_pressure(T_C: Array) -> Array:
    """Saturation pressure over water, Pa."""
    return np.asarray(610.94 * np.exp(17.625 * T_C / (T_C + 243.04)))


def _column(name: str, shift: float = 0.0) -> Callable[[Weather, Array], Array]:
    return lambda weather, time_s: weather.at(name, time_s) + shift


def _constant(value: Callable[[Weather], float]) -> Callable[[Weather, Array], Array]:
    return lambda weather, time_s: np.full(np.shape(time_s), value(weather))


def _zenith(weather: Weather, time_s: Array) -> Array:
    return sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h).zenith


def _declination(weather: Weather, time_s: Array) -> Array:
    return sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h).declination


def _hour_angle(weather: Weather, time_s: Array) -> Array:
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    return np.asarray((sun.hour_angle + np.pi) % (2 * np.pi) - np.pi)


def _solar_time(weather: Weather, time_s: Array) -> Array:
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    return np.asarray((sun.hour_angle * 24.0 / (2 * np.pi) + 12.0) * HOUR_S)


def _sky_K(weather: Weather, time_s: Array) -> Array:
    return weather.sky_temperature_C(time_s) + _KELVIN


def _humidity(weather: Weather, time_s: Array) -> Array:
    return relative_humidity(weather.at("T_dry_C", time_s), weather.at("T_dew_C", time_s))


def _wet_bulb_K(weather: Weather, time_s: Array) -> Array:
    dry, dew = weather.at("T_dry_C", time_s), weather.at("T_dew_C", time_s)
    return wet_bulb_C(dry, dew, weather.at("pressure_Pa", time_s)) + _KELVIN


# By the names of the forecast. The emulator keeps neither total sky cover, for which the opaque cover stands in, nor
# the ceiling's height, which is a constant.
WEATHER_SIGNALS: dict[str, WeatherSignal] = {
    "HDifHor": WeatherSignal("W/m2", _column("diffuse_W_m2")),
    "HDirNor": WeatherSignal("W/m2", _column("normal_W_m2")),
    "HGloHor": WeatherSignal("W/m2", _column("global_W_m2")),
    "HHorIR": WeatherSignal("W/m2", lambda w, t: _STEFAN_BOLTZMANN * _sky_K(w, t) ** 4),
    "TBlaSky": WeatherSignal("K", _sky_K),
    "TDewPoi": WeatherSignal("K", _column("T_dew_C", _KELVIN)),
    "TDryBul": WeatherSignal("K", _column("T_dry_C", _KELVIN)),
    "TWetBul": WeatherSignal("K", _wet_bulb_K),
    "ceiHei": WeatherSignal("m", _constant(lambda _: _CEILING_M)),
    "cloTim": WeatherSignal("s", lambda _, t: np.asarray(t % (365 * DAY_S))),
    "lat": WeatherSignal("rad", _constant(lambda w: float(np.deg2rad(w.latitude_deg)))),
    "lon": WeatherSignal("rad", _constant(lambda w: float(np.deg2rad(w.longitude_deg)))),
    "nOpa": WeatherSignal("1", _column("opaque_cover")),
    "nTot": WeatherSignal("1", _column("opaque_cover")),
    "pAtm": WeatherSignal("Pa", _column("pressure_Pa")),
    "relHum": WeatherSignal("1", _humidity),
    "solAlt": WeatherSignal("rad", lambda w, t: np.pi / 2 - _zenith(w, t)),
    "solDec": WeatherSignal("rad", _declination),
    "solHouAng": WeatherSignal("rad", _hour_angle),
    "solTim": WeatherSignal("s", _solar_time),
    "solZen": WeatherSignal("rad", _zenith),
    "winDir": WeatherSignal("rad", _column("wind_from_rad")),
    "winSpe": WeatherSignal("m/s", _column("wind_m_s")),
}


def measurement_name(signal: str) -> str:
    """How the weather station names what the forecast calls `signal`."""
    return f"weaSta_reaWea{signal[0].upper()}{signal[1:]}_y"
