"""Responses of zones as difference equations: pairs of a zone with the same poles share one.

Comfort depends on the sum y = Σ F_i of the r modes of a pair only, which obeys

    Π_i (1 − a_i q⁻¹) y_k  =  Σ_i g_i Π_{j≠i} (1 − a_j q⁻¹) d_k,        q⁻¹ y_k = y_{k−1},

for a drive d_k = m(x_k) v(u_k). Pairs of one zone with the same poles obey it together, with the sum of their right
sides: one variable and one equation a step for all actuators of a zone instead of r of each for every pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import OperatorParameters


@dataclass(frozen=True)
class Group:
    """Pairs of a zone with the same poles.

    `pairs`: their actuators; `actuators`: those of the equation. `poles` (r,), 0 of modes that have no gain in any of
    them: the equation is of lower order without them. `gains` (actuators, r).
    """

    zone: int
    pairs: NDArray[np.intp]
    actuators: NDArray[np.intp]
    poles: Array
    gains: Array


def groups_of(operator: BuildingOperator, *, power_couples: bool) -> list[Group]:
    """Return the pairs of each zone by poles; `power_couples`: whether power couples the zones of a step."""
    by_poles: dict[tuple[int, tuple[float, ...]], dict[int, OperatorParameters]] = {}
    for z, a, pair in operator.each():
        by_poles.setdefault((z, tuple(pair.poles.tolist())), {})[a] = pair
    groups = []
    for (z, key), pairs_of in by_poles.items():
        of, poles = np.array(list(pairs_of), dtype=np.intp), np.zeros(operator.shape[2])
        acting = np.any([pair.acting for pair in pairs_of.values()], axis=0)
        poles[: len(key)] = np.where(acting, key, 0.0)
        groups.append(Group(z, of, of, poles, operator.gains[z, of]))
    # Minimum degree orders a full pattern by time, and one with a few cross-effects so that it fills up: at 20 zones
    # the factorisation takes up to three times as long. So actuators without an effect get numerators of 0; buildings
    # without cross-effects, and sparse ones in which power couples nothing, are faster as they are.
    Z, A, _ = operator.shape
    pairs = sum(group.actuators.size for group in groups)
    if len(groups) > Z or pairs <= max(Z, A) or not (power_couples or pairs > 0.25 * Z * A):
        return groups
    return [_filled(group, A) for group in groups]


def _filled(group: Group, A: int) -> Group:
    gains = np.zeros((A, group.poles.size))
    gains[group.actuators] = group.gains
    return replace(group, actuators=np.arange(A), gains=gains)


def difference_equation(poles: Array, gains: Array, window: Sequence[int]) -> tuple[Array, Array]:
    """The difference equation of y = Σ F_i over the last r steps, which may differ in length.

    With G the modes before them and L_j the length of the first j, y_j = Σ_i a_i^L_j G_i + what the drives add. The
    weights w_j for which Σ_j w_j a_i^L_j = 0 for every mode eliminate G.

    Args:
        poles: a_i, shape (r,); 0 of modes that are left out.
        gains: g_i of each actuator, shape (actuators, r).
        window: lengths of the steps in control steps, the latest last, (r,).

    Returns:
        Coefficients of y and its lags, shape (r + 1,), the first of them 1, and of the drives and their lags, shape
        (r, actuators).
    """
    acts = poles > 0.0
    if not acts.all():  # the earliest lags do not enter
        idle = (0, int(np.count_nonzero(~acts)))
        left, right = difference_equation(poles[acts], gains[:, acts], window[idle[1] :])
        return np.pad(left, idle), np.pad(right, (idle, (0, 0)))
    r, lengths = poles.size, np.array(window)
    ends = np.concatenate([[0], np.cumsum(lengths)])
    faded = poles[:, None] ** ends
    if len(set(window)) == 1:  # exact, however near the poles are
        weights = np.poly(faded[:, 1])[::-1]
    else:
        weights = np.append(np.linalg.lstsq(faded[:, :r], -faded[:, r], rcond=None)[0], 1.0)
    numerator = np.zeros((r, len(gains)))
    for i in range(1, r + 1):
        added = gains * (1.0 - poles ** lengths[i - 1]) / (1.0 - poles)
        for j in range(i, r + 1):
            numerator[r - i] += weights[j] * added @ poles ** (ends[j] - ends[i])
    return np.asarray(weights[::-1], dtype=np.float64), numerator
