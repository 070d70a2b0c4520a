"""Exponential smoothing, damped trend and daily season: ETS(A, Ad, A), Hyndman and Athanasopoulos 2021, ch. 8."""

from __future__ import annotations

import importlib.util
import warnings

import numpy as np
import pandas as pd
from scipy.stats import norm

from thermoforce_mpc.data import DAY_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.model.free_response.checks import LEVELS, checked_free


class ExponentialSmoothing:
    """statsmodels' `ETSModel` with heuristic initial states; smoothing constants by maximum likelihood at every call.

    Estimating the initial seasonal states as well would take 20 to 50 times as long.
    """

    name = "ets"

    def __init__(self) -> None:
        """Import statsmodels; raises `ConfigError` if it is not installed."""
        if importlib.util.find_spec("statsmodels") is None:
            raise ConfigError("the baseline 'ets' needs statsmodels, which is not installed: pip install -e '.[bench]'")

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`.

        The model accepts no gaps. It is fitted to the latest gap-free stretch of at least two days and forecasts from
        its end.

        Raises:
            DataError: the history has no gap-free stretch of two days.
        """
        from statsmodels.tools.sm_exceptions import ConvergenceWarning
        from statsmodels.tsa.exponential_smoothing.ets import ETSModel

        free = checked_free(free_C, history)
        n, day = boundary.n_steps, round(DAY_S / boundary.step_s)
        known = _latest_without_gap(free, 2 * day)
        # `get_prediction` needs an index, so the data are passed as a series.
        series = pd.Series(free[known])
        model = ETSModel(
            series,
            error="add",
            trend="add",
            damped_trend=True,
            seasonal="add",
            seasonal_periods=day,
            initialization_method="heuristic",
        )
        with warnings.catch_warnings():  # constants that have not fully converged are good enough
            warnings.simplefilter("ignore", ConvergenceWarning)
            fit = model.fit(disp=False)
        first = free.size - known.start
        ahead = fit.get_prediction(first, first + n - 1)
        spread = np.sqrt(np.asarray(ahead.forecast_variance))
        quantiles = np.asarray(ahead.predicted_mean) + norm.ppf(LEVELS)[:, None] * spread
        return FreeForecast(LEVELS, quantiles, "exponential smoothing, ETS(A, Ad, A)")


def _latest_without_gap(free: Array, least: int) -> slice:
    """Slice of the latest stretch of at least `least` finite values; raises `DataError` if there is none."""
    gaps = np.concatenate([[-1], np.flatnonzero(~np.isfinite(free)), [free.size]])
    sizes = np.diff(gaps) - 1
    long = np.flatnonzero(sizes >= least)
    if not long.size:
        raise DataError(
            f"exponential smoothing needs two days of history without a gap, got {sizes.max()} of {least} values"
        )
    return slice(int(gaps[long[-1]]) + 1, int(gaps[long[-1] + 1]))
