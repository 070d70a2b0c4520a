"""Thermal model of a zone by the paper's two stages: their fit, its modulation, and the verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.joint import ModeFit
from thermoforce_mpc.identification.estimation.modes import centred_priors, to_operator
from thermoforce_mpc.identification.estimation.regression import RegressionData
from thermoforce_mpc.identification.estimation.uncertainty import STEP_RESPONSE_H
from thermoforce_mpc.identification.modulation.selection import modulate
from thermoforce_mpc.identification.two_stage import TwoStageFit, fit_two_stage
from thermoforce_mpc.identification.validation.competence import Trial, judge
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.identification.validation.held_out import before_held_out, normalisation, ranges
from thermoforce_mpc.identification.validation.reasons import UNJUDGED
from thermoforce_mpc.identification.zones.data import ZoneData
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.competence import Competence
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.zone_model import ZoneModel

# Relative prior standard deviation of pole and gain around the two-stage fit while the network is trained.
_TWO_STAGE_SD = 0.3
# Bounds of the time constant while the network is trained, h.
_POLE_BOUNDS_H = np.array([[2.5, 250.0]])


def two_stage_model(data: ZoneData) -> ZoneModel:
    """Return the thermal model, order 1; training of the network, on pairs if any, starts from the two-stage fit.

    It is judged on held-out rows, in which the stages had no part either: of pairs if there are any, else of the runs.
    """
    config, runs, pairs, sign = data.config, data.runs, data.pairs, data.sign
    if not runs:
        raise DataError("method two_stage needs single runs, none were given; for pairs only use method joint")
    heat_input = data.heat_input_of("whole")
    fit = fit_two_stage(runs, heat_input=heat_input, sign=sign)
    step_s = data.step_s or fit.step_s
    operator = fit.operator()
    scores = {
        "one_step_rmse_K": fit.rmse_K,
        "off_steps": fit.n_off,
        "on_steps": fit.n_on,
        "acts_log_odds": 0.5 * (fit.g / fit.g_sd) ** 2,
    }
    regressions, unjudged = _regressions(data, heat_input), ""
    seen = _regressions(data, data.heat_input_of("training"))
    try:
        last = _fold(seen, fit, data.heat_input_of("training"))
    except DataError as error:
        last, unjudged = _of_fit(regressions, fit), f"without its held-out rows: {error}"
    before = None
    if not unjudged:
        earlier = before_held_out(_regressions(data, data.heat_input_of("earlier")), config)
        with suppress(DataError):  # there is no earlier part then
            before = _fold(earlier, fit, data.heat_input_of("earlier"))
    trials = Trial.linear(last, sign), None if before is None else Trial.linear(before, sign)
    said: list[str] = []
    if pairs or config.modulation != "linear":
        histories = [h for e in regressions for h in e.histories]
        everything = _of_fit([replace(e, held=0) for e in regressions], fit)
        modulated = modulate(everything, last, before, _linear(fit, histories, config), config)
        operator, said, trials = modulated.operator, modulated.notes, (modulated.last, modulated.before)
        scores |= modulated.scores
    known = _step_response(fit, operator)
    verdict = judge(*trials, operator, known, scores["acts_log_odds"], data.heat_W_m2)
    if unjudged:
        verdict = Competence(False, (f"it cannot be judged {unjudged}",), plainly=UNJUDGED)
    return ZoneModel(
        operator=operator.resampled(step_s),
        free=fit.free_model().resampled(step_s),
        card=ModelCard(
            source=data.source,
            data=data.data,
            ranges=ranges(data.histories),
            scores=scores,
            uncertainty={"pole_sd": fit.a_sd, "gain_sd_K": fit.g_sd} | known,
            config=config.model_dump(mode="json"),
            notes=(*data.said, *said),
            competence=verdict,
        ),
    )


def _regressions(data: ZoneData, heat_input: HeatInput) -> list[RegressionData]:
    """What the network is trained and everything judged on: the pairs if there are any, else the runs."""
    return replace(data, heat_input=heat_input, others=(), runs=() if data.pairs else data.runs).regressions


def _fold(regressions: Sequence[RegressionData], fit: TwoStageFit, heat_input: HeatInput) -> Fold:
    """The two stages without the held-out rows of runs; held-out pairs have no part in them anyway.

    Raises:
        DataError: too few steps are left.
    """
    seen = [e.histories[0].slice(0, int(e.rows[e.seen - 1])) for e in regressions if not e.is_pair and e.seen]
    if seen:
        fit = fit_two_stage(seen, heat_input=heat_input, sign=fit.sign)
    return _of_fit(regressions, fit)


def _of_fit(regressions: Sequence[RegressionData], fit: TwoStageFit) -> Fold:
    modes = _as_modes(fit)
    priors = centred_priors(modes.log_tau, modes.gains, _TWO_STAGE_SD)
    return Fold(regressions, modes, priors, fit.heat_input)


def _as_modes(fit: TwoStageFit) -> ModeFit:
    operator = fit.operator()
    slope = np.abs(operator.steady_gains_K) / operator.time_constants_h
    return ModeFit(np.log(operator.time_constants_h), slope, residual_scale=1.0)


def _linear(
    fit: TwoStageFit, histories: Sequence[Record], config: IdentificationConfig
) -> Callable[[ModeFit, HeatInput], OperatorParameters]:
    """The operator, m = 1, of a fit of one mode."""
    mean, scale = normalisation(histories)

    def linear(mode_fit: ModeFit, heat_input: HeatInput) -> OperatorParameters:
        return to_operator(
            mode_fit.log_tau,
            mode_fit.gains,
            step_s=fit.step_s,
            bounds_h=_POLE_BOUNDS_H,
            sign=fit.sign,
            # Without modulation only pole and gain are trained.
            gamma=0.0 if config.modulation == "linear" else config.gamma,
            hidden=config.hidden,
            heat_input=heat_input,
            feature_mean=mean,
            feature_scale=scale,
        )

    return linear


def _step_response(fit: TwoStageFit, operator: OperatorParameters) -> dict[str, float]:
    """Step response of `operator` to full level by name, K, known as well, in relation to it, as that of the fit.

    Standard deviations are a first-order propagation of the standard errors of a and g, which are those of different
    steps.
    """
    typical, out = float(operator.modulation(operator.feature_mean)), dict[str, float]()
    for hours in STEP_RESPONSE_H:
        n = np.arange(max(1, round(hours * HOUR_S / fit.step_s)))
        by_g = float(np.sum(fit.a**n))
        by_a = fit.g * float(np.sum(n[1:] * fit.a ** (n[1:] - 1.0)))
        sd, response = float(np.hypot(by_a * fit.a_sd, by_g * fit.g_sd)), abs(fit.g) * by_g
        said = typical * abs(float(operator.impulse(n.size).sum()))
        out[f"step_response_{hours}h_K"] = said
        out[f"step_response_{hours}h_sd_K"] = sd / response * said if response else sd
    return out
