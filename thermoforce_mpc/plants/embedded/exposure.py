"""Weather forcing of each surface on a 15-min grid: all terms that do not depend on the house's state."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from thermoforce_mpc.boundary.weather.solar import on_plane, sun_position
from thermoforce_mpc.boundary.weather.year import LIMITS, Weather, vapour_pressure_Pa
from thermoforce_mpc.data import YEAR_S, ZERO_C_K, Array
from thermoforce_mpc.plants.embedded.houses import Facade, moist_air_cp

GRID_S = 900.0
_SHORT_WAVE_ABSORPTANCE = 0.6

# Azimuth of the walls, degrees clockwise from north.
_FACING_DEG = {"south": 180.0, "west": 270.0, "north": 0.0, "east": 90.0}

# Columns of the grid.
T_OUT, T_SKY, FORCED, ABSORBED = 0, 1, 2, 8
BEAM_IN, DIFFUSE_IN, PANE_OUTER, PANE_INNER, GLOBAL, CP_OUT = 13, 14, 15, 16, 17, 18
N_COLUMNS = 19
# The test cases' weather readers take the pressure from a parameter, not from the file.
PRESSURE_PA = 101_325.0


def build_exposure(weather: Weather, facade: Facade) -> Array:
    """Return the forcing of a house over a periodic year, shape (35041, 19); plants of one year and house share it.

    Outdoor and sky temperature K; forced convection coefficient of south, west, north, east, roof, window W/(m²·K);
    short-wave absorbed by the opaque ones W/m²; transmitted by the window as beam and as diffuse, and absorbed in its
    outer and inner pane, W; global horizontal irradiance W/m²; heat capacity of the outdoor air J/(kg·K). Read-only.
    """
    return _kept(_Year.of(weather), facade)


@dataclass(frozen=True)
class _Year:
    """A weather year by its values, to the last bit."""

    digest: bytes
    weather: Weather = field(compare=False, repr=False)

    @classmethod
    def of(cls, weather: Weather) -> _Year:
        digest = hashlib.sha256(repr((weather.latitude_deg, weather.longitude_deg, weather.timezone_h)).encode())
        for name in LIMITS:
            digest.update(getattr(weather, name).tobytes())
        return cls(digest.digest(), weather)


# Each takes 5 MB, and 0.13 s of a core: of houses that are compared, or started one after the other by a service or
# an agent's episodes, most have the same few.
@lru_cache(maxsize=4)
def _kept(year: _Year, facade: Facade) -> Array:
    weather = year.weather
    time_s = np.arange(0.0, YEAR_S + GRID_S, GRID_S)
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    grid = np.empty((time_s.size, N_COLUMNS))
    grid[:, T_OUT] = weather.at("T_dry_C", time_s) + ZERO_C_K
    grid[:, T_SKY] = weather.sky_temperature_C(time_s) + ZERO_C_K
    wind, wind_from = weather.at("wind_m_s", time_s), weather.at("wind_from_rad", time_s)
    glazing = facade.glazing
    for i, (side, facing_deg) in enumerate(_FACING_DEG.items()):
        off_normal = np.abs(np.angle(np.exp(1j * (wind_from - np.deg2rad(facing_deg)))))
        grid[:, FORCED + i] = facade.forced(wind, off_normal, facade.areas_m2[i])
        light = on_plane(weather, sun, time_s, 90.0, facing_deg)
        grid[:, ABSORBED + i] = _SHORT_WAVE_ABSORPTANCE * (light.beam + light.diffuse)
        if side == "south":
            on_roof = off_normal if facade.roof_is_south else np.zeros(wind.size)
            grid[:, FORCED + 4] = facade.forced(wind, on_roof, facade.areas_m2[4])
            own = facade.window_forced
            grid[:, FORCED + 5] = grid[:, FORCED] if own is None else own(wind)
            beam, diffuse = glazing.area_m2 * light.beam, glazing.area_m2 * light.diffuse
            passed, outer, inner = glazing.of_beam(light.incidence_deg)
            grid[:, BEAM_IN] = beam * passed
            grid[:, DIFFUSE_IN] = diffuse * glazing.of_diffuse[0]
            lost = glazing.lost[0] * grid[:, BEAM_IN] + glazing.lost[1] * grid[:, DIFFUSE_IN]
            grid[:, PANE_OUTER] = beam * outer + diffuse * glazing.of_diffuse[1] - lost * glazing.of_diffuse[2]
            grid[:, PANE_INNER] = beam * inner + diffuse * glazing.of_diffuse[2] - lost * glazing.of_diffuse[1]
    above = on_plane(weather, sun, time_s, 0.0, 180.0)
    grid[:, ABSORBED + 4] = _SHORT_WAVE_ABSORPTANCE * (above.beam + above.diffuse)
    grid[:, GLOBAL] = weather.at("global_W_m2", time_s)
    vapour_Pa = vapour_pressure_Pa(weather.at("T_dew_C", time_s))
    grid[:, CP_OUT] = moist_air_cp(0.622 * vapour_Pa / (PRESSURE_PA - vapour_Pa))
    grid.setflags(write=False)
    return grid
