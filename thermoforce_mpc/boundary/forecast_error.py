"""Weather forecast errors of BOPTEST, as its service makes them (levels and parameters: its documentation).

Errors are hourly, from the full hour at or before now, at most 48 h ahead, and are subtracted from the true value of
that hour; between hours a forecast is a straight line, whatever the interval asked for. Outdoor temperature: Gaussian
first-order process along the horizon. Global irradiance: Laplace first-order process, drawn again until values above
50 W/m² lie between 0.2 and 2 times the true one, then the mean of three hours, then kept within these shares.

Errors are drawn anew every hour, by the seed and the time of the hour, s: two seeds that differ by 3600 n are the same
errors n hours apart. Where the service is first asked within an hour it takes the time of that request instead.
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

    def drawn(self, n: int, draw: Callable[[float, float], float]) -> Array:
        """Errors of `n` hours, (n,), by the draws of D from mean and spread."""
        errors = np.empty(n)
        errors[0] = draw(self.start_mean, self.start_spread)
        for k in range(n - 1):
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
# Seeds that numpy's generator takes.
_SEEDS = 2**32


class ForecastError:
    """Errors of a level for the outdoor temperature and one for the irradiance (None: none), with a seed or without.

    They depend on levels, seed, hour and horizon only, not on earlier calls; without a seed, as if it were 0.
    """

    def __init__(self, temperature: Level | None, solar: Level | None, seed: int | None = None) -> None:
        self._temperature, self._solar, self._seed = temperature, solar, seed or 0

    def apply(
        self, time_s: Array, T_out_C: Callable[[Array], Array], solar_W_m2: Callable[[Array], Array]
    ) -> tuple[Array, Array]:
        """Return outdoor temperature °C and irradiance W/m² with forecast errors, shape (n,) each.

        `time_s` (n,): s since 1 January, the first is now; `T_out_C`, `solar_W_m2`: true values at times, s. Raises
        `InputError` beyond 48 h.
        """
        first_h, horizon_h = math.floor(time_s[0] / HOUR_S), (time_s[-1] - time_s[0]) / HOUR_S
        if horizon_h > MAX_HORIZON_H + 1e-9:
            raise InputError(f"forecast horizon beyond {MAX_HORIZON_H} h: not available with forecast uncertainty")
        hours_s = (first_h + np.arange(math.floor(horizon_h + 1e-9) + 2.0)) * HOUR_S

        def between(values: Array) -> Array:
            return np.asarray(np.interp(time_s, hours_s, values))

        T_seen, solar_seen = T_out_C(time_s), solar_W_m2(time_s)
        if self._temperature:
            errors = _TEMPERATURE[self._temperature].drawn(hours_s.size, self._generator(first_h).normal)
            T_seen = between(T_out_C(hours_s) - errors)
        if self._solar:
            solar_seen = between(self._solar_forecast(self._solar, solar_W_m2(hours_s), first_h))
        return T_seen, solar_seen

    def _generator(self, hour: int, draw: int = 0) -> np.random.RandomState:
        """The generator of a draw. Numbers of the legacy generator are those of the service."""
        return np.random.RandomState((self._seed + round(hour * HOUR_S) + draw * draw) % _SEEDS)

    def _solar_forecast(self, level: Level, truth: Array, hour: int) -> Array:
        low, high = _LEAST_SHARE * truth, _MOST_SHARE * truth
        daylight = truth > _DAYLIGHT_W_M2
        for draw in range(_DRAWS):
            forecast = truth - _SOLAR[level].drawn(truth.size, self._generator(hour, draw).laplace)
            if ((forecast >= low) & (forecast <= high))[daylight].all():
                break
        smooth = forecast.copy()
        smooth[1:-1] = np.convolve(forecast, np.ones(3) / 3, mode="valid")
        return np.clip(smooth, low, high)


def forecast_weather(weather: Weather, error: ForecastError | None, time_s: Array) -> tuple[Array, Array]:
    """Outdoor temperature, °C, and global horizontal irradiance, W/m², as forecast at `time_s[0]` for `time_s` (n,).

    `error` None: a perfect forecast; with one, raises `InputError` beyond 48 h.
    """
    if error is None:
        return weather.at("T_dry_C", time_s), weather.at("global_W_m2", time_s)
    return error.apply(time_s, lambda at_s: weather.at("T_dry_C", at_s), lambda at_s: weather.at("global_W_m2", at_s))
