"""Responses of zones as difference equations: pairs of a zone with the same poles share one.

Comfort depends on the sum y = Σ F_i of the r modes of a pair only, which obeys

    Π_i (1 − a_i q⁻¹) y_k  =  Σ_i g_i Π_{j≠i} (1 − a_j q⁻¹) d_k,        q⁻¹ y_k = y_{k−1},

for a drive d_k = m(x_k) v(u_k). Pairs of one zone with the same poles obey it together, with the sum of their right
sides: one variable and one equation a step for all actuators of a zone instead of r of each for every pair.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator


@dataclass(frozen=True)
class Group:
    """Pairs of a zone with the same poles.

    `pairs`: their actuators; `actuators`: those of the rows of `numerators` (actuators, r). `denominator` (r + 1,).
    `begin` (r, r): right sides of the first equations from the modes at the beginning.
    """

    zone: int
    pairs: NDArray[np.intp]
    actuators: NDArray[np.intp]
    denominator: Array
    numerators: Array
    begin: Array


def groups_of(operator: BuildingOperator, *, power_couples: bool) -> list[Group]:
    """Return the pairs of each zone by poles; `power_couples`: whether power couples the zones of a step."""
    by_poles: dict[tuple[int, tuple[float, ...]], list[int]] = {}
    for z, a, pair in operator.each():
        by_poles.setdefault((z, tuple(pair.poles.tolist())), []).append(a)
    groups, gains = [], operator.gains
    for (z, key), actuators in by_poles.items():
        poles = np.array(key)
        numerators = np.array([transfer_function(poles, gains[z, a])[1] for a in actuators])
        denominator = np.asarray(np.poly(poles), dtype=np.float64)
        faded = poles ** np.arange(1, poles.size + 1)[:, None]
        begin = lfilter(denominator, [1.0], faded, axis=0)
        of = np.array(actuators, dtype=np.intp)
        groups.append(Group(z, of, of, denominator, numerators, begin))
    # Minimum degree orders a full pattern by time, and one with a few cross-effects so that it fills up: at 20 zones
    # the factorisation takes up to three times as long. So actuators without an effect get numerators of 0; buildings
    # without cross-effects, and sparse ones in which power couples nothing, are faster as they are.
    Z, A, _ = operator.shape
    pairs = sum(group.actuators.size for group in groups)
    if len(groups) > Z or pairs <= max(Z, A) or not (power_couples or pairs > 0.25 * Z * A):
        return groups
    return [_filled(group, A) for group in groups]


def _filled(group: Group, A: int) -> Group:
    numerators = np.zeros((A, group.numerators.shape[1]))
    numerators[group.actuators] = group.numerators
    return replace(group, actuators=np.arange(A), numerators=numerators)


def transfer_function(poles: Array, gains: Array) -> tuple[Array, Array]:
    """Σ g_i / (1 − a_i q⁻¹) over a common denominator.

    Args:
        poles: a_i, shape (r,).
        gains: g_i, shape (r,).

    Returns:
        Coefficients of 1, q⁻¹, q⁻² … of the denominator, shape (r + 1,), and of the numerator, shape (r,).
    """
    numerator = sum(gain * np.atleast_1d(np.poly(np.delete(poles, i))) for i, gain in enumerate(gains))
    return np.asarray(np.poly(poles), dtype=np.float64), np.asarray(numerator, dtype=np.float64)
