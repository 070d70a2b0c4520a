"""Step responses as a few parallel modes, the operator's form: least squares over time constants and gains.

A room with its structure, its envelope and one emitter has four modes, of which three are enough to within a per cent
or so. What other rooms' actuators do comes through walls, later: their responses share time constants of their own.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from operator import itemgetter

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.regression import unit_steps
from thermoforce_mpc.identification.network.building import RESPONSE_H

# Time constants, h: shortest, longest of any building, least ratio of neighbours. By judgement: operators of three
# modes hold what the networks of generated houses do.
_SHORTEST_H, _LONGEST_H, _APART = 0.05, 1000.0, 1.5
# Range of the logarithm of how far ln τ is above its least, so that neighbours are 1.02 to 8000 times apart; and most
# steps of the search.
_RANGE, _MOST_STEPS = (-4.0, 2.2), 200
# Least size of responses, K, and share of its largest value from which an error counts by the response then: a plan
# sees what comes within two days. A third more changes what the card says by 2 %, cost by 0.1 %
# (`benchmarks.constants`, 2026-11-28).
_LEAST_K, _RELATIVE_FROM = 1e-3, 0.15
# Time constants among which a search begins, so many from twice the shortest to nearly the longest, and the searches
# from the best of each middle one. Of 60 draws of responses through layers, one search missed by up to a quarter of the
# misfit, and three of the nine hours ended elsewhere for a rounding of 1e-9 (2026-11-29).
_OF_STARTS, _SEARCHED = 12, 3


@dataclass(frozen=True)
class Modes:
    """Responses of a zone to its actuators as r modes each.

    `log_tau` (A, r): ln(τ/h), rising, common to all but its own actuator; `gains` (A, r): [slope K/h, G_2 … G_r K] of
    each actuator in the direction of its sign.
    """

    log_tau: Array
    gains: Array


def projected(responses: Array, signs: Array, order: int, longest_h: float) -> Modes:
    """The step responses (A, T) K of a zone at `RESPONSE_H` as `order` modes each: those of its own actuator, the
    first, and those that suit all others.

    None is longer than `longest_h`, the network's own: what rises on after the last of `RESPONSE_H` would otherwise
    have any steady state.
    """
    from scipy.optimize import nnls

    means = responses * np.asarray(signs)[:, None]
    log_tau = np.tile(_time_constants(means[:1], order, longest_h), (len(means), 1))
    if len(means) > 1:
        log_tau[1:] = _time_constants(means[1:], order, longest_h)
    gains = []
    for of_one, mean in zip(log_tau, means, strict=True):
        weights = _weights(mean)
        gains.append(nnls(weights[:, None] * unit_steps(of_one, RESPONSE_H), weights * mean)[0])
    return Modes(log_tau, np.array(gains))


def _time_constants(means: Array, order: int, longest_h: float) -> Array:
    """ln τ (r,) of the modes that suit the responses (K, T), K, best; none is longer than `longest_h`."""
    from scipy.optimize import least_squares, nnls

    # At the longest, neighbours stay apart: equal poles would be one.
    most = np.log(min(longest_h, _LONGEST_H)) - np.log(_APART) * np.arange(order)[::-1]
    weights = [_weights(mean)[:, None] for mean in means]

    def tau_of(x: Array) -> Array:
        """ln τ from x in `_RANGE`: each is at least `_APART` times the one before, and at most its longest."""
        log_tau = np.log(_SHORTEST_H) + np.cumsum(np.exp(x)) + np.log(_APART) * np.arange(order)
        return np.asarray(np.minimum(log_tau, most))

    def misfit(x: Array) -> Array:
        units = unit_steps(tau_of(x), RESPONSE_H)
        weighted = [(weight * units, weight[:, 0] * mean) for weight, mean in zip(weights, means, strict=True)]
        return np.concatenate([columns @ nnls(columns, target)[0] - target for columns, target in weighted])

    hours = np.geomspace(2.0 * _SHORTEST_H, 0.95 * np.exp(most[-1]), _OF_STARTS)
    starts: dict[float, tuple[float, Array]] = {}
    for each in combinations(np.log(hours), order):
        steps = np.diff(each, prepend=np.log(_SHORTEST_H)) - np.log(_APART) * (np.arange(order) > 0)
        start = np.clip(np.log(np.maximum(steps, 1e-9)), *_RANGE)
        left, middle = float(np.linalg.norm(misfit(start))), each[order // 2]
        if left < starts.get(middle, (np.inf, start))[0]:
            starts[middle] = left, start
    likely = sorted(starts.values(), key=itemgetter(0))[:_SEARCHED]
    found = [least_squares(misfit, start, bounds=_RANGE, max_nfev=_MOST_STEPS) for _, start in likely]
    return tau_of(min(found, key=lambda result: float(result.cost)).x)


def _weights(mean: Array) -> Array:
    """Weights (T,) of the errors of a response (T,) K, 1/K."""
    return np.asarray(1.0 / (np.maximum(mean, 0.0) + _RELATIVE_FROM * max(float(mean.max()), _LEAST_K)))
