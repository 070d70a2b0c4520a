"""Grey-box models by joint least squares of all parameters (paper eq:arx).

T(t+1) = Σ a_i T(t−i) + Σ g_i u(t−i) + c T_out + d I + e, fitted to one-step errors and then optionally to the errors of
rollouts over the horizon. The sign of the gain is unconstrained; from data under feedback the fit may give the wrong
one. Fitted to plain operation it is the observational model, whose settings are chosen by the factual error. Fitted to
both runs of the probe, its settings are chosen by the effect on validation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from benchmarks.interventions.dataset import Window
from benchmarks.interventions.methods.base import Training, best
from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.data.series import step_means

# Candidate lags (of T, of u); the first pair is the paper's model.
_ORDERS = ((1, 1), (2, 2), (4, 4), (6, 6))
_OBSERVATIONAL_ORDERS = ((1, 1),)
_RIDGE = 1e-6
_STRIDE = 2
_SUN_UNIT_W_M2 = 300.0
_ROUNDS = 20


class GreyBox:
    """`Predictor`: linear model with `lags` = (of T, of u) and `weights` in the order a, g, c, d, e."""

    def __init__(self, lags: tuple[int, int], weights: Array, note: str) -> None:
        self.lags, self.weights, self.note = lags, weights, note

    def respond(self, window: Window, u: Array) -> Array:
        """See `Predictor.respond`."""
        na, nb = self.lags
        past = window.history
        T0 = np.broadcast_to(past.T_zone_C[0, -na:], (u.shape[0], na))
        u_past = np.broadcast_to(past.u[0, past.n_steps - nb + 1 :], (u.shape[0], nb - 1))
        weather = weather_columns(window.boundary.T_out_C, window.boundary.solar_W_m2)
        weather = np.broadcast_to(weather, (u.shape[0], *weather.shape))
        return rollout(self.weights, self.lags, T0, np.concatenate([u_past, u], axis=1), weather)


def build_observational(training: Training) -> GreyBox:
    """Fit the paper's model to plain operation; choose one-step or rollout errors by the factual validation error."""
    runs = [training.probe.pair.b]
    horizon = training.validation[0].factual.n_steps
    candidates = candidates_of(runs, horizon, _OBSERVATIONAL_ORDERS)
    return candidates[best(candidates, training.validation, factual=True)]


def build_on_probe(training: Training) -> GreyBox:
    """Fit to both runs of the probe; choose order and error type by the effect on the validation windows."""
    runs = [training.probe.pair.a, training.probe.pair.b]
    candidates = candidates_of(runs, training.validation[0].factual.n_steps, _ORDERS)
    return candidates[best(candidates, training.validation)]


def candidates_of(
    runs: Sequence[Record], horizon: int, orders: Sequence[tuple[int, int]] = _ORDERS
) -> dict[str, GreyBox]:
    """Models fitted to `runs`, by their settings: each of `orders` by one-step and by rollout errors."""
    out = {}
    for lags in orders:
        one_step = fit_one_step(runs, lags)
        rolled = fit_rollouts(runs, lags, one_step, horizon)
        for name, weights in (("one-step", one_step), ("rollout", rolled)):
            gain = float(weights[lags[0] : sum(lags)].sum())
            note = f"{lags[0]} lags of T, {lags[1]} of u, {name} errors, gain {gain:+.3f} K per step"
            out[note] = GreyBox(lags, weights, note)
    return out


def weather_columns(T_out_C: Array, solar_W_m2: Array) -> Array:
    """Mean outdoor temperature, mean irradiance and 1 of each step, shape (n, 3)."""
    outdoor, sun = (step_means(x) for x in (T_out_C, solar_W_m2 / _SUN_UNIT_W_M2))
    return np.stack([outdoor, sun, np.ones(outdoor.size)], axis=1)


def fit_one_step(runs: Sequence[Record], lags: tuple[int, int]) -> Array:
    """Least-squares weights of one-step errors over `runs`, which have no gaps; order and units as `GreyBox`."""
    na, nb = lags
    longest = max(lags)
    designs, targets = [], []
    for run in runs:
        t = np.arange(longest - 1, run.n_steps)
        T = np.stack([run.T_zone_C[0, t - i] for i in range(na)], axis=1)
        u = np.stack([run.u[0, t - i] for i in range(nb)], axis=1)
        designs.append(np.concatenate([T, u, weather_columns(run.T_out_C, run.solar_W_m2)[t]], axis=1))
        targets.append(run.T_zone_C[0, t + 1])
    design, target = np.concatenate(designs), np.concatenate(targets)
    scale = np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-9)
    scaled = design / scale
    gram = scaled.T @ scaled + _RIDGE * design.shape[0] * np.eye(design.shape[1])
    return np.asarray(np.linalg.solve(gram, scaled.T @ target) / scale)


def fit_rollouts(runs: Sequence[Record], lags: tuple[int, int], start: Array, horizon: int) -> Array:
    """Weights from `start` on that minimise the errors of rollouts over `horizon` steps."""
    na, nb = lags
    first = max(lags) - 1
    T0, u, weather, target = [], [], [], []
    for run in runs:
        drivers = weather_columns(run.T_out_C, run.solar_W_m2)
        for t in range(first, run.n_steps - horizon + 1, _STRIDE):
            T0.append(run.T_zone_C[0, t - na + 1 : t + 1])
            u.append(run.u[0, t - nb + 1 : t + horizon])
            weather.append(drivers[t : t + horizon])
            target.append(run.T_zone_C[0, t + 1 : t + horizon + 1])
    arrays = np.array(T0), np.array(u), np.array(weather)
    measured = np.array(target)

    def errors(weights: Array) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            rolled = rollout(weights, lags, *arrays)
        return np.nan_to_num(np.clip(rolled - measured, -1e3, 1e3), nan=1e3).ravel()

    return np.asarray(least_squares(errors, start, x_scale="jac", max_nfev=_ROUNDS).x)


def rollout(weights: Array, lags: tuple[int, int], T0: Array, u: Array, weather: Array) -> Array:
    """Temperatures of the N steps, shape (M, N), from `T0` (M, na), `u` (M, nb − 1 + N) and `weather` (M, N, 3)."""
    na, nb = lags
    a, g, w = weights[:na], weights[na : na + nb], weights[na + nb :]
    n = weather.shape[1]
    T = np.concatenate([T0, np.empty((T0.shape[0], n))], axis=1)
    driven = weather @ w
    for i in range(nb):
        driven = driven + g[i] * u[:, nb - 1 - i : nb - 1 - i + n]
    for k in range(n):
        T[:, na + k] = T[:, k : na + k] @ a[::-1] + driven[:, k]
    return T[:, na:]
