"""Fits to the rows before the held-out ones, and their errors on these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.columns import forced_columns
from thermoforce_mpc.identification.estimation.joint import ModeFit, fit_modes
from thermoforce_mpc.identification.estimation.likelihood import Split, residuals, split_run
from thermoforce_mpc.identification.estimation.modes import ModePriors
from thermoforce_mpc.identification.estimation.regression import RegressionData, follows_action
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.identification.validation.held_out import Case, held_out
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Errors are judged in rows within these hours after an action; the others mainly reflect the weather.
_AFTER_ACTION_H = 6.0


@dataclass(frozen=True)
class Fitted:
    """Fit to the training rows and its held-out errors.

    `judged` (rows,): whitened residuals of the held-out rows that follow an action; `rollout_rmse_K`: RMSE of the
    held-out rollouts, K.
    """

    fit: ModeFit
    judged: Array
    rollout_rmse_K: float

    @property
    def score(self) -> float:
        """RMS of the whitened residuals `judged` (NaN without a held-out action)."""
        return float(np.sqrt(np.mean(self.judged**2))) if self.judged.size else float("nan")


def _part(regression: RegressionData, rows: NDArray[np.intp]) -> RegressionData:
    """Return the leading rows of a regression."""
    n = rows.size
    return replace(
        regression,
        target=regression.target[:n],
        rows=regression.rows[:n],
        disturbance=regression.disturbance.first(n),
    )


def training_data(cases: Sequence[Case], splits: Sequence[Split]) -> list[RegressionData]:
    """Return the training rows of all cases."""
    return [_part(c.regression, s.train) for c, s in zip(cases, splits, strict=True) if s.train.size]


def earlier_fold(
    cases: Sequence[Case],
    splits: Sequence[Split],
    priors: ModePriors,
    heat_input: HeatInput,
    config: IdentificationConfig,
    sign: int,
) -> Fold | None:
    """Return the cases without their held-out rows, as many of the rest held out anew, and the fit to the others.

    None where nothing can be held out anew.
    """
    before, anew = before_held_out(cases, splits, config)
    if not before:
        return None
    return Fold(before, anew, fit_modes(training_data(before, anew), priors, sign), priors, heat_input)


def before_held_out(
    cases: Sequence[Case], splits: Sequence[Split], config: IdentificationConfig
) -> tuple[list[Case], list[Split]]:
    """Return the cases as they were before their held-out rows, and as many of the last rows held out anew.

    Of runs, those with held-out rows; where there are none, of pairs: those that are not held out are divided as
    `held_out` divides all.
    """
    some = [(case, split) for case, split in zip(cases, splits, strict=True) if split.train.size]
    runs = [(case, split) for case, split in some if not case.regression.is_pair and split.judged.size]
    if runs:
        before = [replace(case, regression=_part(case.regression, split.train)) for case, split in runs]
        return before, [split_before(case, split, config) for case, split in runs]
    pairs = [replace(case, regression=_part(case.regression, split.train)) for case, split in some]
    return pairs, held_out(pairs, config)


def split_before(case: Case, split: Split, config: IdentificationConfig) -> Split:
    """The training rows of a run, with as many of the last ones held out as `split` has."""
    share = config.validation_share / (1.0 - config.validation_share)
    return split_run(_part(case.regression, split.train), share, config.horizon_h)


def fit_and_judge(
    cases: Sequence[Case],
    splits: Sequence[Split],
    priors: ModePriors,
    config: IdentificationConfig,
    sign: int,
) -> Fitted:
    """Fit to the training rows and evaluate on the held-out rows and rollouts."""
    fit = fit_modes(training_data(cases, splits), priors, sign)
    whitened, errors = [], []
    for case, split in zip(cases, splits, strict=True):
        if not split.judged.size:
            continue
        rest = residuals(case.regression, fit.log_tau)
        residual = case.regression.target - rest.mean - forced_columns(case.regression, fit.log_tau, sign) @ fit.gains
        after_action = split.judged[follows_action(case.regression, _AFTER_ACTION_H)[split.judged]]
        first = int(split.judged[0])
        white, factor = rest.later(residual, first)
        whitened.append(white[after_action - first])
        # What the rows before a rollout do not predict of it.
        later = [ahead - first for ahead in split.rollouts]
        errors += [factor[np.ix_(ahead, ahead)] @ white[ahead] for ahead in later]
    rollout_rmse_K = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    return Fitted(fit, np.concatenate(whitened), rollout_rmse_K)
