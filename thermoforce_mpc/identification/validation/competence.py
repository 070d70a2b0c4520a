"""Verdict on an identified model from its held-out data, and the criteria (docs/how-it-works/competence.md).

The model as fitted to the training rows, network included, predicts the held-out rows up to 24 h ahead with known
weather (`errors_ahead`). Whether it predicts better or worse than something simpler is a test, and one held-out part is
short for it: an earlier part, predicted by a fit to what came before that, counts as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.estimation.modes import EFFECT_H, STEP_RESPONSE_H
from thermoforce_mpc.identification.network.room import EMITTER, ROOM, RoomNetwork
from thermoforce_mpc.identification.validation.blocks import (
    BLOCK_H,
    LEAST_BLOCKS,
    is_significant,
    quantile,
    standard_errors_saved,
)
from thermoforce_mpc.identification.validation.errors_ahead import Fold, HeldOutErrors, errors_of
from thermoforce_mpc.identification.validation.reasons import Kind, Missed, advice, plainly
from thermoforce_mpc.model.card import JUDGED_H, MOST_ERROR_K, MOST_RELATIVE_SD, Competence, HorizonScore
from thermoforce_mpc.model.operator.parameters import OperatorParameters

LEAD_TIMES_H = (1.0, 3.0, 6.0, 12.0, 24.0)
"""Lead times, h: at none may the model be significantly worse than the weather alone or an unchanged temperature, at
none beyond the first worse than the weather alone at all, and at one it must be better than the weather alone."""
# One-sided probabilities of the tests, by which a model as good as what it is compared with is called worse, or better,
# at one of the five lead times in at most one of 20, or 8, cases (Bonferroni). Of actuators that do nothing, hardly one
# comes to the second (`python -m benchmarks.zones.placebo`): the odds that they act stop them.
WORSE_PROBABILITY, BETTER_PROBABILITY = 0.99, 0.975
# Probing ends early at this relative standard deviation: what the record does not know is then no more than the 0.05
# that a few nodes are not, however long it is.
WELL_KNOWN_SD = 0.07
# Probing goes on beyond the configured days while it is larger than this: a model that may act is still a poor
# one, and another day of probing is cheap beside a season of its plans.
SETTLED_SD = 0.3
# Rooms drawn for what heat can do at most, the share of them that a response may not exceed, and the logarithm of a
# conductance that joins nothing.
_ROOMS, _SHARE, _SEED, _NOTHING = 1000, 0.99, 0, -30.0


def judge(
    last: Fold,
    before: Fold | None,
    operator: OperatorParameters,
    uncertainty: Mapping[str, float],
    log_odds: float,
    heat_W_m2: float = float("nan"),
) -> Competence:
    """Return the verdict on a model.

    Args:
        last: the model fitted to all but the last rows, or to all but some pairs; its errors are those in K.
        before: fitted to a part of these rows, tested on the rest of them; None where there is none.
        operator: what is returned, fitted to all rows. Where its levels are signed, the plant's own loops keep the
            comfort band, so that a wrong prediction costs energy only.
        uncertainty: standard deviations of the final fit, see `identification.estimation.modes`.
        log_odds: that the actuator acts, see `network.estimate.RoomFit.without`.
        heat_W_m2: metered heat of full level per m² of floor, NaN where it is not known.
    """
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
    most_error_K = dict.fromkeys(JUDGED_H, math.inf) if operator.heat_input.lowest < 0.0 else MOST_ERROR_K
    missed = [*missed_criteria(verdict, most_error_K, block_h), *_implausible(operator, heat_W_m2)]
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

    def rmse(values: Array) -> float:
        return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")

    both = errors if before is None else HeldOutErrors.joined([errors, before])
    better_t, blocks, still_t = float("nan"), 0, float("nan")
    if both.model.size:
        overlap = _overlap(hours, block_h)
        better_t, blocks = standard_errors_saved(both.weather, both.model, both.blocks, overlap)
        still_t = standard_errors_saved(both.model, both.persistence, both.blocks, overlap)[0]
    return HorizonScore(
        hours, rmse(errors.model), rmse(errors.persistence), rmse(errors.weather), better_t, blocks, still_t
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


def _implausible(operator: OperatorParameters, heat_W_m2: float) -> list[Missed]:
    """The first time at which a step to full level, in weather as it was, does more than its heat can do.

    Signed levels are those of room set-points, whose full one is no machine's: nothing bounds its heat.
    """
    if operator.heat_input.lowest < 0.0:
        return []
    most = most_K(STEP_RESPONSE_H, heat_W_m2)
    steps = np.maximum(np.array(STEP_RESPONSE_H) * HOUR_S // operator.step_s, 1).astype(int)
    typical = float(operator.modulation(operator.feature_mean))
    response = typical * np.abs(np.cumsum(operator.impulse(int(steps[-1]))))[steps - 1]
    over = np.flatnonzero(response > most)
    if not over.size:
        return []
    first = int(over[0])
    return [Missed("implausible", float(response[first]), float(most[first]), float(STEP_RESPONSE_H[first]))]


def most_K(hours: Sequence[float], heat_W_m2: float = float("nan")) -> Array:
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
