"""Sparse matrices with constant structure whose values are numbers of an instance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from thermoforce_mpc.data import Array

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
