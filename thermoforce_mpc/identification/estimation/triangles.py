"""Least squares by a triangle of the same sums of squares, which many rows are reduced to once."""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr

from thermoforce_mpc.data import Array


def triangle(matrix: Array) -> Array:
    """R of a QR factorisation of `matrix` (n, m): (min(n, m), m), of the same sums of squares |matrix x|²."""
    return np.asarray(qr(matrix, mode="r", check_finite=False)[0])[: matrix.shape[1]]
