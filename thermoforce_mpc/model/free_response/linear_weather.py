"""Linear free response to the weather with physical constraints, fitted to the control-free history at every call.

Parallel first-order modes with fixed time constants (paper eq:free-evol with q poles), driven by outdoor temperature
and irradiance, plus a daily wave. Weights of outdoor temperature and irradiance are ≥ 0, and a prior sets the long-run
gain to the outdoor temperature to 1 (not a constraint: neighbours and ground may hold the zone). With fixed poles the
*simulated* temperature is linear in the parameters, so the fit is a convex bounded least-squares problem over the whole
history instead of one-step changes, which gives the better 24-h forecast.

Persistence forecast: the reference for other forecasters, and the fallback for short histories.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.data.series import first_order, step_means
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.checks import LEVELS, checked_free, quantiles_from_errors


class Persistence:
    """`FreeResponse` that holds the last finite value; quantiles from past changes over each lead time."""

    name = "persistence"

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises `DataError` if no value was measured."""
        free = checked_free(free_C, history)
        n = boundary.n_steps
        last = free[np.flatnonzero(np.isfinite(free))[-1]]
        errors = np.full((free.size, n), np.nan)
        for lead in range(1, min(n, free.size - 1) + 1):
            errors[: free.size - lead, lead - 1] = free[lead:] - free[:-lead]
        return FreeForecast(LEVELS, quantiles_from_errors(np.full(n, last), errors), "persistence")


# Time constants from room air to massive structure, h. By judgement, a factor of three apart; a third more changes the
# cost of a day by 1e-5 (`benchmarks.constants`, 2026-11-28).
TIME_CONSTANTS_H = np.array([0.5, 2.0, 6.0, 20.0, 60.0, 200.0])
SHORTEST_HISTORY_S = DAY_S
# Correlation times of the errors, h: the first is better if the model is nearly right, the second if it is not, and
# their mean nearly always. Chosen on free runs of EnergyPlus and of the embedded plant that no table of the
# documentation uses.
DISTURBANCES_H = (None, 24.0)
# Weights of the priors, relative to one data row with an error of 1 K; the data have hundreds of rows. By judgement
# (`bench free-response`, 2026-11-21); a third more of each moves nothing on a cold day of the heat pump
# (`benchmarks.constants`, 2026-11-28).
_RIDGE_WEATHER = 0.1
_RIDGE_WAVE = 1.0
_RIDGE_START = 0.01
_LONG_RUN_GAIN_WEIGHT = 5.0
# Unit of irradiance that gives weights of order one, W/m²: priors are then alike.
_SOLAR_UNIT_W_M2 = 100.0
# Time constants that are tried for how the last error fades, h: a factor of three apart, as above; between them
# forecasts would be alike.
_SHORT_TAU_H = (1.0, 3.0, 8.0, 24.0, 72.0)


def simulated(drives: Array, waves: Array, poles: Array, start: Array) -> Array:
    """Simulated response per unit of every parameter: (n, d q + w + q) for d drives, w waves, q modes.

    `drives` (n, d) at all boundaries, linear in between; `waves` (n, w): given columns; `poles` (q,) per step; `start`
    (d,): state of all modes for each input at the first boundary. The columns are modes of steady gain 1 for each
    input, the waves, and the decay of each mode.
    """
    (n, d), w, q = drives.shape, waves.shape[1], poles.size
    mean = step_means(drives.T)
    begin = np.broadcast_to(start[:, None], (d, q))
    columns = np.empty((n, d * q + w + q))
    columns[0, : d * q] = begin.ravel()
    modes = first_order(poles, mean[..., None] * (1.0 - poles), begin)  # (d, n − 1, q)
    columns[1:, : d * q] = modes.transpose(1, 0, 2).reshape(n - 1, d * q)
    columns[:, d * q : -q], columns[:, -q:] = waves, _decay(poles.tobytes(), n)
    return columns


@lru_cache(4)
def _decay(poles: bytes, n: int) -> Array:
    """What is left of each mode after 0 … n − 1 steps (n, q): powers, which a run asks for in every step."""
    left = np.frombuffer(poles) ** np.arange(n)[:, None]
    left.setflags(write=False)
    return left


def whitened(columns: Array, targets: Array, decay: float) -> tuple[Array, Array]:
    """Rows (k, p) of `columns` (n or more, p) whose target (n,) is finite, and their targets (k,), as innovations.

    `decay` per step of first-order errors: innovations are scaled to the variance of the errors, so that priors weigh
    the same whatever it is; across a gap the correlation decays over its length. 0: independent errors.
    """
    at = np.flatnonzero(np.isfinite(targets))
    rows, values = columns[at], targets[at]
    if decay > 0.0:
        kept = decay ** np.diff(at)
        unit = 1.0 / np.sqrt(1.0 - kept**2)
        rows[1:] = unit[:, None] * (rows[1:] - kept[:, None] * columns[at[:-1]])
        values[1:] = unit * (values[1:] - kept * targets[at[:-1]])
    return rows, values


@dataclass(frozen=True)
class LinearFit:
    """Simulated temperature over history (n + 1,) and horizon (N,), °C, not corrected by the last measurement.

    `weights` (p,): its parameters in the order of the columns.
    """

    past_C: Array
    ahead_C: Array
    weights: Array


def fits_linear_weather(
    free_C: Array, history: Record, boundary: Boundary, disturbances_h: Sequence[float | None] = (None,)
) -> list[LinearFit]:
    """Fit to the finite values of `free_C` (n + 1,) °C and simulate over `boundary`, for each kind of disturbance.

    `disturbances_h`: None for independent errors (ordinary least squares), else the time constant, h, of first-order
    autocorrelated ones (generalised least squares), so that a disturbance of a few days has less influence. Raises
    `DataError` for less than a day of history, weather that is not finite, or steps that differ.
    """
    step_s = boundary.step_s
    if history.n_steps * step_s < SHORTEST_HISTORY_S:
        raise DataError(f"linear weather model needs a day of history, got {history.n_steps * step_s / HOUR_S:g} h")
    if abs(history.step_s - step_s) > 1e-6:
        raise DataError(f"history at {history.step_s:g} s and forecast at {step_s:g} s differ in step")
    time_s = np.concatenate([history.time_s, boundary.time_s[1:]])
    T_out = np.concatenate([history.T_out_C, boundary.T_out_C[1:]])
    solar = np.concatenate([history.solar_W_m2, boundary.solar_W_m2[1:]])
    for name, values in (("T_out_C", T_out), ("solar_W_m2", solar)):
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise DataError(f"linear weather model: {name} is not finite at step {bad[0]} ({bad.size} such)")
    return fitted(free_C, time_s, T_out, solar, step_s, disturbances_h)


def fitted(
    free_C: Array, time_s: Array, T_out: Array, solar: Array, step_s: float, disturbances_h: Sequence[float | None]
) -> list[LinearFit]:
    """Fit to the finite values of `free_C` (k,), for finite weather (n,) at the same instants and after them."""
    columns, bounded, ridge = _columns(time_s, T_out, solar, step_s)
    modes = TIME_CONSTANTS_H.size
    # Columns 0..modes-1 are the outdoor gains: their sum is the long-run gain.
    long_run = np.zeros(bounded.size)
    long_run[:modes] = _LONG_RUN_GAIN_WEIGHT
    prior = np.diag(ridge) + np.outer(long_run, long_run)
    fits = []
    for disturbance_h in disturbances_h:
        decay = 0.0 if disturbance_h is None else float(np.exp(-step_s / HOUR_S / disturbance_h))
        rows, targets = whitened(columns, free_C, decay)
        weights = _bounded_least_squares(
            rows.T @ rows + prior, targets @ rows + _LONG_RUN_GAIN_WEIGHT * long_run, bounded
        )
        course = columns @ weights
        fits.append(LinearFit(course[: free_C.size], course[free_C.size :], weights))
    return fits


def mean_course(fits: Sequence[LinearFit]) -> Array:
    """Mean course of the models over past and future (n,), °C."""
    return np.asarray(np.mean([np.concatenate([fit.past_C, fit.ahead_C]) for fit in fits], axis=0))


def _bounded_least_squares(gram: Array, right: Array, bounded: NDArray[np.bool_]) -> Array:
    """Return the exact minimiser of |A w − b| with w ≥ 0 for the `bounded` columns, from A'A and A'b.

    There are thousands of rows and few columns; the priors make A'A positive definite. With the free columns first in
    the Cholesky factor, the bounded ones form a nonnegative least-squares problem and the free ones follow.
    """
    from scipy.linalg.lapack import dpotrf, dtrtrs
    from scipy.optimize import nnls

    order = np.argsort(bounded, kind="stable")
    free = int((~bounded).sum())
    # LAPACK itself: around arrays this small, what checks them takes longer than the arithmetic.
    R, failed = dpotrf(gram[np.ix_(order, order)])
    if failed:
        raise DataError("linear weather model: its equations are not positive definite")
    z, _ = dtrtrs(R, right[order], trans=1)
    above, _ = nnls(R[free:, free:], z[free:])
    weights = np.empty(bounded.size)
    weights[order[free:]] = above
    weights[order[:free]], _ = dtrtrs(R[:free, :free], z[:free] - R[:free, free:] @ above)
    return weights


class LinearWeather:
    """`FreeResponse` by the fitted linear model; its last residual decays as past residuals did."""

    name = "linear_weather"

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises what `fits_linear_weather` raises."""
        free = checked_free(free_C, history)
        (fit,) = fits_linear_weather(free, history, boundary)
        residual = free - fit.past_C
        n = boundary.n_steps
        fading = _fading(residual, n, boundary.step_s)
        latest = np.flatnonzero(np.isfinite(residual))[-1]
        # If the last measurements are missing, the last residual has decayed since.
        age = residual.size - 1 - latest
        tail = np.concatenate([fading, np.full(age, fading[-1])])[age:]
        center = fit.ahead_C + residual[latest] * tail
        errors = np.full((residual.size, n), np.nan)
        for lead in range(1, min(n, residual.size - 1) + 1):
            errors[: residual.size - lead, lead - 1] = residual[lead:] - fading[lead - 1] * residual[:-lead]
        note = "linear model of outdoor temperature and sun"
        return FreeForecast(LEVELS, quantiles_from_errors(center, errors), note)


def _columns(time_s: Array, T_out: Array, solar: Array, step_s: float) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return the simulated response per unit of every parameter (n + N + 1, p), which are ≥ 0, ridge weights (p,)."""
    q = TIME_CONSTANTS_H.size
    hour_angle = 2 * np.pi * time_s / DAY_S
    cosine, sine = np.cos(hour_angle), np.sin(hour_angle)
    waves = (np.ones(time_s.size), cosine, sine, 2 * cosine**2 - 1, 2 * sine * cosine)  # waves once and twice a day
    columns = simulated(
        np.stack([T_out, solar / _SOLAR_UNIT_W_M2], axis=1),
        np.stack(waves, axis=1),
        np.exp(-step_s / HOUR_S / TIME_CONSTANTS_H),
        np.array([T_out[0], 0.0]),
    )
    ridge = np.full(columns.shape[1], _RIDGE_WAVE)
    ridge[: 2 * q], ridge[2 * q], ridge[-q:] = _RIDGE_WEATHER, 0.0, _RIDGE_START
    return columns, np.arange(columns.shape[1]) < 2 * q, ridge


def _fading(residual: Array, n: int, step_s: float) -> Array:
    """Return exp(−lead / τ), shape (n,), with the τ of `_SHORT_TAU_H` that best predicts the past residuals."""
    leads = np.arange(1, n + 1)
    hours = leads * step_s / HOUR_S
    best, least = np.zeros(n), np.inf
    for tau_h in _SHORT_TAU_H:
        fading = np.exp(-hours / tau_h)
        loss = 0.0
        for lead in leads[:: max(1, n // 8)]:
            if lead < residual.size:
                gap = residual[lead:] - fading[lead - 1] * residual[:-lead]
                loss += float(np.mean(np.abs(gap[np.isfinite(gap)]))) if np.isfinite(gap).any() else 0.0
        if loss < least:
            best, least = fading, loss
    return best
