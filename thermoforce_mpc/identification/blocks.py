"""Held-out rows as observations: one cloud or one meal misleads all rows of some hours alike.

So what counts as one observation is a block of some hours, and as blocks are off by very different amounts, two models
are compared by the logarithm of what each leaves unexplained in a block (a paired t-test of these logarithms).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from thermoforce_mpc.data import HOUR_S, Array

# Length of a block, h, and how many there have to be.
_PIECE_H = 4.0
_LEAST_PIECES = 4
# Squared residual that counts as none.
_NOTHING = 1e-9
# Pieces of different regressions must not share a number.
_PER_REGRESSION = 10**6


def block_numbers(regression: int, rows: NDArray[np.intp], step_s: float) -> NDArray[np.intp]:
    """The block that each of `rows` (n,) of the regression with this number belongs to, shape (n,)."""
    return np.asarray(regression * _PER_REGRESSION + (rows * step_s / HOUR_S // _PIECE_H), dtype=np.intp)


def standard_errors_saved(residuals: Array, other: Array, blocks: NDArray[np.intp]) -> tuple[float, int]:
    """How clearly `other` leaves less than `residuals`, all (n,): the t statistic and the number of blocks.

    NaN where there are too few blocks to tell.
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
    """Whether the t statistic of `count` blocks exceeds what chance gives with this probability."""
    return count >= _LEAST_PIECES and statistic > float(student_t.ppf(probability, count - 1))
