"""Rows before the held-out ones, and the fit to a part of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.joint import fit_modes
from thermoforce_mpc.identification.estimation.likelihood import Split, split_run
from thermoforce_mpc.identification.estimation.modes import ModePriors
from thermoforce_mpc.identification.estimation.regression import RegressionData
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.identification.validation.held_out import HELD_OUT_SHARE, Case, held_out
from thermoforce_mpc.model.operator.heat_input import HeatInput


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
    share = HELD_OUT_SHARE / (1.0 - HELD_OUT_SHARE)
    return split_run(_part(case.regression, split.train), share)
