"""What a policy is trained on: courses of free response, comfort bounds and prices, drawn at random.

The free responses are those of the identified linear free model under synthetic weather years. Nothing of the window in
which the policy will act is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, YEAR_S, Array
from thermoforce_mpc.model.free_response.rc import RcParameters

# Years of weather, and their shift: the building's climate is not known.
_WEATHERS, _SHIFT_K = 4, 5.0
# Courses whose free response stays this far inside the bounds call for nothing.
_IDLE_K = 1.0
_PATIENCE = 40


@dataclass(frozen=True)
class Situations:
    """B courses of n steps: (B, n) at the end of each step `T_free_C`, `lower_C`, `upper_C`; over it `price_per_kWh`.

    At the start of each step: `T_out_C`, `solar_W_m2`, and `time_s` s.
    """

    T_free_C: Array
    lower_C: Array
    upper_C: Array
    price_per_kWh: Array
    T_out_C: Array
    solar_W_m2: Array
    time_s: Array


class Drawer:
    """Draws courses of a zone.

    Args:
        free: its linear free model.
        step_s: length of a step, s.
        sign: +1 for heating, −1 for cooling.
        seed: seed of everything drawn.
    """

    def __init__(self, free: RcParameters, step_s: float, sign: int, seed: int) -> None:
        self._step_s, self._sign = step_s, sign
        self._rng = np.random.default_rng([seed, 17])
        self._time_s = np.arange(0.0, YEAR_S + step_s / 2, step_s)
        model = free.resampled(step_s)
        self._years = []
        for i in range(_WEATHERS):
            weather = synthetic_weather(1000 + i)
            T_out, solar = weather.at("T_dry_C", self._time_s), weather.at("global_W_m2", self._time_s)
            drive = model.drive(self._time_s, T_out, solar)
            # From the second year on the course no longer depends on how it began.
            rows = [
                lfilter([1.0], [1.0, -a], np.tile(x, 2))[x.size :] for a, x in zip(model.poles, drive.T, strict=True)
            ]
            self._years.append((np.sum(rows, axis=0), T_out, solar))
        self._per_K = float((model.weights[:, 0] / (1.0 - model.poles)).sum())

    def draw(self, courses: int, n_steps: int) -> Situations:
        """Draw `courses` of `n_steps`, not longer than half a year, in which something is to be done."""
        drawn = [self._draw_one(n_steps) for _ in range(courses)]
        return Situations(*(np.stack(rows) for rows in zip(*drawn, strict=True)))

    def _draw_one(self, n: int) -> tuple[Array, ...]:
        rng = self._rng
        for _ in range(_PATIENCE):
            T_free, T_out, solar = self._years[int(rng.integers(_WEATHERS))]
            first = int(rng.integers(T_free.size - n))
            at, shift = slice(first, first + n), rng.uniform(-_SHIFT_K, _SHIFT_K)
            time_s = self._time_s[at]
            lower, upper = self._bounds(time_s + self._step_s)
            free = T_free[at] + shift * self._per_K + self._disturbance(n)
            off = free < upper - _IDLE_K if self._sign > 0 else free > lower + _IDLE_K
            if off.mean() > 0.5:
                break
        return free, lower, upper, self._prices(time_s), T_out[at] + shift, solar[at], time_s

    def _disturbance(self, n: int) -> Array:
        """What the linear model does not know: a course of 0.4 K that fades over hours."""
        keep = np.exp(-self._step_s / (8.0 * HOUR_S))
        noise = 0.4 * np.sqrt(1.0 - keep**2) * self._rng.standard_normal(n)
        return np.asarray(lfilter([1.0], [1.0, -keep], noise))

    def _bounds(self, time_s: Array) -> tuple[Array, Array]:
        """Bounds of a household: always at home, away by day, or with a set-back by night; margins inside."""
        rng = self._rng
        hour, day = time_s % DAY_S / HOUR_S, time_s // DAY_S % 7
        kind = rng.integers(3)
        begins, ends = (rng.uniform(6.0, 9.0), rng.uniform(15.0, 21.0)) if kind == 1 else (rng.uniform(21, 24), 0.0)
        if kind == 1:
            relaxed = (hour >= begins) & (hour < ends) & (day != 4) & (day != 5)
        else:
            relaxed = (kind == 2) & ((hour >= begins) | (hour < rng.uniform(4.0, 8.0)))
        lower, width = rng.uniform(19.0, 22.5), rng.uniform(1.5, 4.0)
        depth, wider = rng.uniform(1.0, 7.0), rng.uniform(0.0, 6.0)
        below, above = rng.uniform(0.0, 0.35, 2)
        return np.where(relaxed, lower - depth, lower) + below, np.where(
            relaxed, lower + width + wider, lower + width
        ) - above

    def _prices(self, time_s: Array) -> Array:
        """A constant, day and night, or hourly price around 0.25 per kWh."""
        rng, hour = self._rng, time_s % DAY_S / HOUR_S
        kind = rng.integers(3)
        if kind == 0:
            return np.full(time_s.size, 0.25)
        if kind == 1:
            ratio = rng.uniform(1.0, 2.0)
            return np.where((hour >= 7) & (hour < 22), 0.25, 0.25 / ratio)
        hours = np.cumsum(np.r_[0, np.diff(time_s // HOUR_S) > 0])
        course = lfilter([1.0], [1.0, -0.8], 0.6 * rng.standard_normal(int(hours[-1]) + 1))
        return np.asarray(0.25 * np.exp(rng.uniform(0.1, 0.4) * course)[hours])
