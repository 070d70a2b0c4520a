"""The paper's two stages as the estimate of a zone."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.estimation.modes import centred_priors
from thermoforce_mpc.identification.estimation.regression import RegressionData
from thermoforce_mpc.identification.estimation.uncertainty import STEP_RESPONSE_H
from thermoforce_mpc.identification.two_stage import TwoStageFit, fit_passive, fit_two_stage
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.identification.validation.held_out import before_held_out
from thermoforce_mpc.identification.zones.data import Estimate, ZoneData
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# Relative prior standard deviation of pole and gain around the two-stage fit while the network is trained.
_TWO_STAGE_SD = 0.3
# Bounds of the time constant while the network is trained, h.
_POLE_BOUNDS_H = np.array([[2.5, 250.0]])


def two_stage_estimate(data: ZoneData) -> Estimate:
    """Return the paper's two stages, from which training of the network starts, on pairs if any.

    They are judged on held-out rows, in which the stages had no part either: of pairs if there are any, else of runs.
    """
    config, runs = data.config, data.runs
    if not runs:
        raise DataError("method two_stage needs single runs, none were given; for pairs only use method joint")
    fit = fit_two_stage(runs, heat_input=data.heat_input, sign=data.sign)
    regressions, unjudged = _regressions(data, data.heat_input), ""
    try:
        last = _fold(data, "training", fit)
    except DataError as error:
        last, unjudged = _of_fit(regressions, fit, runs), f"it cannot be judged without its held-out rows: {error}"
    before = None
    if not unjudged:
        with suppress(DataError):  # there is no earlier part then
            before = _fold(data, "earlier", fit)
    return Estimate(
        everything=_of_fit([replace(e, held=0) for e in regressions], fit, runs),
        last=last,
        before=before,
        bounds_h=lambda log_tau: _POLE_BOUNDS_H,
        # Without modulation only pole and gain are trained, on pairs.
        gamma=0.0 if config.modulation == "linear" else config.gamma,
        trains=bool(data.pairs) or config.modulation != "linear",
        free=fit.free_model().resampled(data.step_s or fit.step_s),
        scores={
            "one_step_rmse_K": fit.rmse_K,
            "off_steps": fit.n_off,
            "on_steps": fit.n_on,
            "acts_log_odds": 0.5 * (fit.g / fit.g_sd) ** 2,
        },
        certainty=lambda operator: {"pole_sd": fit.a_sd, "gain_sd_K": fit.g_sd} | _step_response(fit, operator),
        unjudged=unjudged,
    )


def _regressions(data: ZoneData, heat_input: HeatInput) -> list[RegressionData]:
    """What the network is trained and everything judged on: the pairs if there are any, else the runs."""
    return replace(data, heat_input=heat_input, runs=() if data.pairs else data.runs).regressions


def _fold(data: ZoneData, fold: str, fit: TwoStageFit) -> Fold:
    """The two stages without the held-out rows of runs; held-out pairs have no part in them anyway.

    Raises:
        DataError: too few steps are left.
    """
    heat_input = data.heat_input_of(fold)
    regressions = _regressions(data, heat_input)
    if fold == "earlier":
        regressions = before_held_out(regressions, data.config)
    seen = [e.histories[0].slice(0, int(e.rows[e.seen - 1])) for e in regressions if not e.is_pair and e.seen]
    if seen:
        fit = fit_two_stage(seen, heat_input=heat_input, sign=fit.sign)
    return _of_fit(regressions, fit, seen or data.runs)


def _of_fit(regressions: Sequence[RegressionData], fit: TwoStageFit, runs: Sequence[Record]) -> Fold:
    operator = fit.operator()
    log_tau = np.log(operator.time_constants_h)
    gains = np.abs(operator.steady_gains_K) / operator.time_constants_h
    priors = centred_priors(log_tau, gains, _TWO_STAGE_SD)
    return Fold(regressions, log_tau, gains, priors, fit.heat_input, fit.free_model(), fit_passive(runs).free_model())


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
