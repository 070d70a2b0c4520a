"""Model of one zone from its records: effects and free part of the network, monotone-neural gain, verdict.

The network of the first part of the data gives the verdict, that of everything the model; the modulation is trained the
same way, and kept unless it is worse; an operator whose actuator is not shown to act or whose sign is not proven is
refused, whatever the method. The zone's own actuator is the first of its records.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.effects.level_laws import part_load_costs
from thermoforce_mpc.identification.estimation.modes import in_steps
from thermoforce_mpc.identification.modulation.selection import modulate, prove
from thermoforce_mpc.identification.validation.competence import judge
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.identification.validation.held_out import normalisation, ranges
from thermoforce_mpc.identification.validation.reasons import UNJUDGED
from thermoforce_mpc.identification.validation.warnings import uncertain
from thermoforce_mpc.identification.zones.data import Estimate, ZoneData
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.competence import Competence
from thermoforce_mpc.model.operator.parameters import OperatorParameters, linear_operator
from thermoforce_mpc.model.zone_model import ZoneModel

# Least log odds that the actuator acts: of 84 random houses with the levels of another one, 2 had more
# (`python -m benchmarks.zones.placebo` for houses of rooms).
_LEAST_LOG_ODDS = 5.0
_ACTS_NOT = "nothing in the record shows that the actuator does anything to the room"
_LEVEL_FOR_HEAT = (
    "without the held-out rows too little heat was metered for a law of it: the verdict takes the level for heat there"
)


def identify_zone(data: ZoneData, estimate: Estimate, say: Callable[[str], None]) -> ZoneModel:
    """The zone's model from a linear estimate.

    Raises:
        DataError: nothing shows that the actuator acts (where it is alone), or its effect has no proven sign.
    """
    model = _accepted(_modelled(data, estimate, say), data)
    say(f"identified an operator of order {model.operator.order}")
    return model


def _accepted(model: ZoneModel, data: ZoneData) -> ZoneModel:
    """`model`, not competent where the record does not show that its actuator acts.

    Raises:
        DataError: it does not and the actuator is alone in the building, or its effect has no proven sign.
    """
    missing = _without_effect(model.card.scores["acts_log_odds"], data)
    if missing and data.alone:
        raise DataError(missing)
    prove(model.operator)
    if not missing:
        return model
    verdict = replace(
        model.card.competence or Competence(False), competent=False, reasons=(missing,), plainly=_ACTS_NOT
    )
    return replace(model, card=replace(model.card, competence=verdict))


def _without_effect(log_odds: float, data: ZoneData) -> str:
    """What is wrong where the record does not show an effect, and what to do; empty where it does."""
    if log_odds >= _LEAST_LOG_ODDS:
        return ""
    dark = not any(np.any(h.solar_W_m2) for h in data.histories)
    return (
        f"no effect of the actuator with the sign of {'heating' if data.sign > 0 else 'cooling'} was found in the "
        f"data: the log odds that it acts are {log_odds:.1f}, need {_LEAST_LOG_ODDS:g}; check the sign of u, whether "
        "the actuator reached the zone, and that the zone sensor is in the room that it serves, or probe "
        f"harder{'; the record has no irradiance: name a signal for the sun' if dark else ''}"
    )


def _modelled(data: ZoneData, estimate: Estimate, say: Callable[[str], None]) -> ZoneModel:
    """The zone's model of an estimate, with its network and its verdict."""
    config, everything, last, before = data.config, estimate.everything, estimate.last, estimate.before
    histories, sign, step_s = data.histories, data.sign, data.histories[0].step_s
    mean, scale = normalisation(histories)

    def linear(fold: Fold) -> OperatorParameters:
        poles, gains = in_steps(fold.log_tau, fold.gains, step_s)
        return linear_operator(
            poles,
            sign * gains,
            step_s=step_s,
            sign=sign,
            gamma=config.gamma,
            hidden=config.hidden,
            heat_input=fold.heat_input,
            feature_mean=mean,
            feature_scale=scale,
        )

    operator = replace(linear(everything), feedback=config.feedback)
    scores, notes = dict(estimate.scores), list(data.said)
    if everything.heat_input.law is not None and last.heat_input.law is None:
        notes.append(_LEVEL_FOR_HEAT)
    if config.modulation != "linear":
        say("training the modulation of the gain")
        modulated = modulate(everything, last, before, linear, config, data.power)
        operator, last, before = modulated.operator, modulated.last, modulated.before
        scores, notes = scores | modulated.scores, [*notes, *modulated.notes]
    certainty = estimate.effects[0].uncertainty(data.level_sd) | {"sensor_resolution_K": data.grid_K}
    operator = operator.resampled(data.step_s or step_s)
    for cost in part_load_costs(estimate.laws, histories, data.power, everything.heat_input):
        certainty |= cost.numbers()
    verdict = judge(last, before, operator, certainty, scores["acts_log_odds"], data.heat_W_m2)
    if estimate.unjudged:
        verdict = Competence(False, (estimate.unjudged,), plainly=UNJUDGED)
    return ZoneModel(
        operator=operator,
        power=data.power,
        free=everything.free and everything.free.resampled(data.step_s or step_s),
        card=ModelCard(
            source=data.source,
            data=data.data,
            ranges=ranges(histories),
            scores=scores,
            uncertainty=certainty,
            config=config.model_dump(mode="json"),
            notes=(*notes, *uncertain(certainty)),
            competence=verdict,
            sun_on_sensor=data.sun,
        ),
    )
