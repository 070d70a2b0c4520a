"""Training m(x) on top of a linear fit, keeping it only where held-out data say so, and proving the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.cases import LEAST_SCALE, Case
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.joint import JointFit
from thermoforce_mpc.identification.likelihood import Split, residuals, whole
from thermoforce_mpc.identification.modes import ModePriors, centred_priors
from thermoforce_mpc.identification.regression_data import RegressionData, calibrated
from thermoforce_mpc.model.forced_history import forced_history
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# Held-out hours below which nothing is said about a network: a quarter of a day decides by chance. Behind heat
# what is left for it is small against the weather's surprises, so a whole cycle of sun and clock has to be held out.
_LEAST_JUDGED_H = {"identity": 12.0, "heat": 24.0}
# While the network is trained on runs, gains and time constants are held to within this relative deviation.
_LINEAR_HELD_SD = 0.02


def _features(operator: OperatorParameters, history: Record, feedback: bool) -> Array:
    """x_t of each step of a run: T − F by the linear operator (F feeds no gradient), or T as it was measured."""
    forced = forced_history(operator, history).sum(axis=1) if not feedback else 0.0
    free = history.T_zone_C - forced
    steps = np.arange(free.size)
    known = np.isfinite(free)
    free = np.interp(steps, steps[known], free[known])
    return feature_matrix(free[:-1], history.T_out_C[:-1], history.solar_W_m2[:-1], history.time_s[:-1])


def modulate(
    cases: Sequence[Case],
    splits: Sequence[Split],
    linear: Callable[[JointFit], OperatorParameters],
    part_fit: JointFit,
    final: JointFit,
    priors: ModePriors,
    config: IdentificationConfig,
) -> tuple[OperatorParameters, dict[str, float]]:
    """Train m(x) on part of the data to see whether it is worth it, then on all of it."""
    from thermoforce_mpc.identification.train import TrainingData, train

    base = linear(final)
    features = [tuple(_features(base, h, config.feedback) for h in c.histories) for c in cases]
    free = np.concatenate([x[:, 0] for xs in features for x in xs])
    mean, scale = base.feature_mean.copy(), base.feature_scale.copy()
    mean[0], scale[0] = free.mean(), max(float(free.std()), float(LEAST_SCALE[0]))

    def started(fit: JointFit) -> OperatorParameters:
        return replace(linear(fit), feature_mean=mean, feature_scale=scale)

    def regressions(fit: JointFit, chosen: Sequence[Split]) -> list[TrainingData]:
        return [
            TrainingData(e, x, residuals(e, fit.log_tau), s)
            for e, x, s in zip(
                calibrated([c.regression for c in cases], fit.residual_scale), features, chosen, strict=True
            )
        ]

    def known(fit: JointFit) -> ModePriors:
        # A run's slow gain was found under disturbances taken for large: the network's closer look must not undo it.
        if all(c.regression.is_pair for c in cases):
            return priors
        return centred_priors(priors, fit.log_tau, fit.gains, _LINEAR_HELD_SD)

    search = train(started(part_fit), regressions(part_fit, splits), known(part_fit), config)
    scores = {
        "held_out_linear": search.linear_score,
        "held_out_neural": search.score,
        "neural_improvement_in_standard_errors": search.improvement_in_standard_errors,
    }
    judged_h = sum(_hours(c.regression, s.judged) for c, s in zip(cases, splits, strict=True))
    scores["modulation_kept"] = float(search.worth_it and judged_h >= _LEAST_JUDGED_H[base.heat_input.kind])
    if not scores["modulation_kept"]:
        return replace(started(final), feedback=config.feedback), scores
    everything = [whole(c.regression) for c in cases]
    # Trained on measured temperatures as features, so nothing recurs; in use the predicted one takes their place.
    trained = train(started(final), regressions(final, everything), known(final), config).operator
    return replace(trained, feedback=config.feedback), scores


def _hours(regression: RegressionData, rows: NDArray[np.intp]) -> float:
    """Time that these compared rows stand for, h."""
    return rows.size * (regression.n_steps / max(1, regression.rows.size)) * regression.step_s / HOUR_S


def prove(operator: OperatorParameters) -> None:
    """Refuse an operator whose effect has no proven sign: only `feedback: true` can lead to one."""
    proof = certificate(operator)
    if not proof.certified:
        raise DataError(f"the identified operator is not certified: {'; '.join(proof.reasons)}")
