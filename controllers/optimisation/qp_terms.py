"""Responses of zones as difference equations: pairs of a zone with the same poles share one.

Σ_i g_i / (1 − a_i q⁻¹) over a common denominator makes one variable and one equation per step for all actuators of a
zone instead of one of each for every mode of every pair. Their matrices are sparse with a constant structure, whose
values are numbers of an instance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.signal import lfilter

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator

Index = NDArray[np.intp]


class SparsePattern:
    """Sparse matrix with constant structure and changing values.

    Entries are addressed in the order given; entries at the same position are summed.
    """

    def __init__(self, rows: Index, columns: Index, shape: tuple[int, int]) -> None:
        places, self._slot = np.unique(columns * shape[0] + rows, return_inverse=True)
        starts = np.searchsorted(places, np.arange(shape[1] + 1) * shape[0])
        self._matrix = sparse.csc_matrix((np.zeros(places.size), places % shape[0], starts), shape=shape)

    def filled(self, values: Array) -> sparse.csc_matrix:
        """The matrix with `values`, one per entry in the order given at construction; valid until the next call."""
        self._matrix.data[:] = np.bincount(self._slot, weights=values, minlength=self._matrix.data.size)
        return self._matrix


@dataclass(frozen=True)
class Entries:
    """Entries of a sparse matrix: value `factor` times the element `of` of a vector of numbers of the instance."""

    rows: Index
    columns: Index
    factor: Array
    of: Index


def joined(parts: list[Entries]) -> Entries:
    """Return the entries one after another."""
    return Entries(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("rows", "columns", "factor", "of"))
    )


def entries(rows: Index, columns: Index, factor: Array | float, of: Index | int) -> Entries:
    """Return entries from arrays that broadcast."""
    rows, columns, factor, of = np.broadcast_arrays(rows, columns, np.asarray(factor, dtype=np.float64), of)
    return Entries(rows.ravel(), columns.ravel(), factor.ravel(), of.ravel())


def nothing() -> Entries:
    """Return no entries."""
    none = np.zeros(0, dtype=np.intp)
    return Entries(none, none, np.zeros(0), none)


@dataclass(frozen=True)
class Group:
    """Pairs of a zone with the same poles, which share one response variable per step.

    `pairs`: their actuators; `actuators`: those of the rows of `numerators`.
    """

    zone: int
    pairs: Index
    actuators: Index
    denominator: Array
    numerators: Array
    begin: Array


def groups_of(operator: BuildingOperator, n_steps: int, *, power_couples: bool) -> list[Group]:
    """Return the pairs of each zone by poles; `power_couples`: whether power couples the zones of a step."""
    by_poles: dict[tuple[int, tuple[float, ...]], list[int]] = {}
    for z, a, pair in operator.each():
        by_poles.setdefault((z, tuple(pair.poles.tolist())), []).append(a)
    groups, gains = [], operator.gains
    for (z, key), actuators in by_poles.items():
        poles = np.array(key)
        numerators = np.array([transfer_function(poles, gains[z, a])[1] for a in actuators])
        denominator = np.asarray(np.poly(poles), dtype=np.float64)
        faded = poles ** np.arange(1, min(poles.size, n_steps) + 1)[:, None]
        begin = lfilter(denominator, [1.0], faded, axis=0)
        of = np.array(actuators, dtype=np.intp)
        groups.append(Group(z, of, of, denominator, numerators, begin))
    Z, A, _ = operator.shape
    return _fill_numerators(groups, (Z, A), power_couples=power_couples)


def _fill_numerators(groups: list[Group], shape: tuple[int, int], *, power_couples: bool) -> list[Group]:
    """The groups with numerators of 0 for actuators without an effect, where that helps the solver.

    Minimum degree orders a full pattern by time, and one with a few cross-effects so that it fills up: at 20 zones the
    factorisation takes up to three times as long. Buildings without cross-effects, and sparse ones in which power
    couples nothing, are faster as they are.
    """
    Z, A = shape
    pairs = sum(group.actuators.size for group in groups)
    if len(groups) > Z or pairs <= max(Z, A) or not (power_couples or pairs > 0.25 * Z * A):
        return groups
    filled = []
    for group in groups:
        numerators = np.zeros((A, group.numerators.shape[1]))
        numerators[group.actuators] = group.numerators
        filled.append(replace(group, actuators=np.arange(A), numerators=numerators))
    return filled


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
