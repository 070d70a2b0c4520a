"""What the checks share: a remark, and least squares of a time series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from thermoforce_mpc.data import Array

Kind = Literal[
    "stamps late",
    "stamps early",
    "level is no level",
    "meter holds another load",
    "unit of power",
    "unit of temperature",
    "rooms swapped",
    "command is no command",
]
# Steps over which residuals may go together.
_LAGS = 4


@dataclass(frozen=True)
class Remark:
    """One finding of a check: its kind, the signals concerned, what was found with its numbers, and what to do.

    `sure`: the statistic, as a number of its standard deviations; inf where a physical limit is exceeded. `actuators`:
    numbers of those whose model it bars; none where the record may serve all the same.
    """

    kind: Kind
    where: str
    words: str
    remedy: str
    sure: float = float("inf")
    actuators: tuple[int, ...] = ()

    def in_words(self) -> str:
        """One line."""
        return f"{self.kind}: {self.where}: {self.words}; {self.remedy}"


def fitted(columns: Array, target: Array) -> tuple[Array, Array, Array]:
    """Coefficients (k,) of `columns` (n, k), their covariance (k, k) and the residuals (n,).

    The covariance is that of Newey and West (1987, doi 10.2307/1913610), with Bartlett weights.
    """
    beta, *_ = np.linalg.lstsq(columns, target, rcond=None)
    residual = target - columns @ beta
    scores = columns * residual[:, None]
    spread = scores.T @ scores
    for lag in range(1, _LAGS + 1):
        together = scores[lag:].T @ scores[:-lag]
        spread = spread + (1.0 - lag / (_LAGS + 1.0)) * (together + together.T)
    inverse = np.linalg.pinv(columns.T @ columns)
    return np.asarray(beta), np.asarray(inverse @ spread @ inverse), np.asarray(residual)


def explained(columns: Array, target: Array) -> tuple[float, Array]:
    """Share of the variance of `target` (n,) that `columns` (n, k) explain, and the residuals (n,)."""
    beta, *_ = np.linalg.lstsq(columns, target, rcond=None)
    residual = target - columns @ beta
    variance = float(np.var(target))
    return (1.0 - float(np.var(residual)) / variance if variance > 0.0 else 1.0), residual
