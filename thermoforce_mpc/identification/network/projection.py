"""Step responses as a few parallel modes, the operator's form: least squares over time constants and gains.

A room with its structure, its envelope and one emitter has four modes, of which three are enough to within a per cent
or so. What other rooms' actuators do comes through walls, later: their responses share time constants of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, nnls

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.differences import jacobian
from thermoforce_mpc.identification.estimation.modes import unit_steps
from thermoforce_mpc.identification.network.building import RESPONSE_H

# Time constants, h: shortest, longest of any building, least ratio of neighbours.
_SHORTEST_H, _LONGEST_H, _APART = 0.05, 1000.0, 1.5
# Range of the logarithm of how far ln τ is above its least, and most steps of the search.
_RANGE, _MOST_STEPS = (-4.0, 2.2), 200
# Time constants of the starts of the search, h, by order.
_STARTS_H: dict[int, tuple[tuple[float, ...], ...]] = {
    1: ((10.0,), (50.0,)),
    2: ((1.0, 30.0), (5.0, 80.0)),
    3: ((0.3, 3.0, 60.0), (1.0, 8.0, 100.0), (0.1, 0.5, 30.0)),
}
# Standard deviation of log time constants and relative gains before the responses are seen.
_LOG_TAU_SD, _GAIN_SD = 0.5, 1.0
# Least standard deviations: of a response, as a share of the largest, and of a gain, K or K/h.
_LEAST_SHARE, _LEAST_GAIN = 0.01, 1e-3


@dataclass(frozen=True)
class Modes:
    """Responses of a zone to its actuators as r modes each.

    `log_tau` (A, r): ln(τ/h), rising, common to all but its own actuator; `gains` (A, r): [slope K/h, G_2 … G_r K] of
    each actuator in the direction of its sign; `misfit` (A,): root mean square error over that of the response.
    """

    log_tau: Array
    gains: Array
    misfit: Array

    def covariance(self, of_responses: Array) -> Array:
        """Covariance (A, 2r, 2r) of [ln τ, gains] of each actuator that gives its response that of the network,
        (A, T, T).
        """
        each = zip(self.log_tau, self.gains, of_responses, strict=True)
        return np.array([_covariance(log_tau, gains, of_response) for log_tau, gains, of_response in each])


def projected(responses: Array, own: int, signs: Array, order: int, longest_h: float = _LONGEST_H) -> Modes:
    """The step responses (A, T) K of a zone at `RESPONSE_H` as `order` modes each: those of its `own` actuator, and
    those that suit all others.

    None is longer than `longest_h`, the network's own: what rises on after the last of `RESPONSE_H` would otherwise
    have any steady state.
    """
    means = responses * np.asarray(signs)[:, None]
    others = np.arange(len(means)) != own
    log_tau = np.tile(_time_constants(means[[own]], order, longest_h), (len(means), 1))
    if others.any():
        log_tau[others] = _time_constants(means[others], order, longest_h)
    gains, errors = np.empty((len(means), order)), np.empty(len(means))
    for a, mean in enumerate(means):
        gains[a], error = nnls(unit_steps(log_tau[a], RESPONSE_H), mean)
        errors[a] = error / np.sqrt(max(float(mean @ mean), mean.size * 1e-12))
    return Modes(log_tau, gains, errors)


def _time_constants(means: Array, order: int, longest_h: float) -> Array:
    """ln τ (r,) of the modes that suit the responses (K, T), K, best; none is longer than `longest_h`."""
    # At the longest, neighbours stay apart: equal poles would be one.
    most = np.log(min(longest_h, _LONGEST_H)) - np.log(_APART) * np.arange(order)[::-1]
    targets = means / max(float(np.abs(means).max()), _LEAST_GAIN)

    def tau_of(x: Array) -> Array:
        """ln τ from x in `_RANGE`: each is at least `_APART` times the one before, and at most its longest."""
        log_tau = np.log(_SHORTEST_H) + np.cumsum(np.exp(x)) + np.log(_APART) * np.arange(order)
        return np.asarray(np.minimum(log_tau, most))

    def misfit(x: Array) -> Array:
        units = unit_steps(tau_of(x), RESPONSE_H)
        return np.concatenate([units @ nnls(units, target)[0] - target for target in targets])

    found = []
    for hours in _STARTS_H[order]:
        steps = np.diff(np.log(hours), prepend=np.log(_SHORTEST_H)) - np.log(_APART) * (np.arange(order) > 0)
        start = np.clip(np.log(np.maximum(steps, 0.0) + 1e-9), *_RANGE)
        found.append(least_squares(misfit, start, bounds=_RANGE, max_nfev=_MOST_STEPS))
    return tau_of(min(found, key=lambda result: result.cost).x)


def _covariance(log_tau: Array, gains: Array, of_response: Array) -> Array:
    """Covariance (2r, 2r) of [ln τ, gains] that gives the response its covariance (T, T)."""
    r = log_tau.size

    def steps(p: Array) -> Array:
        return np.asarray(unit_steps(p[:r], RESPONSE_H) @ p[r:])

    p = np.concatenate([log_tau, gains])
    slopes = jacobian(steps, p)
    size = max(float(gains.sum()), _LEAST_GAIN)
    prior = np.concatenate([np.full(r, _LOG_TAU_SD), np.full(r, _GAIN_SD * size)]) ** -2.0
    noise = of_response + np.diag(np.full(len(of_response), (_LEAST_SHARE * size) ** 2))
    return np.asarray(np.linalg.inv(slopes.T @ np.linalg.solve(noise, slopes) + np.diag(prior)))
