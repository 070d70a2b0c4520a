"""Thermal model of the paper's two-stage estimator, with paired training (eq:paired) if there are pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.cases import Case, held_out, normalisation, ranges
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.joint import ModeFit
from thermoforce_mpc.identification.modes import centred_priors, mode_priors, to_operator
from thermoforce_mpc.identification.modulation import modulate
from thermoforce_mpc.identification.records import Pair
from thermoforce_mpc.identification.regression_data import pair_regression
from thermoforce_mpc.identification.two_stage import TwoStageFit, fit_two_stage
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.zone_model import ZoneModel

# Relative prior standard deviation of pole and gain around the two-stage fit in paired training.
_TWO_STAGE_SD = 0.3


def two_stage_model(
    runs: Sequence[Record],
    pairs: Sequence[Pair],
    data: Mapping[str, str],
    config: IdentificationConfig,
    heat_input: HeatInput,
    sign: int,
    step_s: float | None,
    source: str,
    notes: Sequence[str],
) -> ZoneModel:
    """Return the thermal model, order 1; with pairs, paired training (eq:paired) starts from the two-stage fit."""
    if not runs:
        raise DataError("method two_stage needs single runs, none were given; for pairs only use method joint")
    fit = fit_two_stage(runs, heat_input=heat_input, sign=sign, u_off=config.u_off)
    step_s = step_s or fit.step_s
    operator = fit.operator()
    scores: dict[str, float] = {}
    histories = [*runs, *(h for p in pairs for h in (p.a, p.b))]
    if pairs:
        operator, scores = _train_on_pairs(fit, pairs, histories, config)
    return ZoneModel(
        operator=operator.resampled(step_s),
        free=fit.free_model().resampled(step_s),
        card=ModelCard(
            source=source,
            data=data,
            ranges=ranges(histories),
            scores={"one_step_rmse_K": fit.rmse_K, "off_steps": fit.n_off, "on_steps": fit.n_on} | scores,
            uncertainty={"pole_sd": fit.a_sd, "gain_sd_K": fit.g_sd},
            config=config.model_dump(mode="json"),
            notes=tuple(notes),
        ),
    )


def _train_on_pairs(
    fit: TwoStageFit, pairs: Sequence[Pair], histories: Sequence[Record], config: IdentificationConfig
) -> tuple[OperatorParameters, dict[str, float]]:
    """Train pole, gain and modulation on pairs, priors centred on the two-stage fit; return operator and scores."""
    first = fit.operator()
    log_tau, slope = np.log(first.time_constants_h), np.abs(first.steady_gains_K) / first.time_constants_h
    start = ModeFit(log_tau, slope, residual_scale=1.0)
    weak = mode_priors(1, config.model_copy(update={"time_constants_h": None}), fit.heat_input, None)
    priors = centred_priors(log_tau, slope, _TWO_STAGE_SD)
    cases = [Case(pair_regression(p, fit.heat_input), (p.a, p.b), float(p.a.time_s[0])) for p in pairs]
    mean, scale = normalisation(histories)

    def linear(found: ModeFit) -> OperatorParameters:
        return to_operator(
            found.log_tau,
            found.gains,
            step_s=fit.step_s,
            bounds_h=weak.bounds_h(),
            sign=fit.sign,
            # Without modulation only pole and gain are trained.
            gamma=config.gamma if config.modulation == "neural" else 0.0,
            hidden=config.hidden,
            heat_input=fit.heat_input,
            feature_mean=mean,
            feature_scale=scale,
        )

    return modulate(cases, held_out(cases, config), linear, start, start, priors, config)
