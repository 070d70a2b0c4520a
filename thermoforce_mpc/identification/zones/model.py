"""Model of one zone from its linear estimate: monotone-neural gain, free part, verdict.

The estimate of the first part of the data gives the verdict, that of everything the model; the modulation is trained
the same way, and kept unless it is worse. An operator whose sign is not proven is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import DAY_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.effects.confounding import Unknown
from thermoforce_mpc.identification.effects.level_laws import part_load_costs
from thermoforce_mpc.identification.modulation import modulate, prove
from thermoforce_mpc.identification.validation.competence import UNJUDGED, judge
from thermoforce_mpc.identification.validation.errors_ahead import Fold, hours_seen
from thermoforce_mpc.identification.zones.data import Estimate, ZoneData
from thermoforce_mpc.model.card import AIRED_K, AIRED_STEPS, Competence
from thermoforce_mpc.model.machine.blocked_hours import HourEffects
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.thermal_model import ZoneModel

# Least log odds that the actuator acts: of 84 random houses with the levels of another one, 2 had more
# (`python -m benchmarks.zones.placebo` for houses of rooms).
_LEAST_LOG_ODDS = 5.0
# Relative standard deviation of the effect of a day from which a model is called uncertain. Of words only; by
# judgement.
_UNCERTAIN = 0.15
_ACTS_NOT = "nothing in the record shows that the actuator does anything to the room"
_NO_LEVEL = "what was recorded as the actuator's level does not say what it did"
_LEVEL_FOR_HEAT = (
    "without the held-out rows too little heat was metered for a law of it: the verdict takes the level for heat there"
)


def identify_zone(
    data: ZoneData,
    estimate: Estimate,
    power: PowerModel | None,
    unknown: Unknown,
    notes: Sequence[str],
    say: Callable[[str], None],
) -> ZoneModel:
    """The zone's model.

    Args:
        power: of the machine, where it feeds the own actuator alone.
        unknown: what its levels do not say of its heat.
        notes: for the model card, on the power.

    Raises:
        DataError: nothing shows that the actuator acts (where it is alone), or its effect has no proven sign.
    """
    config, everything, last, before = data.config, estimate.everything, estimate.last, estimate.before
    histories, heat_input = data.histories, everything.heat_input
    step_s = data.step_s or histories[0].step_s
    operator = replace(everything.operator(config), feedback=config.feedback)
    scores, said = {**data.card.scores, **estimate.scores}, [*data.card.notes, *notes, *unknown.notes]
    if data.grid_K:
        said.append(f"the zone sensor reads in steps of {data.grid_K:.2g} K")
    scores |= _of_air(everything)
    if heat_input.law is not None and last.heat_input.law is None:
        said.append(_LEVEL_FOR_HEAT)
    if config.modulation != "linear":
        say("training the modulation of the gain")
        operator, (last, before), found, on_network = modulate(everything, last, before, config, power)
        scores, said = scores | found, [*said, *on_network]
    certainty = estimate.effects[0].uncertainty(unknown.sd) | {"sensor_resolution_K": data.grid_K}
    hours = _hours_that_differ(everything, operator, certainty)
    if hours.laws:
        said.append(hours.in_words())
    operator = operator.resampled(step_s)
    for cost in part_load_costs(estimate.laws, histories, power, heat_input):
        certainty |= cost.numbers()
    heat_W_m2 = heat_input.reference_W / data.area_m2 if heat_input.law is not None else float("nan")
    if air := replace(data.card, scores=scores).air_in_words:
        said.append(air)
    judged = judge(last, before, operator, certainty, scores["acts_log_odds"], heat_W_m2)
    card = replace(
        data.card,
        ranges=_ranges(histories),
        scores=scores,
        uncertainty=certainty,
        notes=(*said, *uncertain(certainty)),
        competence=_verdict(judged, data, estimate, unknown.advice),
        hour_effects=tuple((one.time_s, one.error_K, one.effect_K, one.promise_K) for one in hours.seen),
    )
    prove(operator)
    say(f"identified an operator of order {operator.order}")
    return ZoneModel(operator, power, everything.free and everything.free.resampled(step_s), card)


def _hours_that_differ(fold: Fold, operator: OperatorParameters, certainty: Mapping[str, float]) -> HourEffects:
    """The hours of the day in which the records show less of the effect of acting than the operator says."""
    effects = HourEffects(fold.sign)
    if fold.heat_input.u_min < 0.0:
        return effects
    share = certainty["step_response_1h_sd_K"] / max(certainty["step_response_1h_K"], 1e-9)
    for seen in hours_seen(fold, operator, min(share, 1.0)):
        effects = effects.after(seen)
    return effects.believed


def _verdict(judged: Competence, data: ZoneData, estimate: Estimate, advice: str) -> Competence:
    """`judged`, but not competent where there is a stronger reason than its errors.

    Raises:
        DataError: nothing shows that the actuator acts, and it is alone in the building.
    """
    missing = _without_effect(estimate.scores["acts_log_odds"], data)
    if missing and data.alone:
        raise DataError(missing)
    if estimate.unjudged:
        judged = Competence(False, (estimate.unjudged,), plainly=UNJUDGED)
    if missing:
        judged = replace(judged, competent=False, reasons=(missing,), plainly=_ACTS_NOT)
    if data.bars:
        reasons = tuple(f"{remark.kind}: {remark.where}: {remark.words}" for remark in data.bars)
        remedies = tuple(remark.remedy for remark in data.bars)
        return replace(judged, competent=False, reasons=reasons, advice=remedies, plainly=_NO_LEVEL)
    if advice and not judged.competent:
        judged = replace(judged, advice=(advice, *judged.advice))
    return judged


def uncertain(certainty: Mapping[str, float]) -> list[str]:
    """A note that the effect of a day of action is hardly known."""
    share = certainty["step_response_24h_sd_K"] / max(certainty["step_response_24h_K"], 1e-9)
    if share <= _UNCERTAIN:
        return []
    return [f"uncertain: the effect of a day of action is known to ± {100 * share:.0f} % only; probe longer or harder"]


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


def _of_air(fold: Fold) -> dict[str, float]:
    """The scores of a card on steps in which air came in (`network.airing`); none where none did."""
    air_K = np.concatenate([np.zeros(0), *(e.air_K for e in fold.regressions if e.air_K is not None)])
    aired = np.abs(air_K[air_K != 0.0])
    return {AIRED_STEPS: float(aired.size), AIRED_K: float(aired.mean())} if aired.size else {}


def _ranges(histories: Sequence[Record]) -> dict[str, tuple[float, float]]:
    """The smallest and largest value of each signal, and (0, days of data)."""
    out = {}
    for name in ("T_zone_C", "T_out_C", "solar_W_m2", "u"):
        values = np.concatenate([np.atleast_2d(getattr(h, name))[0] for h in histories])
        out[name] = (float(np.nanmin(values)), float(np.nanmax(values)))
    out["days"] = (0.0, sum(h.n_steps * h.step_s for h in histories) / DAY_S)
    return out
