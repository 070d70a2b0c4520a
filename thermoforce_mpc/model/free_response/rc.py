"""Linear, weather-driven free response of the grey-box model (paper eq:free-evol) with q parallel modes.

z_i(t+1) = a_i z_i(t) + c_i T_out(t) + d_i I_sol(t) + e_i and T_free = Σ z_i. One mode is the paper's (a, c, d, e); a
building with a slab needs two. Irradiance and constant may also have a daily wave (zero weights in the paper's form),
since gains depend on the sun's position and the time of day. A Kalman filter (Kalman 1960) estimates the modes from the
control-free history, skipping missing values; its covariance gives the quantiles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from hashlib import blake2b
from typing import TYPE_CHECKING

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Boundary, FreeForecast, Record, steps_in
from thermoforce_mpc.data.series import first_order, step_means
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution.cooperative import Computation
from thermoforce_mpc.model.free_response.checks import LEVELS, checked_free

if TYPE_CHECKING:
    from thermoforce_mpc.model.operator.casadi_export import Buffered

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

# The square is as large as the irradiance itself at that of a winter's noon: its weight is fitted, so that this is a
# unit.
_SQUARE_W_M2 = 300.0

# Least eigenvalue of a covariance, as a share of its largest element: rounding.
_ROUNDING = 1e-6


# Steps that the filter is built for. A record is filtered in blocks of them: a filter of its own length would be built
# anew in each step of a run, which took most of a forecast (20 ms of 25 with a record of two weeks, 2026-11-28).
_BLOCK = 64

# Least pole, that of a mode which is over within a step: its logarithm must be finite, no overflow.
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
    # Rounding to tenths is 0.03, to hundredths 0.003; identification says its own.
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
        day = steps_in(DAY_S, self.step_s)
        return np.asarray(drive[:day].mean(axis=0) / (1.0 - self.poles))


def _covariance(matrix: Array) -> Array:
    """The nearest covariance to a symmetric matrix (q, q): noise of long steps may be none of shorter ones."""
    sizes, directions = np.linalg.eigh(matrix)
    return np.asarray((directions * np.maximum(sizes, 0.0)) @ directions.T)


def weather_inputs(time_s: Array, T_out_C: Array, solar_W_m2: Array) -> Array:
    """Return `INPUTS` over n steps, shape (n, 8): means of the samples at both ends of a step; arguments (n + 1,)."""
    T_out, solar = step_means(T_out_C), step_means(solar_W_m2)
    # Daily phase at mid-step, zero at noon.
    angle = 2.0 * np.pi * (step_means(time_s) / DAY_S - 0.5)
    cosine, sine = np.cos(angle), np.sin(angle)
    square = solar**2 / _SQUARE_W_M2
    return np.stack([T_out, solar, np.ones_like(T_out), solar * cosine, solar * sine, cosine, sine, square], axis=1)


class RcFreeResponse:
    """`FreeResponse` by the grey-box model: filter the control-free history, then simulate the weather forecast.

    What it keeps of a call saves work where the next record is the same one, grown; it changes no result.
    """

    name = "rc"

    def __init__(self, params: RcParameters) -> None:
        self._at_step = {params.step_s: params}
        self._last: dict[float, _Filtered] = {}

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises `DataError` for no finite value or gaps in the weather."""
        free_C = checked_free(free_C, history)
        past = self._resampled(history.step_s if history.n_steps else boundary.step_s)
        drive = past.drive(history.time_s, history.T_out_C, history.solar_W_m2)
        if not np.isfinite(drive).all():
            raise DataError("weather of the history has values that are not finite")
        self._last[past.step_s] = last = _filtered(past, drive, free_C, self._last.get(past.step_s))
        ahead = self._resampled(boundary.step_s)
        drive = ahead.drive(boundary.time_s, boundary.T_out_C, boundary.solar_W_m2)
        if not np.isfinite(drive).all():
            raise DataError("weather forecast has values that are not finite")
        center, variance = _simulated(ahead, drive, last.mean, last.covariance)
        quantiles = center + _normal_scores()[:, None] * np.sqrt(variance)
        note = f"linear free model of order {ahead.order}, weather-driven"
        return FreeForecast(levels=LEVELS, quantiles_C=quantiles, note=note)

    def following(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> Computation[tuple[FreeForecast, object]]:
        """See `ComputedFreeResponse.following`; it requests nothing: a thread of its own costs as much as its work."""
        yield from ()
        return self.forecast(free_C, history, boundary), None

    def _resampled(self, step_s: float) -> RcParameters:
        if step_s not in self._at_step:
            first = next(iter(self._at_step.values()))
            self._at_step = {first.step_s: first, step_s: first.resampled(step_s)}
        return self._at_step[step_s]


@cache
def _normal_scores() -> Array:
    from scipy.special import ndtri

    return np.asarray(ndtri(LEVELS))


def _simulated(params: RcParameters, drive: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Mean and variance (n,) of the temperature after each step of `drive` (n, q) from those of the modes."""
    q, each = params.order, np.outer(params.poles, params.poles).ravel()
    noise = np.broadcast_to(params.process_K2.ravel(), (len(drive), q * q))
    variances = first_order(each, noise, covariance.ravel())
    return first_order(params.poles, drive, mean).sum(axis=1), variances.sum(axis=1)


@dataclass(frozen=True)
class _Filtered:
    """The modes, mean (q,) and covariance (q, q), at the last reading of a record, and what they rest on.

    `digests`: of the steps of each whole block, which take no memory where a process plans for many; `states` (blocks,
    q + q²): mean and covariance before each block.
    """

    mean: Array
    covariance: Array
    digests: tuple[bytes, ...]
    states: Array


def _filtered(params: RcParameters, drive: Array, free_C: Array, before: _Filtered | None = None) -> _Filtered:
    """The modes at the last of `free_C` (n + 1,), by each that is known.

    From the first block on in which something differs from `before`, of the same parameters.
    """
    q, n = params.order, len(drive)
    known = np.isfinite(free_C)
    # Of each step whether it has a reading, that reading, and the drive of the modes.
    of_steps = np.zeros((n + 1, 2 + q))
    of_steps[:, 0], of_steps[:, 1], of_steps[:n, 2:] = known, np.where(known, free_C, 0.0), drive
    begin = np.concatenate([params.beginning(drive) if n else np.zeros(q), params.start_K2.ravel()])
    blocks, same = -(-(n + 1) // _BLOCK), 0
    states = np.empty((blocks, begin.size))
    # The last step of a record goes nowhere, so that its block is another in a longer one.
    whole = of_steps[: n // _BLOCK * _BLOCK].reshape(-1, _BLOCK, 2 + q)
    digests = tuple(blake2b(block.tobytes(), digest_size=16).digest() for block in whole)
    if before is not None and np.array_equal(begin, before.states[0]):
        pairs = enumerate(zip(digests, before.digests, strict=False))
        same = next((i for i, (now, then) in pairs if now != then), min(len(digests), len(before.digests)))
        states[: same + 1] = before.states[: same + 1]
    states[0] = begin
    first = same * _BLOCK
    # The last step stays where its reading has brought the modes, and so do those that fill a block.
    steps = np.zeros((blocks * _BLOCK - first, 2 + q + q + q * q + 1))
    steps[: n + 1 - first, : 2 + q] = of_steps[first:]
    steps[: n - first, 2 + q : 2 + 2 * q], steps[n - first :, 2 + q : 2 + 2 * q] = params.poles, 1.0
    steps[: n - first, 2 + 2 * q : -1], steps[:, -1] = params.process_K2.ravel(), params.sensor_sd_K**2
    last, of_block = states[same], _filter(q)
    for i, block in enumerate(steps.reshape(blocks - same, -1), start=same):
        states[i] = last
        last = of_block(last, block)[0][-last.size :].copy()
    return _Filtered(last[:q], last[q:].reshape(q, q), digests, states)


@lru_cache(16)
def _filter(q: int) -> Buffered:
    """A Kalman filter of q modes over the steps of a block: mean and covariance before, and of each step whether it has
    a reading, that reading, what drives the modes, poles, process noise and the reading's, → mean and covariance after
    each.

    By CasADi, which a controller holds: numba would take 90 MB of a process that compiles nothing else.
    """
    import casadi as ca

    from thermoforce_mpc.model.operator.casadi_export import Buffered

    mean, covariance, known, reading = ca.SX.sym("mean", q), ca.SX.sym("P", q, q), ca.SX.sym("known"), ca.SX.sym("y")
    drive, poles, process, noise = ca.SX.sym("d", q), ca.SX.sym("a", q), ca.SX.sym("Q", q, q), ca.SX.sym("R")
    with_sum = ca.sum2(covariance)  # covariance of each mode with the temperature
    gain = known * with_sum / (noise + ca.sum1(with_sum))
    seen = mean + gain * (reading - ca.sum1(mean))
    after = ca.mtimes(poles, poles.T) * (covariance - ca.mtimes(gain, with_sum.T)) + process
    of_step = ca.veccat(known, reading, drive, poles, process, noise)
    moved = ca.veccat(poles * seen + drive, after)
    return Buffered(ca.Function("filter", [ca.veccat(mean, covariance), of_step], [moved]).mapaccum(_BLOCK))
