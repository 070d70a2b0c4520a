"""Least squares with some variables bounded below by zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf, dtrtrs
from scipy.optimize import nnls

from thermoforce_mpc.data import Array


@dataclass(frozen=True)
class Solution:
    """Minimiser `values` (p,) and its sum of squared residuals."""

    values: Array
    squares: float


def least_squares(design: Array, target: Array, positive: NDArray[np.bool_]) -> Solution:
    """Minimise |design x − target|² with x ≥ 0 where `positive`; `design` (n, p) has full column rank, n > p.

    Variables without a bound come first in a QR factorisation, so that the bounded ones alone are those of the trailing
    triangle, which is solved by active sets (Lawson and Hanson 1974, chapter 23).
    """
    p = positive.size
    free = int(p - np.count_nonzero(positive))
    order = np.argsort(positive, kind="stable")
    augmented = np.empty((target.size, p + 1), order="F")
    augmented[:, :p], augmented[:, p] = design[:, order], target
    R = dgeqrf(augmented, overwrite_a=True)[0][: p + 1]
    z = R[:p, p]
    sorted_values = np.empty(p)
    bounded, misfit = nnls(np.triu(R[free:p, free:p]), z[free:]) if free < p else (np.empty(0), 0.0)
    sorted_values[free:] = bounded
    sorted_values[:free] = dtrtrs(R[:free, :free], z[:free] - R[:free, free:p] @ bounded)[0] if free else 0.0
    values = np.empty(p)
    values[order] = sorted_values
    return Solution(values, float(R[p, p] ** 2 + misfit**2))
