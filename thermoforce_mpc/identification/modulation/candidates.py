"""Candidates of a fold for the modulation m(x) of its gain, and what its held-out rows choose among them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.joint import ModeFit
from thermoforce_mpc.identification.estimation.likelihood import residuals
from thermoforce_mpc.identification.estimation.modes import centred_priors
from thermoforce_mpc.identification.estimation.regression import RegressionData, calibrated
from thermoforce_mpc.identification.modulation.misfit import TrainingData, responses
from thermoforce_mpc.identification.modulation.training import TrainingResult, train
from thermoforce_mpc.identification.validation.blocks import is_significant, standard_errors_saved
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.identification.validation.held_out import LEAST_SCALE, Case
from thermoforce_mpc.model.forced_history import forced_history
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# A held-out comparison decides at this probability (Student's t, one-sided), if the RMS is below this share.
_SIGNIFICANT, _RELEVANT = 0.95, 0.98
# Relative prior standard deviation of gains and time constants while the network is trained on runs.
_LINEAR_HELD_SD = 0.02


@dataclass(frozen=True)
class Choice:
    """Whether the input is the level or measured heat, and whether the network is kept; scores and notes on it."""

    level: bool
    kept: bool
    scores: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Candidates:
    """The networks of a fold, trained as they are asked for.

    `held_levels`: why plans need measured heat whatever held-out data say; empty where they do not.
    """

    fold: Fold
    linear: Callable[[ModeFit, HeatInput], OperatorParameters]
    config: IdentificationConfig
    held_levels: str

    @cached_property
    def features(self) -> list[tuple[Array, ...]]:
        """x_t (n, 4) of each run; control-free temperatures are those of the linear fit."""
        base = self.linear(self.fold.fit, self.fold.heat_input)
        return [tuple(_features(base, h, self.config.feedback) for h in case.histories) for case in self.fold.cases]

    @cached_property
    def untrained(self) -> OperatorParameters:
        """The linear operator; its features are normalised by the rows that the fold may see."""
        seen = []
        for xs, case, split in zip(self.features, self.fold.cases, self.fold.splits, strict=True):
            if split.train.size:
                n = int(case.regression.rows[split.train[-1]])
                seen += [x[:n] for x in xs]
        stacked = np.concatenate(seen)
        scale = np.maximum(stacked.std(axis=0), LEAST_SCALE)
        return replace(
            self.linear(self.fold.fit, self.fold.heat_input), feature_mean=stacked.mean(axis=0), feature_scale=scale
        )

    @property
    def level(self) -> bool:
        """Whether the input is the level where nothing was chosen on held-out data."""
        return may_be_level(self.untrained.heat_input, self.config) and not self.held_levels

    def driven(self, level: bool) -> list[RegressionData]:
        """The regressions with the level or measured heat as drives."""
        return [by_level(case, self.untrained.heat_input) if level else case.regression for case in self.fold.cases]

    def trained(self, level: bool) -> TrainingResult:
        """The network trained on the training rows."""
        if level not in self._results:
            self._results[level] = self._train(level)
        return self._results[level]

    @cached_property
    def _results(self) -> dict[bool, TrainingResult]:
        return {}

    def _train(self, level: bool) -> TrainingResult:
        fold, heat_input = self.fold, self.untrained.heat_input
        driven = calibrated(self.driven(level), fold.fit.residual_scale)
        data = [
            TrainingData(e, x, residuals(e, fold.fit.log_tau), split)
            for e, x, split in zip(driven, self.features, fold.splits, strict=True)
        ]
        # The linear fit assumed larger disturbances; training must not change its slow gain.
        pairs_only = all(c.regression.is_pair for c in fold.cases)
        priors = fold.priors if pairs_only else centred_priors(fold.fit.log_tau, fold.fit.gains, _LINEAR_HELD_SD)
        return train(
            replace(self.untrained, heat_input=heat_input.by_level if level else heat_input), data, priors, self.config
        )

    @cached_property
    def choice(self) -> Choice:
        """What the held-out rows choose."""
        heat, notes = self.trained(level=False), []
        found, level = heat, False
        if may_be_level(self.untrained.heat_input, self.config):
            why = self.held_levels
            if not why:
                by_its_level = self.trained(level=True)
                why = _why_better(heat.residuals, by_its_level.residuals, by_its_level.blocks)
            if not why:
                found, level = by_its_level, True
            notes.append(f"heat input: {f'measured heat, since {why}' if why else 'the level, v = u'}")
        worse = _why_better(heat.residuals_before, found.residuals, found.blocks)
        kept = self.config.modulation == "always" or not worse
        if not kept:
            notes.append(f"network not kept: m = 1 instead, since {worse}")
        scores = {
            "held_out_linear": _rms(heat.residuals_before),
            "held_out_neural": _rms(found.residuals),
            "modulation_kept": float(kept),
        }
        return Choice(level, kept, scores, tuple(notes))

    def effects(self, choice: Choice) -> list[Array]:
        """What the actions did by the operator of `choice`, K, at the rows of each case."""
        if not choice.kept:
            return self.fold.linear_effects(self.untrained.sign)
        operator, effects = self.trained(choice.level).operator, []
        for e, xs in zip(self.driven(choice.level), self.features, strict=True):
            drive = np.sum(
                [sign * v * operator.modulation(x) for (sign, v), x in zip(e.drives, xs, strict=True)], axis=0
            )
            modes, _ = responses(drive[None], operator.poles)
            effects.append((modes[0] @ operator.gains)[e.rows])
        return effects


def may_be_level(heat_input: HeatInput, config: IdentificationConfig) -> bool:
    """Whether it is open if the input is measured heat or the level."""
    return heat_input.heat is not None and config.heat_input == "auto"


def by_level(case: Case, heat_input: HeatInput) -> RegressionData:
    """The regression of a case, driven by `heat_input`, with the levels as drives.

    A level that was held counts as the share of time at full level that gives its heat, as levels of a plan do.
    """
    drives = tuple(
        (sign, drive / heat_input(np.asarray(1.0), history.T_out_C[:-1]))
        for (sign, drive), history in zip(case.regression.drives, case.histories, strict=True)
    )
    return replace(case.regression, drives=drives)


def _features(operator: OperatorParameters, history: Record, feedback: bool) -> Array:
    """Return the features x_t (n, 4) of a run, with T − F (no gradient through F) or, with feedback, measured T."""
    forced = 0.0 if feedback else _own_forced(operator, history)
    free = history.T_zone_C[0] - forced
    steps = np.arange(free.size)
    finite = np.isfinite(free)
    free = np.interp(steps, steps[finite], free[finite])
    return feature_matrix(free[:-1], history.T_out_C[:-1], history.solar_W_m2[:-1], history.time_s[:-1])


def _own_forced(operator: OperatorParameters, history: Record) -> Array:
    """Return the forced response (n + 1,) K of a zone to its own actuator."""
    return forced_history(single(operator), history.part(0, [0])).sum(axis=(0, 1, 3))


def _why_better(residuals: Array, than: Array, blocks: NDArray[np.intp]) -> str:
    """In what held-out `residuals` are smaller, in words; empty unless by 2 % and significantly, block by block."""
    error, other = _rms(residuals), _rms(than)
    if error >= _RELEVANT * other or not is_significant(*standard_errors_saved(than, residuals, blocks), _SIGNIFICANT):
        return ""
    return f"held-out data are predicted better with it: error {error:.3g} instead of {other:.3g} standard deviations"


def _rms(residuals: Array) -> float:
    return float(np.sqrt(np.mean(residuals**2))) if residuals.size else float("nan")
