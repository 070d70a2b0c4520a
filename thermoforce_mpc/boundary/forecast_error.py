"""Weather forecast errors of BOPTEST at levels low, medium and high (parameters: its documentation).

Outdoor temperature: Gaussian first-order process along the horizon. Global irradiance: Laplace first-order process,
redrawn until daylight forecasts lie between 0.2 and 2 times the true value. Errors are hourly, drawn anew every hour,
up to 48 h ahead, and subtracted from the true value.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.errors import InputError

Level = Literal["low", "medium", "high"]
MAX_HORIZON_H = 48


class _Process(NamedTuple):
    """First-order process: e0 ~ D(start_mean, start_spread), then e ~ D(memory·e + drift, spread)."""

    start_mean: float
    start_spread: float
    memory: float
    spread: float
    drift: float

    def drawn(self, draw: Callable[[float, float], float]) -> Array:
        """Errors of every hour up to the horizon, (49,), by the draws of D from mean and spread."""
        errors = np.empty(MAX_HORIZON_H + 1)
        errors[0] = draw(self.start_mean, self.start_spread)
        for k in range(MAX_HORIZON_H):
            errors[k + 1] = draw(self.memory * errors[k] + self.drift, self.spread)
        return errors


# Gaussian, K.
_TEMPERATURE = {
    "low": _Process(0.0, 0.6, 0.92, 0.4, 0.0),
    "medium": _Process(0.15, 1.2, 0.93, 0.6, 0.0),
    "high": _Process(-0.58, 1.5, 0.95, 0.7, -0.015),
}
# Laplace, W/m².
_SOLAR = {
    "low": _Process(4.44, 57.42, 0.62, 45.64, 1.86),
    "medium": _Process(15.02, 122.6, 0.63, 91.97, 4.44),
    "high": _Process(32.09, 119.94, 0.67, 87.44, 10.63),
}
_DAYLIGHT_W_M2 = 50.0
_LEAST_SHARE, _MOST_SHARE = 0.2, 2.0
_DRAWS = 200


class ForecastError:
    """Forecast errors of one level and seed; they depend only on level, seed and hour, not on earlier calls."""

    def __init__(self, level: Level, seed: int) -> None:
        self.level, self._seed = level, seed

    def apply(self, time_s: Array, T_out_C: Array, hourly_solar_W_m2: Array, solar_W_m2: Array) -> tuple[Array, Array]:
        """Return outdoor temperature °C and irradiance W/m² with forecast errors, shape (n,) each.

        `time_s` (n,): s since 1 January, the first is now; `T_out_C`, `solar_W_m2` (n,): true values there;
        `hourly_solar_W_m2` (49,): true irradiance from the full hour at or before now. Raises `InputError` beyond 48 h.
        """
        hour = math.floor(time_s[0] / HOUR_S)
        ahead_h = time_s / HOUR_S - hour
        # The limit counts from now, as in the service; errors start at the full hour, the last value is held.
        if (time_s[-1] - time_s[0]) / HOUR_S > MAX_HORIZON_H + 1e-9:
            raise InputError(f"forecast horizon beyond {MAX_HORIZON_H} h: not available with forecast uncertainty")
        rng = np.random.default_rng([self._seed, hour])
        at_hours = np.arange(MAX_HORIZON_H + 1)
        temperature = np.interp(ahead_h, at_hours, _TEMPERATURE[self.level].drawn(rng.normal))
        solar = np.interp(ahead_h, at_hours, self._solar_errors(rng, hourly_solar_W_m2))
        return T_out_C - temperature, np.maximum(solar_W_m2 - solar, 0.0)

    def _solar_errors(self, rng: np.random.Generator, truth: Array) -> Array:
        """Draw until all daylight values lie in range (200 times at most), smooth over 3 h, clip to the range."""
        daylight = truth > _DAYLIGHT_W_M2
        for _ in range(_DRAWS):
            errors = _SOLAR[self.level].drawn(rng.laplace)
            forecast = (truth - errors)[daylight]
            low, high = _LEAST_SHARE * truth[daylight], _MOST_SHARE * truth[daylight]
            if ((forecast >= low) & (forecast <= high)).all():
                break
        forecast = np.where(daylight, truth - errors, truth)
        padded = np.pad(forecast, 1, mode="edge")
        smooth = np.convolve(padded, np.ones(3) / 3, mode="valid")
        return np.asarray(truth - np.where(daylight, np.clip(smooth, _LEAST_SHARE * truth, _MOST_SHARE * truth), truth))


def forecast_weather(weather: Weather, error: ForecastError | None, time_s: Array) -> tuple[Array, Array]:
    """Outdoor temperature, °C, and global horizontal irradiance, W/m², as forecast at `time_s[0]` for `time_s` (n,).

    `error` None: a perfect forecast; with one, raises `InputError` beyond 48 h.
    """
    T_out, solar = weather.at("T_dry_C", time_s), weather.at("global_W_m2", time_s)
    if error is None:
        return T_out, solar
    hours = (math.floor(time_s[0] / HOUR_S) + np.arange(MAX_HORIZON_H + 1.0)) * HOUR_S
    return error.apply(time_s, T_out, weather.at("global_W_m2", hours), solar)
