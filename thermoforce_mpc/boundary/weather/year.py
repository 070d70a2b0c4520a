"""Hourly weather year, interpolated between the rows as in the BOPTEST test case."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from thermoforce_mpc.data import HOUR_S, YEAR_S, ZERO_C_K, Array
from thermoforce_mpc.errors import WeatherError

if TYPE_CHECKING:
    from scipy.interpolate import Akima1DInterpolator

_HOURS = 8760
STEFAN_BOLTZMANN_W_M2_K4 = 5.670374419e-8
# Radiation rows are means over the hour that ends there; reading them half an hour ahead centres them on that hour.
_RADIATION_SHIFT_S = 1800.0
_RADIATION = ("global_W_m2", "normal_W_m2", "diffuse_W_m2")

LIMITS = {
    "T_dry_C": (-70.0, 60.0),
    "T_dew_C": (-80.0, 50.0),
    "global_W_m2": (0.0, 1500.0),
    "normal_W_m2": (0.0, 1500.0),
    "diffuse_W_m2": (0.0, 1000.0),
    "wind_m_s": (0.0, 60.0),
    "wind_from_rad": (0.0, 2 * np.pi + 1e-9),
    "opaque_cover": (0.0, 1.0),
    "pressure_Pa": (50_000.0, 110_000.0),
}
"""Lowest and highest value of each column that counts."""
_PLACE = {"latitude_deg": (-90.0, 90.0), "longitude_deg": (-180.0, 180.0), "timezone_h": (-12.0, 14.0)}
# Columns that no building model uses; only reported. They are clipped as in the test case's reader, so that missing
# values (a ceiling of 99999 m, a cover of 99) do not make a file unusable.
_REPORTED = {
    "relative_humidity": (0.0, 1.0),
    "infrared_W_m2": (0.0, np.inf),
    "total_cover": (0.0, 1.0),
    "ceiling_m": (0.0, np.inf),
}
_RANGES = LIMITS | _REPORTED


@dataclass(frozen=True)
class Weather:
    """Hourly weather year; all arrays have shape (8760,), the first row is 1 January 00:00 local standard time.

    `T_dry_C`, `T_dew_C` °C; global horizontal, direct normal and diffuse horizontal irradiance W/m² (means over the
    hour that ends at the row); `wind_m_s`; `wind_from_rad` clockwise from north; `opaque_cover` 0 to 1; `pressure_Pa`.
    Only reported: `relative_humidity` and `total_cover` 0 to 1, horizontal `infrared_W_m2`, cloud `ceiling_m`. Raises
    `WeatherError` for a column of another length or with a value outside its range, and a place not on Earth.
    """

    name: str
    latitude_deg: float
    longitude_deg: float
    timezone_h: float
    T_dry_C: Array
    T_dew_C: Array
    global_W_m2: Array
    normal_W_m2: Array
    diffuse_W_m2: Array
    wind_m_s: Array
    wind_from_rad: Array
    opaque_cover: Array
    pressure_Pa: Array
    relative_humidity: Array
    infrared_W_m2: Array
    total_cover: Array
    ceiling_m: Array
    _splines: dict[str, Akima1DInterpolator] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for key, (least, most) in _PLACE.items():
            if not least <= getattr(self, key) <= most:
                raise WeatherError(f"{self.name}: {key} is {getattr(self, key):g}, expected {least:g} to {most:g}")
        for item in fields(self):
            if item.name not in _RANGES:
                continue
            column = np.array(getattr(self, item.name), dtype=np.float64)
            if column.shape != (_HOURS,):
                raise WeatherError(f"{self.name}: {item.name} has {column.size} rows, a year has {_HOURS}")
            if item.name in _REPORTED:
                column = np.clip(column, *_REPORTED[item.name])
            low, high = _RANGES[item.name]
            bad = np.flatnonzero(~((column >= low) & (column <= high)))
            if bad.size:
                hour = int(bad[0])
                raise WeatherError(
                    f"{self.name}: {item.name} is {column[hour]:.10g} at day {hour // 24 + 1}, hour {hour % 24}, "
                    f"expected {low:g} to {high:g} ({bad.size} such rows); repair the file or use another"
                )
            column.setflags(write=False)
            object.__setattr__(self, item.name, column)

    @property
    def fingerprint(self) -> str:
        """Hash of values and site, twelve hexadecimal digits; not of the file format and of what is only reported."""
        digest = hashlib.sha256()
        place = np.array([self.latitude_deg, self.longitude_deg, self.timezone_h])
        for values in (place, *(getattr(self, name) for name in LIMITS)):
            digest.update((np.round(values, 6) + 0.0).astype("<f8").tobytes())  # adding zero turns -0.0 into 0.0
        return digest.hexdigest()[:12]

    def at(self, column: str, time_s: Array) -> Array:
        """Interpolate `column` at `time_s` (s since 1 January, periodic over the year), clipped to its range.

        Akima splines, as Modelica's `ContinuousDerivative` tables.
        """
        shift = _RADIATION_SHIFT_S if column in _RADIATION else 0.0
        values = self._spline(column)(np.mod(np.asarray(time_s, dtype=np.float64) + shift, YEAR_S))
        low, high = _RANGES[column]
        return np.asarray(np.clip(values, low, high))

    def _spline(self, column: str) -> Akima1DInterpolator:
        """Return the column's spline, cached: building it costs more than evaluating a horizon."""
        if column not in self._splines:
            from scipy.interpolate import Akima1DInterpolator

            rows = getattr(self, column)
            # Three rows beyond either end make the spline periodic.
            padded = np.concatenate([rows[-3:], rows, rows[:4]])
            self._splines[column] = Akima1DInterpolator((np.arange(padded.size) - 3) * HOUR_S, padded)
        return self._splines[column]

    def sky_temperature_C(self, time_s: Array) -> Array:
        """Return black-body sky temperature from dew point, dry bulb and opaque cover, °C, shape of `time_s`.

        Emissivity and cover factor after Clark and Allen (1978) and Walton (1983), as in EnergyPlus and the IBPSA
        library.
        """
        dry_C, dew_C = self.at("T_dry_C", time_s), self.at("T_dew_C", time_s)
        return black_body_sky_C(dry_C, dew_C, self.at("opaque_cover", time_s))


def black_body_sky_C(T_dry_C: Array, T_dew_C: Array, opaque_cover: Array) -> Array:
    """Return black-body sky temperature, °C; see `Weather.sky_temperature_C`."""
    tenths = 10.0 * opaque_cover
    clear = 0.787 + 0.764 * np.log((T_dew_C + ZERO_C_K) / ZERO_C_K)
    emissivity = clear * (1.0 + 0.0224 * tenths - 0.0035 * tenths**2 + 0.00028 * tenths**3)
    return np.asarray((T_dry_C + ZERO_C_K) * emissivity**0.25 - ZERO_C_K)


def vapour_pressure_Pa(T_C: Array) -> Array:
    """Return saturation pressure over water, supercooled below 0 °C (Magnus formula, Alduchov 1996)."""
    return np.asarray(610.94 * np.exp(17.625 * T_C / (T_C + 243.04)))
