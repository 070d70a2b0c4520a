"""Ridge autoregression on the control-free series, with or without the weather forecast (ARX).

statsmodels' `AutoReg` is not used because it accepts no gaps. A sixth of the windows of a measured house have gaps;
fitted only to the data after the last gap, 49 lags are up to a fifth worse over 24 h. On windows without gaps both
methods are similar (the ridge is 1 % better in the mean).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.data.series import step_means
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.checks import LEVELS, checked_free, quantiles_from_errors

# A fit needs this many equations per unknown.
_EQUATIONS_PER_UNKNOWN = 2.0


class Autoregressive:
    """Ridge regression of the next change on the last `lags` values; iterated over the horizon.

    With `weather`, the forecasts of outdoor temperature, °C, and irradiance, W/m² (means over the step) are inputs as
    well. The model is refitted at each call to the given history only.
    """

    def __init__(self, lags: int = 26, ridge: float = 1e-2, *, weather: bool = False) -> None:
        if lags < 1 or ridge <= 0:
            raise DataError(f"autoregression: lags ({lags}) must be at least 1 and ridge ({ridge}) positive")
        self.lags, self.ridge, self.weather = lags, ridge, weather

    @property
    def name(self) -> str:
        """Name in the tables."""
        return f"{'arx' if self.weather else 'ar'}{self.lags}"

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`.

        Raises:
            DataError: too little history for the number of lags, gaps in the last lags, or weather that is not finite.
        """
        free = checked_free(free_C, history)
        lags, n = self.lags, boundary.n_steps
        if not np.isfinite(free[-lags:]).all():
            raise DataError(f"autoregression: the last {lags} values of the control-free history have gaps")
        past, ahead = (
            self._exogenous(history.T_out_C, history.solar_W_m2),
            self._exogenous(boundary.T_out_C, boundary.solar_W_m2),
        )
        if not np.isfinite(ahead).all():
            raise DataError("autoregression: the weather forecast has values that are not finite")
        if free.size <= lags:
            raise DataError(f"autoregression of {lags} lags: only {free.size} values of history")
        windows = np.lib.stride_tricks.sliding_window_view(free, lags)[:-1]
        X = _regressors(windows, past[lags - 1 :])
        y = free[lags:] - windows[:, -1]
        usable = np.isfinite(X).all(axis=1) & np.isfinite(y)
        if usable.sum() < _EQUATIONS_PER_UNKNOWN * X.shape[1]:
            raise DataError(
                f"autoregression of {lags} lags: {int(usable.sum())} usable steps of history, "
                f"need {int(_EQUATIONS_PER_UNKNOWN * X.shape[1])}"
            )
        center_x, scale = X[usable].mean(axis=0), X[usable].std(axis=0)
        scale = np.where(scale > 1e-9, scale, 1.0)
        Z = (X[usable] - center_x) / scale
        offset = y[usable].mean()
        penalty = self.ridge * usable.sum() * np.eye(Z.shape[1])
        weights = np.linalg.solve(Z.T @ Z + penalty, Z.T @ (y[usable] - offset))

        def roll(start: Array, weather: Array, steps: int) -> Array:
            """Iterate from windows `start` (k, lags) with `weather` (k, steps, e); shape (k, steps)."""
            window, out = start.copy(), np.empty((start.shape[0], steps))
            for t in range(steps):
                x = _regressors(window, weather[:, t])
                out[:, t] = window[:, -1] + offset + ((x - center_x) / scale) @ weights
                window = np.hstack([window[:, 1:], out[:, t : t + 1]])
            return out

        center = roll(free[None, -lags:], ahead[None], n)[0]
        errors = self._past_errors(free, past, n, roll)
        note = f"ridge autoregression of {lags} lags{' with weather' if self.weather else ''}"
        return FreeForecast(LEVELS, quantiles_from_errors(center, errors), note)

    def _exogenous(self, T_out_C: Array, solar_W_m2: Array) -> Array:
        """Means over each step, shape (steps, 2) with weather, (steps, 0) without."""
        if not self.weather:
            return np.empty((T_out_C.size - 1, 0))
        columns = [step_means(x) for x in (T_out_C, solar_W_m2 / 100.0)]
        return np.stack(columns, axis=1)

    def _past_errors(self, free: Array, past: Array, n: int, roll: Callable[[Array, Array, int], Array]) -> Array:
        """In-sample errors of the fitted model from starts a few hours apart, K, shape (starts, n)."""
        starts = np.arange(self.lags, free.size - n, max(1, n // 8))
        starts = np.array([s for s in starts if np.isfinite(free[s - self.lags : s]).all()], dtype=int)
        if starts.size == 0:
            return np.full((1, n), np.nan)
        windows = np.stack([free[s - self.lags : s] for s in starts])
        weather = np.stack([past[s - 1 : s - 1 + n] for s in starts])
        truth = np.stack([free[s : s + n] for s in starts])
        return np.asarray(truth - roll(windows, weather, n))


def _regressors(windows: Array, weather: Array) -> Array:
    """Regressors, shape (k, lags + e): differences to the last value, last value, weather."""
    last = windows[:, -1:]
    return np.hstack([windows[:, :-1] - last, last, weather])
