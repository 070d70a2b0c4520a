"""Deterministic synthetic weather year of a climate, the default without a weather file.

Seasonal and daily cycles, passing weather systems and clouds with the statistics of a north-west European coast, or of
a high plain in the middle of a continent, not a real site; the name says 'synthetic'. Comparison with measured years:
docs/how-it-works/plants.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.boundary.weather.solar import clear_sky_W_m2, sun_position
from thermoforce_mpc.boundary.weather.year import (
    STEFAN_BOLTZMANN_W_M2_K4,
    Weather,
    black_body_sky_C,
    vapour_pressure_Pa,
)
from thermoforce_mpc.data import HOUR_S, YEAR_S, ZERO_C_K, Array

_HOURS = 8760
# Value of IWEC files for an unlimited ceiling.
_UNLIMITED_CEILING_M = 22_000.0


@dataclass(frozen=True)
class SyntheticClimate:
    """Statistics of a climate, and the place whose sun it has.

    Attributes:
        name: as the year's name says it.
        latitude_deg, longitude_deg, timezone_h: the place.
        mean_C, season_K: mean of the year, and half of what summer is warmer than winter.
        systems_K: deviation by weather systems of 90 h and fronts of 14 h.
        swing_K: half of the daily swing in winter, and how much more it is in summer.
        cover: mean, and deviations of 18 h and 4 h, of the cloud process.
        transmittance: of its sky relative to Haurwitz' clear sky.
        dry_K: how far the dew point lies below, overcast, and how much further when clear.
        wind_m_s: mean and deviation of the wind.
        wind_from_deg, wind_veers_rad: where it comes from, and deviation.
        pressure_Pa: mean pressure.
    """

    name: str
    latitude_deg: float
    longitude_deg: float
    timezone_h: float
    mean_C: float
    season_K: float
    systems_K: tuple[float, float]
    swing_K: tuple[float, float]
    cover: tuple[float, float, float]
    transmittance: float
    dry_K: tuple[float, float]
    wind_m_s: tuple[float, float]
    wind_from_deg: float
    wind_veers_rad: float
    pressure_Pa: float


MARITIME = SyntheticClimate(
    name="temperate-maritime",
    latitude_deg=51.0,
    longitude_deg=4.5,
    timezone_h=1.0,
    mean_C=10.3,
    season_K=7.0,
    systems_K=(3.1, 1.2),
    swing_K=(1.2, 3.2),
    cover=(0.55, 0.85, 0.5),
    transmittance=0.86,
    dry_K=(1.2, 3.0),
    wind_m_s=(3.9, 1.9),
    wind_from_deg=235.0,
    wind_veers_rad=1.0,
    pressure_Pa=101_300.0,
)
# Of the order of the year of `bestest_air` (Denver).
CONTINENTAL = SyntheticClimate(
    name="continental",
    latitude_deg=39.8,
    longitude_deg=-104.9,
    timezone_h=-7.0,
    mean_C=9.7,
    season_K=11.5,
    systems_K=(3.9, 2.0),
    swing_K=(5.0, 1.8),
    cover=(-0.25, 0.85, 0.5),
    transmittance=1.08,
    dry_K=(5.5, 10.5),
    wind_m_s=(4.0, 2.1),
    wind_from_deg=190.0,
    wind_veers_rad=1.6,
    pressure_Pa=83_500.0,
)


def synthetic_weather(
    seed: int = 0, *, warmer_K: float = 0.0, clearer: float = 0.0, climate: SyntheticClimate = MARITIME
) -> Weather:
    """Return the synthetic year of `seed`; the same arguments give the same bytes.

    `warmer_K` shifts the outdoor temperature over the whole year, `clearer` the cloud process towards a clear sky, in
    standard deviations.
    """
    rng = np.random.default_rng(seed)
    hour = np.arange(float(_HOURS))
    day = hour / 24.0
    # Weather systems of about 90 h and fronts of 14 h.
    systems = climate.systems_K[0] * _periodic_noise(rng, 90.0) + climate.systems_K[1] * _periodic_noise(rng, 14.0)
    cover = _cover(rng, clearer, climate)
    clear = 1.0 - cover
    season = -np.cos(2.0 * np.pi * (day - 20.0) / 365.0)  # coldest around 20 January
    # The daily amplitude rises in summer and falls with cloud cover.
    swing = (climate.swing_K[0] + climate.swing_K[1] * (season + 1.0) / 2.0) * (0.35 + 1.1 * clear)
    cycle = np.cos(2.0 * np.pi * (hour % 24 - 15.0) / 24.0)
    # Clear winter weather is cold, clear summer weather warm.
    T_dry = climate.mean_C + warmer_K + climate.season_K * season + systems + swing * cycle
    T_dry = T_dry + 4.0 * (clear - 0.35) * season
    overcast_K, clear_K = climate.dry_K
    depression = overcast_K + clear_K * clear + 2.5 * np.maximum(cycle, 0) * (season + 1.2) / 2.2
    depression = np.clip(depression, 0.3, 12.0 + clear_K - 3.0)
    wind_m_s, gusts = climate.wind_m_s
    wind = np.clip(wind_m_s - 0.7 * season + gusts * _periodic_noise(rng, 16.0) + 0.5 * cycle, 0.0, 20.0)
    wind_from = np.deg2rad(climate.wind_from_deg) + climate.wind_veers_rad * _periodic_noise(rng, 40.0)
    wind_from = np.mod(wind_from, 2.0 * np.pi)
    pressure = climate.pressure_Pa + 900.0 * _periodic_noise(rng, 70.0)
    global_, normal, diffuse = _radiation(hour, cover, climate)
    T_dry, T_dew, cover = np.round(T_dry, 1), np.round(T_dry - depression, 1), np.round(cover, 1)
    return Weather(
        name=f"synthetic {climate.name} year (seed {seed}{_shifts(warmer_K, clearer)})",
        latitude_deg=climate.latitude_deg,
        longitude_deg=climate.longitude_deg,
        timezone_h=climate.timezone_h,
        T_dry_C=T_dry,
        T_dew_C=T_dew,
        global_W_m2=np.round(global_),
        normal_W_m2=np.round(normal),
        diffuse_W_m2=np.round(diffuse),
        wind_m_s=np.round(wind, 1),
        wind_from_rad=wind_from,
        opaque_cover=cover,
        pressure_Pa=np.round(pressure, -2),
        relative_humidity=vapour_pressure_Pa(T_dew) / vapour_pressure_Pa(T_dry),
        infrared_W_m2=STEFAN_BOLTZMANN_W_M2_K4 * (black_body_sky_C(T_dry, T_dew, cover) + ZERO_C_K) ** 4,
        total_cover=cover,
        ceiling_m=np.full(_HOURS, _UNLIMITED_CEILING_M),
    )


def _shifts(warmer_K: float, clearer: float) -> str:
    return (f", {warmer_K:+.1f} K" if warmer_K else "") + (f", {clearer:+.2f} clearer" if clearer else "")


def _periodic_noise(rng: np.random.Generator, hours: float) -> Array:
    """Return Gaussian noise of unit variance with correlation time `hours`, periodic over the year, (8760,)."""
    frequency = np.fft.rfftfreq(_HOURS)
    # Spectrum of a first-order process, drawn in the frequency domain so that the series is periodic.
    amplitude = 1.0 / np.sqrt(1.0 + (2.0 * np.pi * frequency * hours) ** 2)
    amplitude[0] = 0.0
    spectrum = amplitude * (rng.standard_normal(amplitude.size) + 1j * rng.standard_normal(amplitude.size))
    noise = np.fft.irfft(spectrum, _HOURS)
    return np.asarray(noise / noise.std())


def _cover(rng: np.random.Generator, clearer: float, climate: SyntheticClimate) -> Array:
    """Return opaque cover, 0 to 1: often overcast, sometimes clear, rarely in between."""
    mean, slow, quick = climate.cover
    state = slow * _periodic_noise(rng, 18.0) + quick * _periodic_noise(rng, 4.0) + mean - clearer
    return np.asarray(np.clip(0.5 + 0.55 * np.tanh(1.3 * state), 0.0, 1.0))


def _radiation(hour: Array, cover: Array, climate: SyntheticClimate) -> tuple[Array, Array, Array]:
    """Return global horizontal, direct normal and diffuse horizontal irradiance, W/m², means over the hour that ends.

    Clear sky after Haurwitz (1945), cover factor after Kasten and Czeplak (1980), diffuse share after Erbs, Klein and
    Duffie (1982); pvlib's version of the latter includes the sun's distance: 2.6 % less diffuse over the year than the
    figures in docs/how-it-works/plants.md.
    """
    minutes = (np.arange(6) + 0.5) * 600.0 - HOUR_S
    time_s = hour[:, None] * HOUR_S + minutes[None, :]
    sun = sun_position(np.mod(time_s, YEAR_S), climate.latitude_deg, climate.longitude_deg, climate.timezone_h)
    cos_zenith = np.maximum(np.cos(sun.zenith), 0.0)
    global_ = (climate.transmittance * clear_sky_W_m2(sun) * (1.0 - 0.75 * cover[:, None] ** 3.4)).mean(axis=1)
    cos_mean = cos_zenith.mean(axis=1)
    clearness = np.clip(global_ / np.maximum(1367.0 * cos_mean, 1.0), 0.0, 0.85)
    diffuse_share = np.where(
        clearness <= 0.22,
        1.0 - 0.09 * clearness,
        0.9511 - 0.1604 * clearness + 4.388 * clearness**2 - 16.638 * clearness**3 + 12.336 * clearness**4,
    )
    diffuse = global_ * np.where(clearness > 0.8, 0.165, diffuse_share)
    # Near the horizon all irradiance is taken as diffuse, since dividing by cos(zenith) diverges.
    normal = np.where(cos_mean > 0.04, (global_ - diffuse) / np.maximum(cos_mean, 0.04), 0.0)
    diffuse = np.where(cos_mean > 0.04, diffuse, global_)
    return global_, np.clip(normal, 0.0, 1000.0), diffuse
