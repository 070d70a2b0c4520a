"""Forecasts a method would have given at past instants from what was known then: to choose and to calibrate by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.following import follow
from thermoforce_mpc.protocols import FreeResponse

_INSIDE = 0.8
# A week of trials cannot justify more than this.
_SCALE_RANGE = (0.5, 4.0)


@dataclass(frozen=True)
class Trial:
    """One past forecast and what came, shape (N,), NaN where the sensor was silent."""

    forecast: FreeForecast
    truth_C: Array

    @property
    def error_K(self) -> float:
        """Mean absolute error of the median over what was measured (NaN if nothing was)."""
        known = np.isfinite(self.truth_C)
        return float(np.abs(self.truth_C - self.forecast.median_C)[known].mean()) if known.any() else float("nan")


def trial_origins(n_steps: int, horizon: int, *, least_context: int, span: int, every: int) -> list[int]:
    """Instants to forecast from, rising; the horizon of the last one ends now.

    Args:
        n_steps: steps of the history.
        horizon: steps of a forecast.
        least_context: steps every forecast must have behind it.
        span: how far back the earliest may lie, steps.
        every: steps between two of them; no divisor of a day, so that all hours of the day come up.
    """
    last = n_steps - horizon
    first = max(least_context, last - span)
    return sorted(range(last, first - 1, -every))


def past_task(free_C: Array, history: Record, origin: int, horizon: int) -> tuple[Array, Record, Boundary]:
    """What a free response is given at step `origin` of the history, with the weather that came as its forecast."""
    ahead = history.slice(origin, origin + horizon)
    return free_C[: origin + 1], history.slice(0, origin), ahead.weather()


def run_trials(
    method: FreeResponse, free_C: Array, history: Record, horizon: int, origins: Sequence[int]
) -> list[Trial] | None:
    """Let `method` forecast `horizon` steps from each origin, with the weather that came as its weather forecast.

    A method that cannot (`DataError` at any origin) yields None.
    """
    trials = []
    state: object = None
    for origin in origins:
        try:
            forecast, state = follow(method, *past_task(free_C, history, origin, horizon), state)
        except DataError:
            return None
        trials.append(Trial(forecast, free_C[origin + 1 : origin + horizon + 1]))
    return trials


def interval_scale(trials: Sequence[Trial], groups: int = 4, least_values: int = 1) -> Array:
    """Factor for the distance of each quantile from the median that would have put 80 % inside, per step, shape (N,).

    Split conformal prediction with normalised scores (Angelopoulos and Bates 2023): the score of a value is its
    distance from the median over that of the outer quantile on its side. Neighbouring lead times share a factor; it is
    one where fewer than `least_values` values are known.
    """
    horizon = trials[0].truth_C.size
    scale = np.ones(horizon)
    for lead in np.array_split(np.arange(horizon), min(groups, horizon)):
        scores = []
        for trial in trials:
            gap = trial.truth_C[lead] - trial.forecast.median_C[lead]
            up = trial.forecast.quantiles_C[-1][lead] - trial.forecast.median_C[lead]
            down = trial.forecast.median_C[lead] - trial.forecast.quantiles_C[0][lead]
            side = np.maximum(np.where(gap >= 0, up, down), 1e-6)
            scores.append((np.abs(gap) / side)[np.isfinite(gap)])
        found = np.concatenate(scores)
        if found.size >= max(least_values, 1):
            scale[lead] = np.quantile(found, _INSIDE)
    return np.clip(scale, *_SCALE_RANGE)


def rescaled(forecast: FreeForecast, scale: Array) -> FreeForecast:
    """`forecast` with every quantile's distance from the median multiplied by `scale` (N,)."""
    median = forecast.median_C
    return FreeForecast(forecast.levels, np.asarray(median + scale * (forecast.quantiles_C - median)), forecast.note)
