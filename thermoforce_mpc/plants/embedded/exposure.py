"""Weather forcing of each surface on a 15-min grid: all terms that do not depend on the house's state."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.boundary.weather.solar import on_plane, sun_position
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import YEAR_S, ZERO_C_K, Array
from thermoforce_mpc.plants.embedded.constructions import WINDOW_M2

GRID_S = 900.0
_SHORT_WAVE_ABSORPTANCE = 0.6

# Azimuth of the walls, degrees clockwise from north.
_FACING_DEG = {"south": 180.0, "west": 270.0, "north": 0.0, "east": 90.0}
# A surface is leeward if the wind comes from more than this angle off its normal.
_LEE_RAD = np.deg2rad(100.0)

# Double glazing by angle of incidence, degrees: fractions transmitted, absorbed in the outer and in the inner pane
# (BESTEST glazing of the IDEAS library, from WINDOW 6.3).
_ANGLE = [0, 10, 20, 30, 40, 45, 50, 60, 70, 80, 88.9, 90]
# fmt: off
_TRANSMITTED = [
    0.747454, 0.746824, 0.744654, 0.739491, 0.729832, 0.720922, 0.707331, 0.652331, 0.516754, 0.263009, 0, 0,
]
_ABSORBED_ANGLE = [
    0, 20, 30, 40, 48, 55, 57, 60, 63, 66, 68, 70, 72,
    75, 77.5, 80, 82, 83.5, 85, 86, 87, 88, 89, 89.99, 90,
]
_ABSORBED_OUTER = [
    0.0643, 0.0659, 0.0679, 0.0708, 0.0738, 0.0769, 0.0779, 0.0796, 0.0815, 0.0837, 0.0852, 0.0858, 0.089,
    0.0911, 0.0929, 0.094, 0.0937, 0.0924, 0.0892, 0.0854, 0.079, 0.0671, 0.0473, 0.001, 0.0,
]
_ABSORBED_INNER = [
    0.0522, 0.0534, 0.0548, 0.0566, 0.058, 0.0587, 0.0587, 0.0585, 0.0579, 0.0568, 0.0558, 0.0544, 0.0521,
    0.0495, 0.0457, 0.0413, 0.0372, 0.0335, 0.0291, 0.0254, 0.0205, 0.0128, 0.0043, 0.0, 0.0,
]
# fmt: on
_DIFFUSE = (0.652331, 0.0796, 0.0585)

# Columns of the grid.
T_OUT, T_SKY, FORCED, ABSORBED = 0, 1, 2, 7
BEAM_IN, DIFFUSE_IN, PANE_OUTER, PANE_INNER, GLOBAL = 12, 13, 14, 15, 16
N_COLUMNS = 17


def build_exposure(weather: Weather) -> Array:
    """Return the forcing of the house over a periodic year, shape (35041, 17); takes about 1 s.

    Outdoor and sky temperature K; forced convection coefficient of south, west, north, east, roof W/(m²·K);
    short-wave absorbed there W/m²; transmitted by the window as beam and as diffuse, and absorbed in its outer and
    inner pane, W; global horizontal irradiance W/m².
    """
    time_s = np.arange(0.0, YEAR_S + GRID_S, GRID_S)
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    grid = np.empty((time_s.size, N_COLUMNS))
    grid[:, T_OUT] = weather.at("T_dry_C", time_s) + ZERO_C_K
    grid[:, T_SKY] = weather.sky_temperature_C(time_s) + ZERO_C_K
    wind, wind_from = weather.at("wind_m_s", time_s), weather.at("wind_from_rad", time_s)
    for i, (side, facing_deg) in enumerate(_FACING_DEG.items()):
        off_normal = np.abs(np.angle(np.exp(1j * (wind_from - np.deg2rad(facing_deg)))))
        grid[:, FORCED + i] = np.where(off_normal > _LEE_RAD, 3.55 * wind**0.617, 3.26 * wind**0.89)
        light = on_plane(weather, sun, time_s, 90.0, facing_deg)
        grid[:, ABSORBED + i] = _SHORT_WAVE_ABSORPTANCE * (light.beam + light.diffuse)
        if side == "south":
            angle = light.incidence_deg
            beam, diffuse = WINDOW_M2 * light.beam, WINDOW_M2 * light.diffuse
            grid[:, BEAM_IN] = beam * np.interp(angle, _ANGLE, _TRANSMITTED)
            grid[:, DIFFUSE_IN] = diffuse * _DIFFUSE[0]
            outer = np.interp(angle, _ABSORBED_ANGLE, _ABSORBED_OUTER)
            inner = np.interp(angle, _ABSORBED_ANGLE, _ABSORBED_INNER)
            grid[:, PANE_OUTER] = beam * outer + diffuse * _DIFFUSE[1]
            grid[:, PANE_INNER] = beam * inner + diffuse * _DIFFUSE[2]
    grid[:, FORCED + 4] = 3.26 * wind**0.89  # a roof is always windward
    above = on_plane(weather, sun, time_s, 0.0, 180.0)
    grid[:, ABSORBED + 4] = _SHORT_WAVE_ABSORPTANCE * (above.beam + above.diffuse)
    grid[:, GLOBAL] = weather.at("global_W_m2", time_s)
    grid.setflags(write=False)
    return grid
