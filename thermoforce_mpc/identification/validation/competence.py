"""Verdict on an identified model from its held-out data, and the criteria (docs/how-it-works/competence.md).

The model as fitted to the training rows, network included, predicts the held-out rows up to 24 h ahead with known
weather (`errors_ahead`). Whether it predicts better or worse than something simpler is a test, and one held-out part is
short for it: an earlier part, predicted by a fit to what came before that, counts as well.

What an incompetent model misses, in words: for an engineer, for the owner of the building, and what to do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from thermoforce_mpc.data import HOUR_S, NORMAL_95, Array, Record
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.identification.estimation.records import LEAD_REACH
from thermoforce_mpc.identification.estimation.regression import EFFECT_H, STEP_RESPONSE_H
from thermoforce_mpc.identification.network.room import EMITTER, ROOM, RoomNetwork
from thermoforce_mpc.identification.validation.errors_ahead import (
    BLOCK_H,
    LEAST_BLOCKS,
    Fold,
    HeldOutErrors,
    errors_of,
    is_significant,
    quantile,
    standard_errors_saved,
)
from thermoforce_mpc.model.card import JUDGED_H, MOST_ERROR_K, MOST_RELATIVE_SD, Competence, HorizonScore
from thermoforce_mpc.model.machine.load import NEARLY_FULL
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# Most extra hours that are advised: a month; beyond, more of the same data is not the answer.
_MOST_ADVISED_H = 30.0 * 24.0
# Below this share of the t statistic needed, more data are not expected to show an effect. Of words only; by judgement.
_HOPELESS = 0.25
_NO_EFFECT = (
    "more of the same data will not show an effect: check that the zone sensor is in the room that the actuator "
    "serves, that u is the applied level, and that the mode (heating or cooling) is right"
)
_DARK = "the record has no irradiance: name a signal for the sun"
_OFTENER = "measure the zone temperature without long gaps, in steps that divide an hour"
_NEIGHBOURS = (
    "name every actuator that heats or cools this room or its neighbours, and their temperatures: what they do was "
    "taken for the weather or for this actuator"
)
_AREA = "check the floor area and the unit of the heat meter (W, not kW or Wh), and that the meter has no other load"
# Correlation of the errors with the sun from which it is named as their cause. Of words only; by judgement.
_SUN_CORRELATION = 0.5

Kind = Literal["unjudged", "effect", "error", "unchanged", "weather", "no gain", "implausible"]
UNJUDGED = "its record is too short or has too many gaps to check its predictions"
"""Why a model cannot be judged, in words for the owner of the building."""
_PLAINLY: dict[Kind, str] = {
    "unjudged": UNJUDGED,
    "effect": "it does not know well enough what the actuator does to the room",
    "error": "its predictions are too far off",
    "unchanged": "to expect that the temperature stays as it is would be better than its predictions",
    "weather": "the weather alone predicts the room better than it does",
    "no gain": "it predicts the room no better than the weather alone does",
    "implausible": "it promises more than the heat can do",
}


@dataclass(frozen=True)
class Missed:
    """A criterion that is missed: `value` where `need` was needed, of a lead time or after `hours`; its `score`."""

    kind: Kind
    value: float = float("nan")
    need: float = float("nan")
    hours: float = float("nan")
    score: HorizonScore | None = None

    def reason(self) -> str:
        """The criterion for an engineer."""
        value, need, hours, score = self.value, self.need, self.hours, self.score
        if self.kind == "unjudged":
            reach = LEAD_REACH * hours
            return (
                f"{hours:g} h ahead it cannot be judged: no held-out temperature has another {hours:g} to {reach:g} h "
                "before it"
            )
        if self.kind == "effect":
            known = _above(100 * need, 100 * value, 0)
            return f"the effect of {hours:g} h at full level is known to ± {known} % only, need {100 * need:.0f} %"
        if self.kind == "error":
            return f"{hours:g} h ahead it errs by {_above(need, value, 2)} K, need {need:g} K"
        if score is None:  # implausible
            return f"it says {value:.1f} K after {hours:g} h at full level, the heat can do {need:.1f} K at most"
        if self.kind == "no gain":
            return (
                "it is not shown to predict better than the weather alone at any lead time: at best "
                f"{hours:g} h ahead {score.model_K:.2f} K against {score.weather_K:.2f} K, t = {value:.1f}, "
                f"need {need:.1f}"
            )
        beside, K, t = (
            ("an unchanged temperature", score.persistence_K, -score.persistence_t)
            if self.kind == "unchanged"
            else ("the weather alone", score.weather_K, score.better_t)
        )
        return f"{hours:g} h ahead it errs by {score.model_K:.2f} K, {beside} by {K:.2f} K, t = {t:.1f}"


def plainly(missed: Sequence[Missed]) -> str:
    """The first criterion that is missed, in words for the owner of the building; empty where there is none."""
    return _PLAINLY[missed[0].kind] if missed else ""


def advice(missed: Sequence[Missed], errors: dict[float, HeldOutErrors], records: Sequence[Record]) -> tuple[str, ...]:
    """What to do about the criteria that are missed."""
    found: list[str] = []
    longer = 1.0  # factor on the length of the record
    for one in missed:
        if one.kind == "unjudged":
            found.append(_OFTENER)
        elif one.kind == "effect":
            longer = max(longer, (one.value / one.need) ** 2)
            found += [_levels(records), *([_DARK] if _dark(records) else [])]
        elif one.kind == "implausible":
            found.append(_AREA)
        elif one.kind == "no gain" and not one.value >= _HOPELESS * one.need:
            found.append(_NO_EFFECT)
        elif one.kind == "no gain":
            longer = max(longer, (one.need / one.value) ** 2)
        elif one.kind == "weather":
            found.append(_DARK if _dark(records) else _NEIGHBOURS)
        else:
            found.append(_signals(errors[one.hours], records))
    if longer > 1.0 and _NO_EFFECT not in found:
        found.append(_more(sum(r.n_steps * r.step_s for r in records) / HOUR_S, longer))
    return tuple(dict.fromkeys(found))


def _above(most: float, value: float, decimals: int) -> str:
    """A value above `most`, rounded; up where it would read as if it were not."""
    rounded = f"{value:.{decimals}f}"
    return f"{np.ceil(value * 10**decimals) / 10**decimals:.{decimals}f}" if float(rounded) <= most else rounded


def _more(hours: float, factor: float) -> str:
    """Advice on hours: variances fall, and t² rises, with the length of the record."""
    more_h = hours * (factor - 1.0)
    if more_h > _MOST_ADVISED_H:
        return "more of the same data is not enough: excite harder, or add the missing signal"
    return f"probe about {max(6.0, math.ceil(more_h / 6.0) * 6.0):g} hours more"


def _dark(records: Sequence[Record]) -> bool:
    """Whether no record has irradiance."""
    return all(not np.any(r.solar_W_m2) for r in records)


def _levels(records: Sequence[Record]) -> str:
    """Advice on levels."""
    highest = max(float(np.max(r.u[0])) for r in records)
    if highest < NEARLY_FULL:
        return f"the highest level was {highest:.2g}: probe full level too"
    return "hold full level and off for 4 hours or longer at times, as far as comfort allows: the slow part shows then"


def _signals(errors: HeldOutErrors, records: Sequence[Record]) -> str:
    """Advice on signals, from what the errors go with."""
    if _dark(records):
        return _DARK
    if errors.model.size > 2 and np.std(errors.solar) > 0 and np.std(errors.model) > 0:
        together = float(np.corrcoef(errors.model, errors.solar)[0, 1])
        if abs(together) >= _SUN_CORRELATION:
            return (
                "the errors go with the sun: probe over more days with different sun, or measure the irradiance that "
                "reaches the windows"
            )
    return (
        "the zone moves with something that the record does not hold: look for a signal of other heat sources, windows "
        "or a second actuator, and check the zone sensor; a light zone needs shorter and smaller actions"
    )


LEAD_TIMES_H = (1.0, 3.0, 6.0, 12.0, 24.0)
"""Lead times, h: at none may the model be significantly worse than the weather alone, at none beyond the first worse
than it at all, and at one it must be better. Of those of a pre-heating (`JUDGED_H`) and between, at none may it be
significantly worse than an unchanged temperature: a day ahead, that is what a thermostat makes of a room at the same
time of day, whatever acting does (of `bench commands`, seed 300, it refused all rooms)."""
# One-sided probabilities of the tests, by which a model as good as what it is compared with is called worse, or better,
# at one of the five lead times in at most one of 20, or 8, cases (Bonferroni). Of actuators that do nothing, hardly one
# comes to the second (`python -m benchmarks.zones.placebo`): the odds that they act stop them.
WORSE_PROBABILITY, BETTER_PROBABILITY = 0.99, 0.975
# Probing ends early at this relative standard deviation: what the record does not know is then no more than the 0.05
# that a few nodes are not, however long it is.
WELL_KNOWN_SD = 0.07
# Probing goes on beyond the configured days while it is larger than this: a model that may act is still a poor one, and
# another day of probing is cheap beside a season of its plans. With three mild days `house:3rooms:61` cost 0.0799, with
# the seven that this asks for 0.0603 (2026-11-22).
SETTLED_SD = 0.3
# Rooms drawn for what heat can do at most, the share of them that a response may not exceed, so that ten of them
# decide, and the logarithm of a conductance that joins nothing.
_ROOMS, _SHARE, _SEED, _NOTHING = 1000, 0.99, 0, -30.0


def judge(
    last: Fold,
    before: Fold | None,
    operator: OperatorParameters,
    uncertainty: Mapping[str, float],
    log_odds: float,
    heat_W_m2: float,
) -> Competence:
    """Return the verdict on a model.

    Args:
        last: the model fitted to all but the last rows, or to all but some pairs; its errors are those in K.
        before: fitted to a part of these rows, tested on the rest of them; None where there is none.
        operator: what is returned, fitted to all rows. Where its levels are signed, the plant's own loops keep the
            comfort band, so that a wrong prediction costs energy only.
        uncertainty: standard deviations of the final fit, see `identification.estimation.regression`.
        log_odds: that the actuator acts, see `network.estimate.RoomFit.without`.
        heat_W_m2: metered heat of full level per m² of floor, NaN where it is not known.
    """
    from scipy.special import ndtr

    block_h = min(BLOCK_H, last.held_out_h / LEAST_BLOCKS) or BLOCK_H
    errors = errors_of(last, LEAD_TIMES_H, block_h)
    earlier = errors_of(before, LEAD_TIMES_H, block_h, len(last.judged)) if before else {}
    effect, sd = (uncertainty[f"step_response_{EFFECT_H}h{what}_K"] for what in ("", "_sd"))
    verdict = Competence(
        competent=True,
        horizons=tuple(_score(hours, errors[hours], earlier.get(hours), block_h) for hours in LEAD_TIMES_H),
        effect_K=operator.sign * effect,
        effect_sd_K=sd,
        sign_probability=float(ndtr(effect / sd)) if sd > 0 else 1.0,
        log_odds=log_odds,
        held_out_h=last.held_out_h,
    )
    most_error_K = dict.fromkeys(JUDGED_H, math.inf) if operator.heat_input.u_min < 0.0 else MOST_ERROR_K
    missed = [*missed_criteria(verdict, most_error_K, block_h), *_implausible(operator, heat_W_m2, uncertainty)]
    return replace(
        verdict,
        competent=not missed,
        reasons=tuple(one.reason() for one in missed),
        advice=advice(missed, errors, [last.regressions[i].histories[0] for i in last.judged]),
        plainly=plainly(missed),
    )


def lacking(verdict: Competence | None) -> str:
    """What is lacking to end probing, in words; empty where competent with the effect known to 30 %, or not judged."""
    if verdict is None or (verdict.competent and verdict.relative_sd <= SETTLED_SD):
        return ""
    if not verdict.competent:
        return verdict.in_words()
    return f"the effect is known to ± {100 * verdict.relative_sd:.0f} % only, need {100 * SETTLED_SD:.0f} %"


def is_well_known(verdict: Competence | None) -> bool:
    """Return whether probing may end before the configured days are over."""
    return verdict is not None and verdict.competent and verdict.relative_sd <= WELL_KNOWN_SD


def _score(hours: float, errors: HeldOutErrors, before: HeldOutErrors | None, block_h: float) -> HorizonScore:
    """RMSE of the errors; tests of these and of those `before` together."""
    both = errors if before is None else HeldOutErrors.joined([errors, before])
    better_t, blocks, still_t = float("nan"), 0, float("nan")
    if both.model.size:
        overlap = _overlap(hours, block_h)
        better_t, blocks = standard_errors_saved(both.weather, both.model, both.blocks, overlap)
        still_t = standard_errors_saved(both.model, both.persistence, both.blocks, overlap)[0]
    return HorizonScore(
        hours, rms(errors.model), rms(errors.persistence), rms(errors.weather), better_t, blocks, still_t
    )


def _overlap(hours: float, block_h: float) -> int:
    """How many blocks before it a block of predictions `hours` ahead shares its weather with."""
    return int(hours / block_h + 1e-9)


def missed_criteria(verdict: Competence, most_error_K: Mapping[float, float], block_h: float) -> list[Missed]:
    """Return the criteria that the errors and the certainty of the effect miss."""
    missed = []
    judged = [score for score in verdict.horizons if np.isfinite(score.model_K)]
    for score in verdict.horizons:
        if score.hours in JUDGED_H and score not in judged:
            missed.append(Missed("unjudged", hours=score.hours))
    if not verdict.relative_sd <= MOST_RELATIVE_SD:
        missed.append(Missed("effect", verdict.relative_sd, MOST_RELATIVE_SD, EFFECT_H))
    for score in judged:
        if not score.model_K <= most_error_K.get(score.hours, math.inf):
            missed.append(Missed("error", score.model_K, most_error_K[score.hours], score.hours))
    for score in judged:
        overlap = _overlap(score.hours, block_h)
        simpler: dict[Kind, tuple[float, float]] = {
            "weather": (score.weather_K, -score.better_t),
            "unchanged": (score.persistence_K, score.persistence_t),
        }
        for kind, (error_K, worse_t) in simpler.items():
            if kind == "unchanged" and score.hours > max(JUDGED_H):
                continue
            surely = is_significant(worse_t, score.blocks, WORSE_PROBABILITY, overlap)
            # Plans reach beyond the first lead time: there larger errors of the last part, and in the mean block of
            # both parts, are enough.
            at_all = kind == "weather" and score.hours > LEAD_TIMES_H[0] and worse_t > 0.0
            if score.model_K > error_K and (surely or at_all):
                missed.append(Missed(kind, hours=score.hours, score=score))
    needs = [quantile(score.blocks, BETTER_PROBABILITY, _overlap(score.hours, block_h)) for score in judged]
    shares = [np.nan_to_num(score.better_t) / need for score, need in zip(judged, needs, strict=True)]
    if judged and not max(shares) > 1.0:
        best = int(np.argmax(shares))
        missed.append(Missed("no gain", judged[best].better_t, needs[best], judged[best].hours, judged[best]))
    return missed


def _implausible(operator: OperatorParameters, heat_W_m2: float, uncertainty: Mapping[str, float]) -> list[Missed]:
    """The first time at which a step to full level, in weather as it was, surely does more than its heat can do.

    Surely, with 95 %: a room near what is possible is estimated beyond it as often as not. Signed levels are those of
    room set-points, whose full one is no machine's: nothing bounds its heat.
    """
    if operator.heat_input.u_min < 0.0:
        return []
    most = most_K(STEP_RESPONSE_H, heat_W_m2)
    steps = np.maximum(np.array(STEP_RESPONSE_H) * HOUR_S // operator.step_s, 1).astype(int)
    typical = float(operator.modulation(operator.feature_mean))
    response = typical * np.abs(operator.step_response(int(steps[-1])))[steps - 1]
    sd_K = np.array([uncertainty[f"step_response_{hours}h_sd_K"] for hours in STEP_RESPONSE_H])
    over = np.flatnonzero(response - NORMAL_95 * sd_K > most)
    if not over.size:
        return []
    first = int(over[0])
    return [Missed("implausible", float(response[first]), float(most[first]), float(STEP_RESPONSE_H[first]))]


def most_K(hours: Sequence[float], heat_W_m2: float) -> Array:
    """The step response to full level, K at `hours` (T,), that 1 in 100 rooms exceeds; its size if cooled.

    Rooms are drawn from the priors of the network (`network.priors`). Heat enters the air at once here, which is the
    most it can do. `heat_W_m2`: heat of full level per m² of floor; NaN, where not metered: as the priors have it.
    """
    return np.array(_most_K(tuple(hours), round(heat_W_m2, 1) if np.isfinite(heat_W_m2) else None))


@lru_cache(maxsize=64)
def _most_K(hours: tuple[float, ...], heat_W_m2: float | None) -> tuple[float, ...]:
    room = RoomNetwork((1,), (float("nan") if heat_W_m2 is None else heat_W_m2,))
    draws = room.mean + room.sd * np.random.default_rng(_SEED).normal(size=(_ROOMS, room.mean.size))
    draws[:, room.place["H_emitter_0"]] = _NOTHING
    F = np.array([room.equations(theta).matrix[:EMITTER, :EMITTER] for theta in draws])
    heat = np.array([room.value(theta, "heat_0") / room.value(theta, "C_room") for theta in draws])
    rates, modes = np.linalg.eig(F)
    entering = np.linalg.inv(modes)[:, :, ROOM] * heat[:, None]
    rising = np.expm1(rates[:, None] * np.asarray(hours)[:, None]) / rates[:, None]
    responses = np.einsum("nm,nhm,nm->nh", modes[:, ROOM], rising, entering).real
    return tuple(np.quantile(responses, _SHARE, axis=0).tolist())
