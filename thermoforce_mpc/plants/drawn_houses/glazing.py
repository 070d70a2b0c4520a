"""Sun through the windows of a facade."""

from __future__ import annotations

from typing import Literal

from pvlib import iam

from thermoforce_mpc.boundary.weather.solar import Sun, on_plane
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import Array

Facade = Literal["south", "west", "north", "east"]
FACADES: tuple[Facade, ...] = ("south", "west", "north", "east")
AZIMUTH_DEG: dict[Facade, float] = {"south": 180.0, "west": 270.0, "north": 0.0, "east": 90.0}
# Transmittance of diffuse relative to normal light, and ASHRAE's incidence factor, of double glazing.
_DIFFUSE_FACTOR, _ASHRAE_B = 0.87, 0.10


def on_facade(weather: Weather, sun: Sun, time_s: Array, azimuth_deg: float) -> tuple[Array, Array]:
    """Return irradiance that passes a vertical pane over its g-value, and that on the facade, W/m², like `time_s`."""
    light = on_plane(weather, sun, time_s, 90.0, azimuth_deg)
    passing = light.beam * iam.ashrae(light.incidence_deg, b=_ASHRAE_B) + light.diffuse * _DIFFUSE_FACTOR
    return passing, light.beam + light.diffuse
