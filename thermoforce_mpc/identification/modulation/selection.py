"""Training of the modulation m(x) on a linear fit, its selection on held-out data, and the certificate check."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.joint import ModeFit
from thermoforce_mpc.identification.estimation.likelihood import Split, residuals, whole
from thermoforce_mpc.identification.estimation.modes import ModePriors, centred_priors
from thermoforce_mpc.identification.estimation.regression import RegressionData, calibrated
from thermoforce_mpc.identification.modulation.misfit import TrainingData
from thermoforce_mpc.identification.validation.blocks import is_significant, standard_errors_saved
from thermoforce_mpc.identification.validation.held_out import LEAST_SCALE, Case
from thermoforce_mpc.model.forced_history import forced_history
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.load_regression import LEVEL_EDGE
from thermoforce_mpc.model.machine.part_load import SWITCH_FROM, part_load
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters

if TYPE_CHECKING:  # training loads torch
    from thermoforce_mpc.identification.modulation.training import TrainingResult

# A held-out comparison decides at this probability (Student's t, one-sided), if the RMS is below this share.
_SIGNIFICANT, _RELEVANT = 0.95, 0.98
# Fixed share of heat up to which it counts as in proportion to the level.
_PROPORTIONAL = 0.1
# Levels from which full level counts as held, and share of the steps on from which lower ones are not mere trials.
_NEARLY_FULL, _OFTEN = 0.9, 0.25
# Relative prior standard deviation of gains and time constants while the network is trained on runs.
_LINEAR_HELD_SD = 0.02
# Step, s, and horizon, h, of plans by default.
_PLAN_STEP_S, _PLAN_H = 900.0, 48.0


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


def modulate(
    cases: Sequence[Case],
    splits: Sequence[Split],
    linear: Callable[[ModeFit], OperatorParameters],
    part_fit: ModeFit,
    final: ModeFit,
    priors: ModePriors,
    config: IdentificationConfig,
    power: PowerModel | None = None,
) -> tuple[OperatorParameters, dict[str, float], list[str]]:
    """Train m(x) on the training rows, choose its input on the held-out ones, and train it on all data.

    With heat input auto, v = u unless held-out data or held levels ask for measured heat. The operator is that with
    m = 1 where the network is significantly worse than that and is not kept `always`. Returns the operator, its
    held-out scores and notes in words.
    """
    training = _Training.of(cases, linear, final, priors, config)
    heat_input, notes = linear(final).heat_input, []
    found = training.run(part_fit, heat_input, splits)
    unmodulated = found.residuals_before
    if heat_input.heat is not None and config.heat_input == "auto" and config.heat_capacity is None:
        why, level = _held_levels(heat_input.heat, cases, power), None
        if not why:
            level = training.run(part_fit, heat_input.by_level, splits)
            why = _why_better(found.residuals, level.residuals, level.blocks)
        if level is not None and not why:
            found, heat_input = level, heat_input.by_level
        notes.append(f"heat input: {f'measured heat, since {why}' if why else 'the level, v = u'}")
    worse = _why_better(unmodulated, found.residuals, found.blocks)
    kept = config.modulation == "always" or not worse
    if kept:
        # With feedback, training uses measured temperatures, so there is no recursion; prediction uses predicted ones.
        operator = training.run(final, heat_input, [whole(c.regression) for c in cases]).operator
    else:
        notes.append(f"network not kept: m = 1 instead, since {worse}")
        hidden = {name: getattr(found.operator, name) for name in ("hidden_weight", "hidden_bias")}
        operator = replace(training.untrained(final), **hidden)
    scores = {
        "held_out_linear": _rms(unmodulated),
        "held_out_neural": _rms(found.residuals),
        "modulation_kept": float(kept),
    }
    return replace(operator, feedback=config.feedback), scores, notes


@dataclass(frozen=True)
class _Training:
    """What every training of a zone's network begins from: features x_t of each run, their mean and scale (4,)."""

    cases: Sequence[Case]
    features: Sequence[tuple[Array, ...]]
    mean: Array
    scale: Array
    linear: Callable[[ModeFit], OperatorParameters]
    priors: ModePriors
    config: IdentificationConfig

    @classmethod
    def of(
        cls,
        cases: Sequence[Case],
        linear: Callable[[ModeFit], OperatorParameters],
        final: ModeFit,
        priors: ModePriors,
        config: IdentificationConfig,
    ) -> _Training:
        """The training of a zone; control-free temperatures are those of its final linear fit."""
        base = linear(final)
        features = [tuple(_features(base, h, config.feedback) for h in c.histories) for c in cases]
        free = np.concatenate([x[:, 0] for xs in features for x in xs])
        mean, scale = base.feature_mean.copy(), base.feature_scale.copy()
        mean[0], scale[0] = free.mean(), max(float(free.std()), float(LEAST_SCALE[0]))
        return cls(cases, features, mean, scale, linear, priors, config)

    def untrained(self, fit: ModeFit) -> OperatorParameters:
        """The linear operator of a fit."""
        return replace(self.linear(fit), feature_mean=self.mean, feature_scale=self.scale)

    def run(self, fit: ModeFit, heat_input: HeatInput, splits: Sequence[Split]) -> TrainingResult:
        """Train on the rows of `splits` from a linear fit, with v of `heat_input`."""
        from thermoforce_mpc.identification.modulation.training import train

        linear, cases = self.untrained(fit), self.cases
        same = heat_input == linear.heat_input
        driven = [c.regression if same else _by_level(c, linear.heat_input) for c in cases]
        data = [
            TrainingData(e, x, residuals(e, fit.log_tau), split)
            for e, x, split in zip(calibrated(driven, fit.residual_scale), self.features, splits, strict=True)
        ]
        # The linear fit assumed larger disturbances; training must not change its slow gain.
        pairs_only = all(c.regression.is_pair for c in cases)
        priors = self.priors if pairs_only else centred_priors(fit.log_tau, fit.gains, _LINEAR_HELD_SD)
        return train(replace(linear, heat_input=heat_input), data, priors, self.config)


def _by_level(case: Case, heat_input: HeatInput) -> RegressionData:
    """The regression of a case, driven by `heat_input`, with the levels as drives.

    A level that was held counts as the share of time at full level that gives its heat, as levels of a plan do.
    """
    drives = tuple(
        (sign, drive / heat_input(np.asarray(1.0), history.T_out_C[:-1]))
        for (sign, drive), history in zip(case.regression.drives, case.histories, strict=True)
    )
    return replace(case.regression, drives=drives)


def _held_levels(heat: MachineLoad, cases: Sequence[Case], power: PowerModel | None) -> str:
    """Why plans need the heat of levels between off and full, in words; empty where v = u will do.

    Where heat is in proportion to the level, or the machine is switched at full level, it will.
    """
    fixed, per_u = (float(part) for part in heat.parts(0.5 * sum(heat.T_out_range_C)))
    if not heat.levels_seen or fixed <= _PROPORTIONAL * (fixed + per_u):
        return ""
    u = np.concatenate([h.u[0] for case in cases for h in case.histories])
    on = u > LEVEL_EDGE
    held = np.count_nonzero(on & (u < _NEARLY_FULL)) > _OFTEN * np.count_nonzero(on)
    at_part_load = None if power is None else part_load(power, heat)
    if not held and (at_part_load is None or at_part_load.at_half > 1.0 + SWITCH_FROM):
        return ""
    return "levels between off and full are held, whose heat is not in proportion to the level"


def _why_better(residuals: Array, than: Array, blocks: NDArray[np.intp]) -> str:
    """In what held-out `residuals` are smaller, in words; empty unless by 2 % and significantly, block by block."""
    error, other = _rms(residuals), _rms(than)
    if error >= _RELEVANT * other or not is_significant(*standard_errors_saved(than, residuals, blocks), _SIGNIFICANT):
        return ""
    return f"held-out data are predicted better with it: error {error:.3g} instead of {other:.3g} standard deviations"


def _rms(residuals: Array) -> float:
    return float(np.sqrt(np.mean(residuals**2))) if residuals.size else float("nan")


def prove(operator: OperatorParameters) -> None:
    """Raise `DataError` if the sign of the effect is not certified for plans, possible only with `feedback: true`.

    It must be at the operator's own step and at the controllers', over their horizon (the file states 48 steps).
    """
    for step_s in dict.fromkeys((operator.step_s, _PLAN_STEP_S)):
        proof = certificate(operator.resampled(step_s), max(48, round(_PLAN_H * HOUR_S / step_s)))
        if not proof.certified:
            raise DataError(f"the identified operator at {step_s:g} s is not certified: {'; '.join(proof.reasons)}")
