"""Linear, weather-driven free response of the grey-box model (paper eq:free-evol) with q parallel modes.

z_i(t+1) = a_i z_i(t) + c_i T_out(t) + d_i I_sol(t) + e_i and T_free = Σ z_i. One mode is the paper's (a, c, d, e); a
building with a slab needs two. Irradiance and constant may also have a daily wave (zero weights in the paper's form),
since gains depend on the sun's position and the time of day. A Kalman filter (Kalman 1960) estimates the modes from the
control-free history, skipping missing values; its covariance gives the quantiles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.checks import LEVELS, checked_free

INPUTS: tuple[str, ...] = (
    "outdoor",
    "solar",
    "constant",
    "solar_cosine",
    "solar_sine",
    "daily_cosine",
    "daily_sine",
    "solar_squared",
)
"""Inputs of the modes: T_out °C, irradiance W/m², 1, irradiance and 1 times cosine and sine of the day from noon, and
irradiance²/300 W/m²: the beam share, and so the transmission of windows, rises with irradiance."""

_SQUARE_W_M2 = 300.0

# Least eigenvalue of a covariance, as a share of its largest element: rounding.
_ROUNDING = 1e-6


# Least pole, that of a mode which is over within a step.
_FASTEST = 1e-12


@dataclass(frozen=True)
class RcParameters:
    """Parameters of the free part of the grey-box model; raises `DataError` naming the field that is not allowed.

    `poles` (q,): a_i in (0, 1) per step. `weights` (q, 8): K per step and unit of each of `INPUTS`; the first three
    columns are c, d, e. `process_K2` (q, q): covariance of what disturbs the modes in a step. `start_K2` (q, q): that
    of the modes before the first measurement, about the steady state in the weather of the first day. `sensor_sd_K`:
    noise of the temperature sensor.
    """

    poles: Array
    weights: Array
    step_s: float
    process_K2: Array
    start_K2: Array
    sensor_sd_K: float = 0.02

    def __post_init__(self) -> None:
        q = np.size(self.poles)
        shapes = {"poles": (q,), "weights": (q, len(INPUTS)), "process_K2": (q, q), "start_K2": (q, q)}
        for name, shape in shapes.items():
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != shape or q == 0 or not np.isfinite(array).all():
                raise DataError(f"free model: {name} is {array.tolist()}, expected finite numbers of shape {shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
            if name.endswith("_K2") and np.linalg.eigvalsh(array)[0] < -_ROUNDING * np.abs(array).max():
                raise DataError(f"free model: {name} is {array.tolist()}, which is no covariance")
        if not ((self.poles > 0) & (self.poles < 1)).all():
            raise DataError(f"free model: a mode has no time constant (poles {self.poles.tolist()}, not all in (0, 1))")
        if not (self.step_s > 0 and self.sensor_sd_K > 0):
            raise DataError("free model: step_s and sensor_sd_K must be positive")

    @property
    def order(self) -> int:
        """Number of modes q."""
        return int(self.poles.size)

    def resampled(self, step_s: float) -> RcParameters:
        """Return the model at another step; exact if the weather is constant over the longer of the two steps."""
        ratio = step_s / self.step_s
        if ratio == 1.0:
            return self
        poles = np.maximum(self.poles**ratio, _FASTEST)  # a fast mode is 0 in a long step but for rounding
        scale = (1.0 - poles) / (1.0 - self.poles)
        # The process noise is scaled to keep the stationary covariance of the modes.
        spread = (1.0 - np.outer(poles, poles)) / (1.0 - np.outer(self.poles, self.poles))
        return RcParameters(
            poles=poles,
            weights=self.weights * scale[:, None],
            step_s=step_s,
            process_K2=_covariance(self.process_K2 * spread),
            start_K2=self.start_K2,
            sensor_sd_K=self.sensor_sd_K,
        )

    def drive(self, time_s: Array, T_out_C: Array, solar_W_m2: Array) -> Array:
        """Return the input of each mode in each of n steps, shape (n, q), K; weather is sampled at n + 1 boundaries."""
        return weather_inputs(time_s, T_out_C, solar_W_m2) @ self.weights.T

    def beginning(self, drive: Array) -> Array:
        """Steady state (q,), K, under the mean of the first day of `drive` (n, q)."""
        day = max(1, round(DAY_S / self.step_s))
        return np.asarray(drive[:day].mean(axis=0) / (1.0 - self.poles))


def _covariance(matrix: Array) -> Array:
    """The nearest covariance to a symmetric matrix (q, q): noise of long steps may be none of shorter ones."""
    sizes, directions = np.linalg.eigh(matrix)
    return np.asarray((directions * np.maximum(sizes, 0.0)) @ directions.T)


def weather_inputs(time_s: Array, T_out_C: Array, solar_W_m2: Array) -> Array:
    """Return `INPUTS` over n steps, shape (n, 8): means of the samples at both ends of a step; arguments (n + 1,)."""
    T_out, solar = (0.5 * (np.asarray(x)[:-1] + np.asarray(x)[1:]) for x in (T_out_C, solar_W_m2))
    time_s = np.asarray(time_s)
    # Daily phase at mid-step, zero at noon.
    angle = 2.0 * np.pi * (0.5 * (time_s[:-1] + time_s[1:]) / DAY_S - 0.5)
    cosine, sine = np.cos(angle), np.sin(angle)
    square = solar**2 / _SQUARE_W_M2
    return np.stack([T_out, solar, np.ones_like(T_out), solar * cosine, solar * sine, cosine, sine, square], axis=1)


class RcFreeResponse:
    """`FreeResponse` by the grey-box model: filter the control-free history, then simulate the weather forecast."""

    name = "rc"

    def __init__(self, params: RcParameters) -> None:
        self._params = params

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises `DataError` for no finite value or gaps in the weather."""
        from scipy.special import ndtri

        free_C = checked_free(free_C, history)
        past = self._params.resampled(history.step_s if history.n_steps else boundary.step_s)
        drive = past.drive(history.time_s, history.T_out_C, history.solar_W_m2)
        if not np.isfinite(drive).all():
            raise DataError("weather of the history has values that are not finite")
        mean = past.beginning(drive) if len(drive) else np.zeros(past.order)
        covariance = past.start_K2.copy()
        _filter(past.poles, past.process_K2, past.sensor_sd_K**2, drive, free_C, mean, covariance)
        ahead = self._params.resampled(boundary.step_s)
        drive = ahead.drive(boundary.time_s, boundary.T_out_C, boundary.solar_W_m2)
        if not np.isfinite(drive).all():
            raise DataError("weather forecast has values that are not finite")
        center, variance = np.empty(boundary.n_steps), np.empty(boundary.n_steps)
        _simulate(ahead.poles, ahead.process_K2, drive, mean, covariance, center, variance)
        quantiles = center + ndtri(LEVELS)[:, None] * np.sqrt(variance)
        note = f"linear free model of order {ahead.order}, weather-driven"
        return FreeForecast(levels=LEVELS, quantiles_C=quantiles, note=note)


@njit(cache=True)
def _simulate(
    poles: Array, process: Array, drive: Array, mean: Array, covariance: Array, center: Array, variance: Array
) -> None:
    """Mean and variance (n,) of the temperature after each step of `drive` (n, q); moves mean and covariance."""
    q = poles.size
    for t in range(drive.shape[0]):
        center[t] = variance[t] = 0.0
        for i in range(q):
            mean[i] = poles[i] * mean[i] + drive[t, i]
            center[t] += mean[i]
            for j in range(q):
                covariance[i, j] = poles[i] * poles[j] * covariance[i, j] + process[i, j]
                variance[t] += covariance[i, j]


@njit(cache=True)
def _filter(
    poles: Array, process: Array, noise: float, drive: Array, free_C: Array, mean: Array, covariance: Array
) -> None:
    """Move mean (q,) and covariance (q, q) of the modes to the last of `free_C` (n + 1,), by each that is known."""
    q, n = poles.size, drive.shape[0]
    with_sum = np.zeros(q)  # covariance of each mode with the temperature
    for t in range(free_C.size):
        if not np.isnan(free_C[t]):
            error, total = free_C[t], noise
            for i in range(q):
                error -= mean[i]
                with_sum[i] = 0.0
                for j in range(q):
                    with_sum[i] += covariance[i, j]
                total += with_sum[i]
            for i in range(q):
                mean[i] += with_sum[i] * error / total
                for j in range(q):
                    covariance[i, j] -= with_sum[i] * with_sum[j] / total
        if t < n:
            for i in range(q):
                mean[i] = poles[i] * mean[i] + drive[t, i]
                for j in range(q):
                    covariance[i, j] = poles[i] * poles[j] * covariance[i, j] + process[i, j]
