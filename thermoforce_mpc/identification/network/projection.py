"""Step responses as a few parallel modes, the operator's form: least squares over time constants and gains.

A room with its structure, its envelope and one emitter has four modes, of which three are enough to within a per cent
or so. What more rooms and emitters add is fitted to the nearest response of that form, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, nnls

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.modes import unit_steps
from thermoforce_mpc.identification.network.building import RESPONSE_H

# Time constants, h: shortest, longest, least ratio of neighbours.
_SHORTEST_H, _LONGEST_H, _APART = 0.05, 1000.0, 1.5
# Range of the logarithm of how far ln τ is above its least, and most steps of the search.
_RANGE, _MOST_STEPS = (-4.0, 2.2), 200
# Time constants of the starts of the search, h, by order.
_STARTS_H: dict[int, tuple[tuple[float, ...], ...]] = {
    1: ((10.0,), (50.0,)),
    2: ((1.0, 30.0), (5.0, 80.0)),
    3: ((0.3, 3.0, 60.0), (1.0, 8.0, 100.0), (0.1, 0.5, 30.0)),
}


@dataclass(frozen=True)
class Modes:
    """Responses of a zone to its actuators as r modes of common time constants.

    `log_tau` (r,): ln(τ/h), rising; `gains` (A, r): [slope K/h, G_2 … G_r K] of each actuator in the direction of its
    sign; `misfit` (A,): root mean square error over that of the response.
    """

    log_tau: Array
    gains: Array
    misfit: Array


def projected(responses: Array, own: int, signs: Array, order: int) -> Modes:
    """The step responses (A, T) K of a zone at `RESPONSE_H` as `order` modes; the time constants are those that suit
    actuator `own`.
    """
    means = responses * np.asarray(signs)[:, None]
    target = means[own] / np.abs(means[own]).max()

    def tau_of(x: Array) -> Array:
        """ln τ from x in `_RANGE`: each is at least `_APART` times the one before."""
        return np.asarray(np.log(_SHORTEST_H) + np.cumsum(np.exp(x)) + np.log(_APART) * np.arange(order))

    def misfit(x: Array) -> Array:
        units = unit_steps(tau_of(x), RESPONSE_H)
        return np.asarray(units @ nnls(units, target)[0] - target)

    found = []
    for hours in _STARTS_H[order]:
        steps = np.diff(np.log(hours), prepend=np.log(_SHORTEST_H)) - np.log(_APART) * (np.arange(order) > 0)
        start = np.clip(np.log(np.maximum(steps, 0.0) + 1e-9), *_RANGE)
        found.append(least_squares(misfit, start, bounds=_RANGE, max_nfev=_MOST_STEPS))
    # At the longest, neighbours stay apart: equal poles would be one.
    most = np.log(_LONGEST_H) - np.log(_APART) * np.arange(order)[::-1]
    log_tau = np.minimum(tau_of(min(found, key=lambda result: result.cost).x), most)
    units = unit_steps(log_tau, RESPONSE_H)
    gains = np.array([nnls(units, mean)[0] for mean in means])
    errors = np.sqrt(np.mean((gains @ units.T - means) ** 2, axis=1) / np.maximum(np.mean(means**2, axis=1), 1e-12))
    return Modes(log_tau, gains, errors)
