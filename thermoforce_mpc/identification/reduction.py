"""Runs and pairs as whitened linear regressions for given time constants, and these reduced to triangles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.bounded import triangle
from thermoforce_mpc.identification.columns import all_columns, free_time_constants
from thermoforce_mpc.identification.regression_data import FREE_PRIOR, RegressionData


def whitened_rows(regressions: Sequence[RegressionData], log_tau: Array, sign: int) -> list[Array]:
    """Return the rows of each regression (rows, p + 1) in standard deviations, the target in the last column.

    Columns: gains, those of the other actuators, shared free part, initial states run by run.
    """
    r, acting = log_tau.size, (1 + regressions[0].others.shape[0]) * log_tau.size
    n_runs = sum(not regression.is_pair for regression in regressions)
    q = free_time_constants(log_tau).size
    n_shared, n_starts = len(FREE_PRIOR) * q + 1, q + 1
    found, run = [], 0
    for regression in regressions:
        columns = all_columns(regression, log_tau)
        columns[:, :r] *= sign
        values = np.concatenate([columns, regression.target[:, None]], axis=1)
        white = regression.disturbance.whitened(values)
        if n_runs > 1 or (n_runs and regression.is_pair):
            shared = acting if regression.is_pair else acting + n_shared
            p = acting + n_shared + n_runs * n_starts
            spread = np.zeros((white.shape[0], p + 1))
            spread[:, :shared], spread[:, p] = white[:, :shared], white[:, -1]
            if not regression.is_pair:
                first = shared + run * n_starts
                spread[:, first : first + n_starts] = white[:, shared:-1]
            white = spread
        run += not regression.is_pair
        found.append(white)
    return found


class Reduction:
    """Regressions of which sums of squares are asked for many time constants, priors and sizes of disturbances.

    For given time constants the rows of all runs, and those of all pairs, are reduced to the triangle of a QR
    factorisation, which has the same sums of squares. It is kept: searches with other priors come by the same time
    constants, and a factor on the disturbances is one on the triangle.

    Args:
        regressions: runs and pairs, at least one.
        sign: +1 heating, −1 cooling.
    """

    def __init__(self, regressions: Sequence[RegressionData], sign: int) -> None:
        self.regressions, self.sign = regressions, sign
        self.n_rows = sum(regression.rows.size for regression in regressions)
        self.n_runs = sum(not regression.is_pair for regression in regressions)
        self._known: dict[bytes, tuple[list[Array], list[Array]]] = {}

    def rows(self, log_tau: Array, scale: float = 1.0) -> Array:
        """Rows (m, p + 1) of the same sums of squares as `whitened_rows`, with disturbances of runs times `scale`."""
        known = self._known.get(log_tau.tobytes())
        if known is None:
            rows = whitened_rows(self.regressions, log_tau, self.sign)
            runs, pairs = (
                [white for white, regression in zip(rows, self.regressions, strict=True) if regression.is_pair is pair]
                for pair in (False, True)
            )
            runs, pairs = ([triangle(np.concatenate(group))] if group else [] for group in (runs, pairs))
            known = self._known[log_tau.tobytes()] = runs, pairs
        runs, pairs = known
        return np.concatenate([*(R / scale for R in runs), *pairs])
