"""Houses drawn by what a model does not know of one, and what they say of the saving of a plan.

The first house of a draw is the likeliest one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermoforce_mpc.data import HOUR_S, NORMAL_95, Array, steps_in
from thermoforce_mpc.data.series import first_order
from thermoforce_mpc.model.card import JUDGED_H, MOST_ERROR_K, ModelCard
from thermoforce_mpc.model.machine.change import COMPARED_H

# How long an error of the free part lasts, h: weather, sun and people of a day. By judgement: the band of a plan of
# house 9508 by set-points (`bench commands`, 2026-11-29) is 37 % of the cost wide at 0, 42 at 3, 44 at 12, 46 at 48 h.
_LASTS_H = 12.0
_QUANTILES = (0.05, 0.95)


def standard(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Standard normal numbers of `shape`, of which the first are nought."""
    z = rng.standard_normal(shape)
    z[0] = 0.0
    return z


def lasting(shape: tuple[int, ...], step_s: float, rng: np.random.Generator) -> Array:
    """Standard normal numbers (S, Z, n) that go on from step to step, of which the first are nought."""
    (S, Z, n), stays = shape, float(np.exp(-step_s / (_LASTS_H * HOUR_S)))
    drawn = standard((S, Z * (n + 1)), rng).reshape(S * Z, n + 1)
    moved = np.sqrt(1.0 - stays**2) * drawn[:, 1:]
    return first_order(np.array([stays]), moved[..., None], drawn[:, :1])[..., 0].reshape(S, Z, n)


def errors_K(card: ModelCard) -> tuple[float, ...]:
    """Errors of predictions at the lead times that are judged, K; where none is known, the most that are allowed."""
    scores = () if card.competence is None else card.competence.horizons
    known = {score.hours: score.model_K for score in scores if np.isfinite(score.model_K)}
    return tuple(known.get(hours, MOST_ERROR_K[hours]) for hours in JUDGED_H)


def free_errors_K(cards: Sequence[ModelCard], home: Sequence[int], n_zones: int, time_s: Array) -> Array:
    """Errors of the free part of `n_zones` at the ends of the steps of `time_s` (N + 1,), s: (Z, N), K.

    `home` (A,): the zone of each of `cards` (A,), of which the largest counts.
    """
    of_zone = np.zeros((n_zones, len(JUDGED_H)))
    for z, card in zip(home, cards, strict=True):
        of_zone[z] = np.maximum(of_zone[z], errors_K(card))
    ends_h = (time_s[1:] - time_s[0]) / HOUR_S
    return np.stack([np.interp(ends_h, (0.0, *JUDGED_H), (0.0, *row)) for row in of_zone])


def more_and_less(change: Array, step_s: float) -> tuple[float, float]:
    """What is used more and what is used less of a `change` (N,), summed over parts in which loops answer.

    They are at other levels and other hours, so that each errs by itself.
    """
    of_parts = np.add.reduceat(change, np.arange(0, change.size, steps_in(COMPARED_H * HOUR_S, step_s)))
    return float(np.maximum(of_parts, 0.0).sum()), float(np.maximum(-of_parts, 0.0).sum())


def expected_saving(saved: Array, prior: float, sure: float = 0.0) -> tuple[float, float, float]:
    """What is expected of the best plan, and its 90 % band, low and high, from what drawn houses save (S,), currency.

    A plan is the best of many by a model that errs, so that less comes true than that says, the more it errs (Smith and
    Winkler 2006): `prior`: standard deviation of what plans save at all around what is `sure`. The draws tell how wide,
    not where: levels that end at 0 and 1 shift them all to one side of the likeliest house, and what came true lay on
    the other (`bench commands`, houses 9502 and 9501, 2026-11-28).
    """
    away = np.quantile(saved[1:], _QUANTILES) - np.median(saved[1:])
    error = float(away[1] - away[0]) / (2.0 * NORMAL_95)
    kept = prior**2 / max(prior**2 + error**2, 1e-12)
    expected = sure + kept * (float(saved[0]) - sure)
    low, high = (expected + float(np.sqrt(kept)) * float(one) for one in away)
    return expected, min(low, expected), max(high, expected)
