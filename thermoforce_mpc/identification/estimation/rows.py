"""Runs and pairs as one bounded Gaussian regression for given time constants, in standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.columns import (
    N_FREE,
    forced_columns,
    free_columns,
    free_prior,
    other_columns,
    other_prior,
    start_sd,
)
from thermoforce_mpc.identification.estimation.modes import ModePriors
from thermoforce_mpc.identification.estimation.regression import RegressionData


@dataclass(frozen=True)
class Rows:
    """Rows of the data, then the prior of each column: `columns` (n + p, p) and `target` (n + p,).

    Columns: gains [slope, G_2 … G_r] of the own actuator and of the others, shared free part, initial states run by
    run. `low` (p,): their lower bounds.
    """

    columns: Array
    target: Array
    low: Array

    @classmethod
    def of(
        cls, regressions: Sequence[RegressionData], priors: ModePriors, sign: int, log_tau: Array | None = None
    ) -> Rows:
        """The rows of runs and pairs, at least one, at ln(τ/h) (r,), by default the priors'; `sign` +1 heating, −1
        cooling.
        """
        log_tau = priors.log_tau if log_tau is None else log_tau
        starts = N_FREE + 1
        runs = [regression for regression in regressions if not regression.is_pair]
        parts = [priors.gains_at(log_tau), other_prior(regressions[0])]
        low = [np.zeros(sum(mean.size for mean, _ in parts))]
        acting = low[0].size
        if runs:
            mean, sd, least = free_prior(runs[0])
            parts += [(mean, sd), (np.zeros(starts * len(runs)), np.tile(start_sd(starts), len(runs)))]
            low += [least, np.full(starts * len(runs), -np.inf)]
        mean, sd = (np.concatenate(part) for part in zip(*parts, strict=True))
        blocks, targets, begin = [], [], mean.size - starts * len(runs)
        for regression in regressions:
            columns = [forced_columns(regression, log_tau, sign), other_columns(regression, log_tau)]
            columns += [] if regression.is_pair else free_columns(regression, log_tau)
            white = regression.disturbance.whitened(np.column_stack([*columns, regression.target]))
            block = np.zeros((white.shape[0], mean.size))
            block[:, :acting] = white[:, :acting]
            if not regression.is_pair:
                shared = white.shape[1] - 1 - starts
                block[:, acting:shared] = white[:, acting:shared]
                block[:, begin : begin + starts] = white[:, shared:-1]
                begin += starts
            blocks.append(block)
            targets.append(white[:, -1])
        return cls(
            np.concatenate([*blocks, np.diag(1.0 / sd)]), np.concatenate([*targets, mean / sd]), np.concatenate(low)
        )
