"""Derivatives by central differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thermoforce_mpc.data import Array

_STEP = 1e-4


def jacobian(function: Callable[[Array], Array], at: Array, count: int | None = None) -> Array:
    """Derivatives (..., p) of a function's values (...) by the first `count` parameters, all of them by default.

    Steps are 1e-4 of a parameter `at` (n,), and 1e-4 where that is below 1.
    """
    columns = []
    for i in range(at.size if count is None else count):
        step = np.zeros(at.size)
        step[i] = _STEP * max(1.0, abs(float(at[i])))
        columns.append((function(at + step) - function(at - step)) / (2.0 * step[i]))
    return np.stack(columns, axis=-1)
