"""Comparison of two models on blocks of held-out rows.

Errors of rows within a few hours are correlated (one cloud, one meal), so a block of 4 h counts as one observation.
Block errors differ widely in size, so models are compared by a paired t-test on the logarithm of the sum of squared
residuals per block. Predictions many hours ahead overlap, so that blocks are correlated too: the variance of the mean
then has their autocovariances (Bartlett weights), and the quantile is that of Kiefer and Vogelsang (2005, table 1),
which counts that these are estimated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from thermoforce_mpc.data import HOUR_S, Array

BLOCK_H, LEAST_BLOCKS = 4.0, 4
"""Length of a block, h, and least number of blocks."""
# Floor added to squared residuals before the logarithm.
_NOTHING = 1e-9
# Offset that keeps block numbers of different regressions apart.
PER_REGRESSION = 10**6
# Quantiles by one-sided probability: polynomials in b, the reach of the autocovariances as a share of the blocks.
_FIXED_B: dict[float, tuple[float, float, float, float]] = {
    0.90: (1.2816, 1.3040, 0.5135, -0.3386),
    0.95: (1.6449, 2.1859, 0.3142, -0.3427),
    0.975: (1.9600, 2.9694, 0.4160, -0.5324),
    0.99: (2.3263, 4.1618, 0.5368, -0.9060),
}


def block_numbers(regression: int, rows: NDArray[np.intp], step_s: float) -> NDArray[np.intp]:
    """Return the block number of each of `rows` (n,) of regression number `regression`, shape (n,)."""
    return np.asarray(regression * PER_REGRESSION + (rows * step_s / HOUR_S // BLOCK_H), dtype=np.intp)


def standard_errors_saved(
    residuals: Array, other: Array, blocks: NDArray[np.intp], overlap: int = 0
) -> tuple[float, int]:
    """Return the t statistic for `other` having smaller residuals than `residuals`, both (n,), and the block count.

    `overlap`: so many blocks before it go with a block. The statistic is NaN with fewer than 4 blocks.
    """
    names, block = np.unique(blocks, return_inverse=True)
    n = int(names.size)
    if n < LEAST_BLOCKS:
        return float("nan"), n
    saved = np.log(np.bincount(block, residuals**2) + _NOTHING) - np.log(np.bincount(block, other**2) + _NOTHING)
    mean = float(np.mean(saved))
    away = saved - mean
    if overlap:
        lags = np.arange(1, _reach(n, overlap))
        together = [away[lag:] @ away[:-lag] for lag in lags]
        variance = float(away @ away + 2.0 * (1.0 - lags / _reach(n, overlap)) @ together) / n
    else:
        variance = float(away @ away) / (n - 1)
    if variance <= 0.0:
        return (float(np.copysign(np.inf, mean)) if mean else 0.0), n
    return mean / float(np.sqrt(variance / n)), n


def quantile(count: int, probability: float, overlap: int = 0) -> float:
    """What the statistic of `count` blocks exceeds by chance with 1 − `probability`: one of 0.9, 0.95, 0.975, 0.99."""
    if not overlap:
        return float(stdtrit(max(count - 1, 1), probability))
    return float(np.polynomial.polynomial.polyval(_reach(count, overlap) / max(count, 1), _FIXED_B[probability]))


def is_significant(statistic: float, count: int, probability: float, overlap: int = 0) -> bool:
    """Return whether the t statistic of `count` blocks exceeds its quantile at this probability."""
    return count >= LEAST_BLOCKS and statistic > quantile(count, probability, overlap)


def _reach(count: int, overlap: int) -> int:
    """From which distance of blocks on no autocovariance is counted."""
    return min(overlap + 1, max(count, 1))
