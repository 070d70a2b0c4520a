"""Sun that shines on a zone sensor: the part of its reading that the room does not share.

`identification.network.sensor` finds it. A record holds global horizontal irradiance alone, so that on the sensor's
facade is computed: diffuse share by Erbs et al. (1982), isotropic sky, sun position of a nominal site.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.data.series import lagged

if TYPE_CHECKING:  # pvlib is loaded only where the sun is needed
    from thermoforce_mpc.boundary.weather.solar import SunPosition

LIKELY = 0.9
"""Probability of sun on a sensor from which it is taken off the readings. Ideal sensors of six drawn houses and the
heat pump come to 0.03 at most, sensors with 2.5 K in full sun to 1.00 (2026-11-28)."""
# Full sun on a facade, and the most that a vertical plane receives, W/m²: the solar constant of 1361 through a clear
# sky, at heights of the sun of about 30°; the ceiling of `data.limits` for a horizontal plane is wider.
FULL_SUN_W_M2, _MOST_W_M2 = 800.0, 1000.0
# Beam is not extrapolated from a lower sun than this, °: over the sine of a smaller angle an error of the diffuse light
# would count more than eleven times.
_LOWEST_SUN_DEG = 5.0


@dataclass(frozen=True)
class SunOnSensor:
    """Sun in the reading of a zone sensor.

    `full_K`: how much too high it reads in full sun on its facade (800 W/m²), K, the mean over what the record leaves
    open, and `sd_K` its standard deviation. `probability` that the sensor stands in the sun at all. `azimuth_deg` of
    the facade, clockwise from north; `lag_s` of the sensor in the sun, s. `latitude_deg` and `noon_s`, time of day of
    the solar noon on the record's clock, s: the site that explains the record best.
    """

    full_K: float
    sd_K: float
    probability: float
    azimuth_deg: float
    lag_s: float
    latitude_deg: float
    noon_s: float

    @property
    def likely(self) -> bool:
        """Whether the sensor surely enough stands in the sun for its part to be taken off."""
        return self.probability > LIKELY

    def part_K(self, time_s: Array, solar_W_m2: Array) -> Array:
        """Sun in the readings at equally spaced `time_s` (n,), K, from irradiance (n,), W/m², with gaps bridged."""
        measured = np.isfinite(solar_W_m2)
        if not measured.any():
            return np.zeros(len(time_s))
        if not measured.all():
            solar_W_m2 = np.interp(time_s, np.asarray(time_s)[measured], np.asarray(solar_W_m2)[measured])
        facade = facade_W_m2(time_s, solar_W_m2, self.latitude_deg, self.noon_s, (self.azimuth_deg,))
        return np.asarray(self.full_K / FULL_SUN_W_M2 * sensor_lag(facade[:, 0], time_s, self.lag_s))

    def in_words(self) -> str:
        """One line."""
        side = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
        return (
            f"the zone sensor stands in the sun from the {side[round(self.azimuth_deg / 45.0) % 8]} (probability "
            f"{self.probability:.2g}): {self.full_K:.1f} ± {self.sd_K:.1f} K in full sun are taken off its readings"
        )


def off_sensors(record: Record, sun: Sequence[SunOnSensor | None]) -> Record:
    """`record` with the temperatures of the rooms, without the `sun` on their sensors (Z,)."""
    if not any(sun):
        return record
    T = np.array(record.T_zone_C)
    for z, part in enumerate(sun):
        if part is not None:
            T[z] -= part.part_K(record.time_s, record.solar_W_m2)
    return replace(record, T_zone_C=T)


def sun_at(time_s: Array, latitude_deg: float, noon_s: float) -> SunPosition:
    """Sun position at `time_s` where the mean solar noon is at `noon_s` of the clock."""
    from thermoforce_mpc.boundary.weather.solar import sun_position

    return sun_position(time_s, latitude_deg, 0.0, noon_s / HOUR_S - 12.0)


def facade_W_m2(
    time_s: Array, solar_W_m2: Array, latitude_deg: float, noon_s: float, azimuths_deg: tuple[float, ...]
) -> Array:
    """Irradiance on vertical planes (n, planes) from that on the horizontal (n,), W/m²; sun as in `sun_at`."""
    from pvlib import irradiance

    facades = np.zeros((len(time_s), len(azimuths_deg)))
    lit = np.flatnonzero(np.asarray(solar_W_m2) > 0.0)
    if not lit.size:
        return facades
    time_s, solar_W_m2 = np.asarray(time_s)[lit], np.asarray(solar_W_m2)[lit]
    sun = sun_at(time_s, latitude_deg, noon_s)
    zenith, azimuth = np.rad2deg(sun.zenith), np.rad2deg(sun.azimuth)
    split = irradiance.erbs(solar_W_m2, zenith, time_s / DAY_S + 1.0, max_zenith=90.0 - _LOWEST_SUN_DEG)
    planes = [
        irradiance.get_total_irradiance(90.0, plane, zenith, azimuth, split["dni"], solar_W_m2, split["dhi"])
        for plane in azimuths_deg
    ]
    on_planes = np.stack([np.asarray(plane["poa_global"]) for plane in planes], axis=-1)
    facades[lit] = np.clip(np.nan_to_num(on_planes), 0.0, _MOST_W_M2)
    return facades


def sensor_lag(signal: Array, time_s: Array, lag_s: float) -> Array:
    """First-order lag of `signal` (n,), piecewise linear between equally spaced `time_s`; it stood still before."""
    if len(time_s) < 2:
        return signal
    steps = float(time_s[1] - time_s[0]) / lag_s
    kept = float(np.exp(-steps))
    first = (1.0 - kept) / steps
    over_step = ((1.0 - first) * signal[1:] + (first - kept) * signal[:-1]) / (1.0 - kept)
    return lagged(over_step, kept, float(signal[0]))
