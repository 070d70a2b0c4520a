"""Training of the modulation m(x) on a linear fit, its selection on held-out data, and the certificate check."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

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
from thermoforce_mpc.identification.validation.held_out import LEAST_SCALE, Case
from thermoforce_mpc.model.forced_history import forced_history
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# Least held-out hours to keep a network; 6 h would decide by chance. With a heat input the remaining effect is small
# compared with weather errors, so a whole day is needed.
_LEAST_JUDGED_H = {"identity": 12.0, "heat": 24.0}
# Relative prior standard deviation of gains and time constants while the network is trained on runs.
_LINEAR_HELD_SD = 0.02


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
) -> tuple[OperatorParameters, dict[str, float]]:
    """Train m(x) on the training rows; if it improves the held-out rows, train on all data, else keep m = 1.

    With too few held-out hours to decide, m = 1 without a try. Returns the operator and its held-out scores.
    """
    from thermoforce_mpc.identification.modulation.training import train

    base = linear(final)
    features = [tuple(_features(base, h, config.feedback) for h in c.histories) for c in cases]
    free = np.concatenate([x[:, 0] for xs in features for x in xs])
    mean, scale = base.feature_mean.copy(), base.feature_scale.copy()
    mean[0], scale[0] = free.mean(), max(float(free.std()), float(LEAST_SCALE[0]))

    def untrained(fit: ModeFit) -> OperatorParameters:
        return replace(linear(fit), feature_mean=mean, feature_scale=scale)

    def regressions(fit: ModeFit, chosen: Sequence[Split]) -> list[TrainingData]:
        return [
            TrainingData(e, x, residuals(e, fit.log_tau), s)
            for e, x, s in zip(
                calibrated([c.regression for c in cases], fit.residual_scale), features, chosen, strict=True
            )
        ]

    def training_priors(fit: ModeFit) -> ModePriors:
        # The linear fit assumed larger disturbances; training must not change its slow gain.
        if all(c.regression.is_pair for c in cases):
            return priors
        return centred_priors(fit.log_tau, fit.gains, _LINEAR_HELD_SD)

    held_out_h = sum(_hours(c.regression, s.judged) for c, s in zip(cases, splits, strict=True))
    if held_out_h < _LEAST_JUDGED_H[base.heat_input.kind]:
        return replace(untrained(final), feedback=config.feedback), {"modulation_kept": 0.0}
    search = train(untrained(part_fit), regressions(part_fit, splits), training_priors(part_fit), config)
    scores = {
        "held_out_linear": search.linear_score,
        "held_out_neural": search.score,
        "neural_improvement_in_standard_errors": search.improvement_in_standard_errors,
    }
    scores["modulation_kept"] = float(search.worth_it)
    if not scores["modulation_kept"]:
        return replace(untrained(final), feedback=config.feedback), scores
    everything = [whole(c.regression) for c in cases]
    # With feedback, training uses measured temperatures, so there is no recursion; prediction uses predicted ones.
    trained = train(untrained(final), regressions(final, everything), training_priors(final), config).operator
    return replace(trained, feedback=config.feedback), scores


def _hours(regression: RegressionData, rows: NDArray[np.intp]) -> float:
    """Return the time that `rows` represent, h."""
    return rows.size * (regression.n_steps / max(1, regression.rows.size)) * regression.step_s / HOUR_S


def prove(operator: OperatorParameters) -> None:
    """Raise `DataError` if the operator is not certified (sign of its effect), possible only with `feedback: true`."""
    proof = certificate(operator)
    if not proof.certified:
        raise DataError(f"the identified operator is not certified: {'; '.join(proof.reasons)}")
