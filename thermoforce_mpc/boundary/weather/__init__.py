"""Weather years: file readers (.mos, .epw), synthetic default, sun position, irradiance on tilted planes."""

from thermoforce_mpc.boundary.weather.readers import load_weather
from thermoforce_mpc.boundary.weather.synthetic import CONTINENTAL, MARITIME, SyntheticClimate, synthetic_weather
from thermoforce_mpc.boundary.weather.year import Weather

__all__ = ["CONTINENTAL", "MARITIME", "SyntheticClimate", "Weather", "load_weather", "synthetic_weather"]
