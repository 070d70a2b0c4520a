"""Comparison of two models on blocks of held-out rows.

Errors of rows within a few hours are correlated (one cloud, one meal), so a block of 4 h counts as one observation.
Block errors differ widely in size, so models are compared by a paired t-test on the logarithm of the sum of squared
residuals per block.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from thermoforce_mpc.data import HOUR_S, Array

# Length of a block, h, and least number of blocks.
_PIECE_H = 4.0
_LEAST_PIECES = 4
# Floor added to squared residuals before the logarithm.
_NOTHING = 1e-9
# Offset that keeps block numbers of different regressions apart.
_PER_REGRESSION = 10**6


def block_numbers(regression: int, rows: NDArray[np.intp], step_s: float) -> NDArray[np.intp]:
    """Return the block number of each of `rows` (n,) of regression number `regression`, shape (n,)."""
    return np.asarray(regression * _PER_REGRESSION + (rows * step_s / HOUR_S // _PIECE_H), dtype=np.intp)


def standard_errors_saved(residuals: Array, other: Array, blocks: NDArray[np.intp]) -> tuple[float, int]:
    """Return the t statistic for `other` having smaller residuals than `residuals`, both (n,), and the block count.

    The statistic is NaN with fewer than 4 blocks.
    """
    names, block = np.unique(blocks, return_inverse=True)
    if names.size < _LEAST_PIECES:
        return float("nan"), int(names.size)
    saved = np.log(np.bincount(block, residuals**2) + _NOTHING) - np.log(np.bincount(block, other**2) + _NOTHING)
    spread = float(np.std(saved, ddof=1))
    mean = float(np.mean(saved))
    if spread == 0.0:
        return (float(np.copysign(np.inf, mean)) if mean else 0.0), int(names.size)
    return mean / (spread / float(np.sqrt(names.size))), int(names.size)


def is_significant(statistic: float, count: int, probability: float) -> bool:
    """Return whether the t statistic of `count` blocks exceeds Student's quantile at this probability."""
    return count >= _LEAST_PIECES and statistic > float(student_t.ppf(probability, count - 1))
