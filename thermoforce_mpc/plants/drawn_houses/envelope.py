"""What the drawn houses' thermal networks share: constants of EN ISO 13790, and the solver of a step."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pvlib import iam

from thermoforce_mpc.boundary.weather.solar import on_plane, sun_position
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import YEAR_S, Array
from thermoforce_mpc.data.compiled import njit

# Step of the physics and of the samples, and of the grids of weather and schedules, s.
STEP_S, GRID_S = 30.0, 900.0

Mass = Literal["very light", "light", "medium", "heavy", "very heavy"]
# EN ISO 13790:2008, table 12: effective mass area, m² per m² of floor, and heat capacity, J/K per m² of floor.
MASSES: dict[Mass, tuple[float, float]] = {
    "very light": (2.5, 80e3),
    "light": (2.5, 110e3),
    "medium": (2.5, 165e3),
    "heavy": (3.0, 260e3),
    "very heavy": (3.5, 370e3),
}
HEIGHT_M = 2.5
AIR_WH_M3_K = 0.34
WATER_J_KG_K = 4186.0
# Air and furniture, J/K per m² of floor (EN ISO 52016-1); surface to air and surface to structure, W/m²K, and room
# surface per floor area (EN ISO 13790).
AIR_J_M2_K = 10e3
SURFACE_AIR_W_M2_K, SURFACE_MASS_W_M2_K, SURFACE_PER_FLOOR = 3.45, 9.1, 4.5
# First centimetre of plaster or board, J/K per m² of surface.
SURFACE_J_M2_K = 10e3
# Operative temperature: share of the air (EN ISO 13790, C.12).
AIR_SHARE = 0.3
# Share of the air change that is driven by the wind, at the mean wind of the synthetic year, m/s.
_WIND_SHARE, _MEAN_WIND_M_S = 0.3, 3.9


@njit(cache=True)
def solve(a: np.ndarray, b: np.ndarray) -> None:
    """Solve a x = b, a diagonally dominant (n, n), into `b`; skips zeros below the diagonal: few neighbours first."""
    n = b.size
    for k in range(n):
        for i in range(k + 1, n):
            ratio = a[i, k] / a[k, k]
            if ratio != 0.0:
                for j in range(k + 1, n):
                    a[i, j] -= ratio * a[k, j]
                b[i] -= ratio * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= a[k, j] * b[j]
        b[k] /= a[k, k]


@njit(cache=True)
def read(grid: np.ndarray, time_s: float, w: np.ndarray) -> int:
    """Interpolate the first columns of a year's grid at `time_s` into `w` and return the row that holds then."""
    at = (time_s % ((grid.shape[0] - 1) * GRID_S)) / GRID_S
    row = int(at)
    share = at - row
    for j in range(w.size):
        w[j] = (1.0 - share) * grid[row, j] + share * grid[row + 1, j]
    return row


Facade = Literal["south", "west", "north", "east"]
FACADES: tuple[Facade, ...] = ("south", "west", "north", "east")
AZIMUTH_DEG: dict[Facade, float] = {"south": 180.0, "west": 270.0, "north": 0.0, "east": 90.0}
# Transmittance of diffuse relative to normal light, and ASHRAE's incidence factor, of double glazing.
_DIFFUSE_FACTOR, _ASHRAE_B = 0.87, 0.10


def year() -> Array:
    """Return the times of the grids of weather and schedules, s, shape (35041,)."""
    return np.arange(0.0, YEAR_S + GRID_S, GRID_S)


def on_facades(weather: Weather, time_s: Array, turn_deg: float = 0.0) -> Iterator[tuple[Array, Array]]:
    """Yield what passes a vertical pane over its g-value, and the irradiance on its facade, W/m² (n,), by `FACADES`."""
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    for azimuth_deg in AZIMUTH_DEG.values():
        light = on_plane(weather, sun, time_s, 90.0, (azimuth_deg + turn_deg) % 360.0)
        passing = light.beam * iam.ashrae(light.incidence_deg, b=_ASHRAE_B) + light.diffuse * _DIFFUSE_FACTOR
        yield passing, light.beam + light.diffuse


def air_change(weather: Weather, time_s: Array) -> Array:
    """Return the air change by infiltration relative to its mean, (n,)."""
    return np.asarray(1.0 - _WIND_SHARE + _WIND_SHARE * (weather.at("wind_m_s", time_s) / _MEAN_WIND_M_S))
