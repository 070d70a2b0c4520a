"""Model of one zone from its records: order, linear fit, monotone-neural gain, verdict.

Fit every order to the first part of the data and keep the one whose rollouts are best on the rest; fit it to
everything; train the modulation the same way, and keep it unless it is worse; refuse an operator that explains next to
nothing or whose sign is not proven, whatever the method. The zone's own actuator is the first of its records; the
others' effects are estimated with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from thermoforce_mpc.data import DAY_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.part_load import level_shape
from thermoforce_mpc.identification.effects.sun_on_sensor import sun_on_sensor
from thermoforce_mpc.identification.estimation.joint import JointFit, ModeFit, fit_joint
from thermoforce_mpc.identification.estimation.modes import DIRECT_SLOPES_K_PER_H, mode_priors, to_operator
from thermoforce_mpc.identification.estimation.records import Pair, resolution_K
from thermoforce_mpc.identification.estimation.regression import (
    OtherActuator,
    pair_regression,
    run_regression,
)
from thermoforce_mpc.identification.estimation.uncertainty import uncertainty
from thermoforce_mpc.identification.modulation.selection import by_level, modulate, prove
from thermoforce_mpc.identification.two_stage import two_stage_model
from thermoforce_mpc.identification.validation.competence import Fold, held_out_h, held_out_rmse_K, judge
from thermoforce_mpc.identification.validation.held_out import Case, held_out, normalisation, ranges
from thermoforce_mpc.identification.validation.order import (
    Fitted,
    choose_order,
    earlier_fold,
    explained_share,
    fit_and_judge,
    training_data,
)
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.competence import Competence
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.zone_model import ZoneModel

# Least share of the whitened variance that the forced response must explain to be accepted.
_LEAST_EXPLAINED = 0.1
# Held-out hours from which priors of the initial slope are compared: fewer decide by chance.
_LEAST_HELD_OUT_H = 9.0
# Share of the held-out error that another prior of the initial slope must undercut to be taken.
_CLEARLY_BETTER = 0.9
# Relative standard deviation of the answer after a day from which a model is called uncertain.
_UNCERTAIN = 0.15


@dataclass(frozen=True)
class ZoneTask:
    """What one zone is identified from.

    Attributes:
        runs, pairs: records of the zone, prepared (`identification.records`); the first level is that of its own
            actuator, the rest are those of `others`.
        heat_input: what the own actuator delivers.
        sign: +1 if it heats, −1 if it cools.
        others: the other actuators of the building.
        floor_area_m2: of the zone; with measured heat it turns the physical priors on.
        share: of the zone in the floor area of all zones.
        step_s: step of the operator, s; None: that of the data.
        source, data, notes: for the model card.
        power: of the machine, where it feeds this actuator alone.
        level_sd: relative standard deviation of the effect that comes from heat that was not measured.
        alone: whether the building has no other actuator. Of several, one without an effect must not refuse the rest:
            its model is returned, not competent.
    """

    runs: Sequence[Record]
    pairs: Sequence[Pair]
    heat_input: HeatInput
    sign: int
    others: Sequence[OtherActuator] = ()
    floor_area_m2: float | None = None
    share: float = 1.0
    step_s: float | None = None
    source: str = "identified"
    data: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    power: PowerModel | None = None
    alone: bool = True
    level_sd: float = 0.0


def identify_zone(
    task: ZoneTask, config: IdentificationConfig, say: Callable[[str], None]
) -> tuple[ZoneModel, JointFit | None]:
    """Return the zone's model and its linear fit, None with method two_stage.

    Raises:
        DataError: the action explains too little (where it is alone), or its effect has no proven sign.
    """
    runs, pairs, sign, notes = task.runs, task.pairs, task.sign, list(task.notes)
    grid_K = resolution_K(runs)
    sun = None
    if runs and config.sun_on_sensor:
        likeliest = sun_on_sensor(runs, task.heat_input, config, grid_K, task.others)
        sun = likeliest if likeliest is not None and likeliest.likely else None
    if sun is not None:
        runs = [replace(h, T_zone_C=h.T_zone_C - sun.part_K(h.time_s, h.solar_W_m2)) for h in runs]
        notes.append(sun.in_words())
    histories = [*runs, *(h for p in pairs for h in (p.a, p.b))]
    if grid_K:
        # Rounding errors are uniform: their standard deviation is a twelfth's root of the resolution.
        sensor_sd_K = float(np.hypot(config.sensor_sd_K, grid_K / np.sqrt(12.0)))
        config = config.model_copy(update={"sensor_sd_K": sensor_sd_K})
        notes.append(f"the zone sensor reads in steps of {grid_K:.2g} K: noise of {sensor_sd_K:.2g} K assumed")
    days = sum(h.n_steps * h.step_s for h in histories) / DAY_S
    say(f"fitting the forced response to {days:.3g} days at {histories[0].step_s:g} s")
    cases = [Case(run_regression(h, task.heat_input, config, task.others), (h,), float(h.time_s[0])) for h in runs] + [
        Case(pair_regression(p, task.heat_input, task.others), (p.a, p.b), float(p.a.time_s[0])) for p in pairs
    ]
    fit = None
    if config.method == "two_stage":
        model = two_stage_model(runs, pairs, task.data, config, task.heat_input, sign, task.step_s, task.source, notes)
    else:
        model, fit = _joint_model(
            runs, task.data, cases, config, task.heat_input, task.floor_area_m2, task.share, sign, task.step_s,
            task.source, notes, say, task.power, task.level_sd, grid_K,
        )  # fmt: skip
    model = _accepted(model, cases, sign, task.alone)
    model = replace(model, card=replace(model.card, sun_on_sensor=sun))
    say(f"identified an operator of order {model.operator.order}")
    return model, fit


def _accepted(model: ZoneModel, cases: Sequence[Case], sign: int, alone: bool) -> ZoneModel:
    """`model`, with the share that its actions explain on its card, and not competent where that is too little.

    Raises:
        DataError: they explain too little and the actuator is `alone`, or their effect has no proven sign.
    """
    explained = explained_share(cases, model.operator)
    missing = _unexplained(explained, cases, sign)
    if missing and alone:
        raise DataError(missing)
    prove(model.operator)
    scores = {**model.card.scores, "explained_by_actuation": explained}
    verdict = model.card.competence
    if missing:
        verdict = replace(verdict or Competence(False), competent=False, reasons=(missing,))
    return replace(model, card=replace(model.card, scores=scores, competence=verdict))


def _unexplained(explained: float, cases: Sequence[Case], sign: int) -> str:
    """What is wrong where the action explains too little, and what to do; empty where it explains enough."""
    if explained >= _LEAST_EXPLAINED:
        return ""
    dark = not any(np.any(h.solar_W_m2) for case in cases for h in case.histories)
    return (
        f"no effect of the actuator with the sign of {'heating' if sign > 0 else 'cooling'} was found in the data: it "
        f"explains {100 * max(explained, 0.0):.1f} % of what the weather does not, need {100 * _LEAST_EXPLAINED:g} %; "
        "check the sign of u, whether the actuator reached the zone, and that the zone sensor is in the room that it "
        f"serves, or probe harder{'; the record has no irradiance: name a signal for the sun' if dark else ''}"
    )


def _joint_model(
    runs: Sequence[Record],
    data: Mapping[str, str],
    cases: Sequence[Case],
    config: IdentificationConfig,
    heat_input: HeatInput,
    floor_area_m2: float | None,
    share: float,
    sign: int,
    step_s: float | None,
    source: str,
    notes: Sequence[str],
    say: Callable[[str], None],
    power: PowerModel | None,
    level_sd: float,
    grid_K: float,
) -> tuple[ZoneModel, JointFit]:
    """The joint estimator as a zone's model, and its fit: order and input of the modulation by held-out data."""
    histories = [h for case in cases for h in case.histories]
    splits = held_out(cases, config)
    training = {order: training_data(cases, splits, order, sign) for order in config.orders()}

    def fit_orders(chosen: IdentificationConfig) -> dict[int, Fitted]:
        priors = (mode_priors(order, chosen, heat_input, floor_area_m2, share) for order in chosen.orders())
        return {
            order_priors.order: fit_and_judge(cases, splits, training[order_priors.order], order_priors, config)
            for order_priors in priors
        }

    def error_K(fits: dict[int, Fitted]) -> float:
        best = fits[choose_order(fits)]
        return held_out_rmse_K(cases, splits, best.fit, sign)

    candidates = fit_orders(config)
    if config.start_slope_K_per_h is None and held_out_h(cases, splits) >= _LEAST_HELD_OUT_H:
        # Heat that reaches the air at once is not that of a slab; which it is shows in the held-out predictions.
        most_K = _CLEARLY_BETTER * error_K(candidates)
        for slope in DIRECT_SLOPES_K_PER_H:
            direct = fit_orders(config.model_copy(update={"start_slope_K_per_h": slope}))
            direct_K = error_K(direct)
            if direct_K < most_K:
                candidates, most_K = direct, direct_K
                slope_note = f"the zone responds at once: initial slope from a prior of {slope[0]:g} ± {slope[1]:g} K/h"
                notes = [*(note for note in notes if not note.startswith("the zone responds")), slope_note]
    order = choose_order(candidates)
    priors = candidates[order].priors
    final = fit_joint([c.regression for c in cases], priors, config, sign)
    base_step = histories[0].step_s
    mean, scale = normalisation(histories)

    def linear(fit: ModeFit) -> OperatorParameters:
        return to_operator(
            fit.log_tau,
            fit.gains,
            step_s=base_step,
            bounds_h=priors.bounds_h(),
            sign=sign,
            gamma=config.gamma,
            hidden=config.hidden,
            heat_input=heat_input,
            feature_mean=mean,
            feature_scale=scale,
        )

    operator = replace(linear(final), feedback=config.feedback)
    scores = {f"held_out_order_{k}": c.score for k, c in candidates.items()}
    scores["held_out_rollout_rmse_K"] = candidates[order].rollout_rmse_K
    scores["residual_scale"] = final.residual_scale
    if config.modulation != "linear":
        say(f"order {order} is best on held-out data; training the modulation of the gain")
        operator, neural, said = modulate(cases, splits, linear, candidates[order].fit, final, priors, config, power)
        scores, notes = scores | neural, [*notes, *said]
    operator = operator.resampled(step_s or base_step)
    certainty = uncertainty(final, operator.step_s, level_sd) | {"sensor_resolution_K": grid_K}
    shape: dict[str, float] = {}
    if power is not None and heat_input.heat is None and heat_input.lowest == 0.0:
        regressions = [by_level(case, heat_input) for case in cases]
        shape, shape_notes = level_shape(histories, regressions, final, priors, config, power, sign)
        notes = [*notes, *shape_notes]
    explained = explained_share(cases, operator)
    verdict = None
    if runs:
        fold = Fold(cases, splits, candidates[order].fit)
        earlier = earlier_fold(cases, splits, priors, config, sign)
        verdict = judge(fold, earlier, priors, certainty, explained, sign, own_loops=heat_input.lowest < 0.0)
    model = ZoneModel(
        operator=operator,
        power=power,
        free=final.free_model(step_s or base_step, config) if runs else None,
        card=ModelCard(
            source=source,
            data=data,
            ranges=ranges(histories),
            scores=scores,
            uncertainty=certainty | shape,
            config=config.model_dump(mode="json"),
            notes=(*notes, *_warnings(certainty)),
            competence=verdict,
        ),
    )
    return model, final


def _warnings(certainty: Mapping[str, float]) -> list[str]:
    """What a user should know before trusting the model."""
    share = certainty["step_response_24h_sd_K"] / max(certainty["step_response_24h_K"], 1e-9)
    if share <= _UNCERTAIN:
        return []
    return [f"uncertain: the effect of a day of action is known to ± {100 * share:.0f} % only; probe longer or harder"]
