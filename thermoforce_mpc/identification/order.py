"""Choosing the number of modes on held-out rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.blocks import block_numbers, is_significant, standard_errors_saved
from thermoforce_mpc.identification.cases import Case
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.joint import JointFit, fit_joint
from thermoforce_mpc.identification.likelihood import Split, residuals
from thermoforce_mpc.identification.modes import ModePriors
from thermoforce_mpc.identification.regression_data import RegressionData, follows_action, forced_columns
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# A lower order must beat a higher one on the held-out rows with this probability (Student's t) and by this share of the
# squared residual: under priors a mode too many does no harm, while a delay left out cannot be made up for.
_SIGNIFICANT = 0.975
_CLEARLY = 0.2
# Orders are told apart by rows that follow an action within hours: the others tell how the weather was.
_AFTER_ACTION_H = 6.0


@dataclass(frozen=True)
class Fitted:
    """A fit to the training rows, and how it did on the others.

    `judged` (rows,) are the whitened residuals of the rows judged by and `blocks` (rows,) which hours each belongs to;
    `rollout_rmse_K` is the RMSE of the held-out rollouts, K.
    """

    fit: JointFit
    priors: ModePriors
    judged: Array
    blocks: NDArray[np.intp]
    rollout_rmse_K: float

    @property
    def score(self) -> float:
        """RMS of the whitened residuals of the rows judged by (NaN where no action was held out)."""
        return float(np.sqrt(np.mean(self.judged**2))) if self.judged.size else float("nan")


def _part(regression: RegressionData, rows: NDArray[np.intp]) -> RegressionData:
    """The first rows of an regression (rows are always a leading block, whose Cholesky factor is the leading block)."""
    n = rows.size
    return replace(regression, target=regression.target[:n], rows=regression.rows[:n], factor=regression.factor[:n, :n])


def fit_and_judge(
    cases: Sequence[Case], splits: Sequence[Split], priors: ModePriors, config: IdentificationConfig, sign: int
) -> Fitted:
    """Fit to the training rows, judge by the held-out rollouts."""
    training = [_part(c.regression, s.train) for c, s in zip(cases, splits, strict=True) if s.train.size]
    fit = fit_joint(training, priors, config, sign)
    judged, blocks, errors = [], [], []
    for index, (case, split) in enumerate(zip(cases, splits, strict=True)):
        if not split.judged.size:
            continue
        rest = residuals(case.regression, fit.log_tau)
        residual = case.regression.target - rest.mean - forced_columns(case.regression, fit.log_tau, sign) @ fit.gains
        after_action = split.judged[follows_action(case.regression, _AFTER_ACTION_H)[split.judged]]
        judged.append((rest.whitener() @ residual)[after_action])
        blocks.append(block_numbers(index, case.regression.rows[after_action], case.regression.step_s))
        for past, ahead in split.rollouts:
            errors.append(rest.innovation(past, ahead) @ residual[np.concatenate([past, ahead])])
    rollout_rmse_K = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    return Fitted(fit, priors, np.concatenate(judged), np.concatenate(blocks), rollout_rmse_K)


def explained_share(cases: Sequence[Case], operator: OperatorParameters) -> float:
    """Share of the whitened variance (of what neither weather nor drift explains) that the forced response removes.

    The forced response is that of the linear part, m = 1, to the actions of each case.
    """
    log_tau, steady = np.log(operator.time_constants_h), operator.sign * operator.steady_gains_K
    gains = np.concatenate([[(steady / operator.time_constants_h).sum()], steady[1:]])
    before, after = 0.0, 0.0
    for case in cases:
        rest = residuals(case.regression, log_tau)
        whitener = rest.whitener()
        residual = case.regression.target - rest.mean
        before += float(np.sum((whitener @ residual) ** 2))
        forced = forced_columns(case.regression, log_tau, operator.sign) @ gains
        after += float(np.sum((whitener @ (residual - forced)) ** 2))
    return 1.0 - after / before


def choose_order(candidates: dict[int, Fitted]) -> int:
    """Highest order, unless a lower one predicts the held-out rows clearly and significantly better."""
    chosen = max(candidates)
    for order in sorted(candidates, reverse=True):
        if _better(candidates[order], candidates[chosen]):
            chosen = order
    return chosen


def _better(lower: Fitted, higher: Fitted) -> bool:
    """Whether the held-out rows speak clearly for the lower order."""
    if not higher.judged.size or higher.score**2 - lower.score**2 <= _CLEARLY * higher.score**2:
        return False
    return is_significant(*standard_errors_saved(higher.judged, lower.judged, higher.blocks), _SIGNIFICANT)
