"""What levels alone do not say of an actuator's heat, and how much of its effect on its zone may be its neighbours'.

Rooms of one house are heated when it is cold, all of them. What their levels share cannot be attributed: an effect of a
neighbour that the fit gives to the own actuator biases it by that effect times the neighbour's level per own level (the
formula of the omitted variable). The fit's covariance holds this where it is right about the heat of each level; where
heat is not measured it is not, since circuits of one machine take from each other.

Levels count as the fit sees them: it takes what lasts for a disturbance, so that days in which all rooms are heated
more say little, and the hours at which each valve opens say much (generalised least squares).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Layout, Record, steps_in
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.couplings import others_of
from thermoforce_mpc.identification.effects.level_laws import (
    OUTDOORS,
    Estimates,
    levels_only,
    outdoors_in_words,
    weather_of,
)
from thermoforce_mpc.identification.estimation.regression import DISTURBANCE_H, EFFECT_H
from thermoforce_mpc.model.machine.load import LEVEL_EDGE
from thermoforce_mpc.model.operator.heat_input import HeatInput

# What of a neighbour's effect on a zone the fit may give to the zone's own actuator, as a share of what that one does,
# times the number of zones over which heat spreads: how wrong effects between rooms are. 68 % of those of 21 drawn
# houses of 3 to 5 rooms (seeds 64, 777, 8101, 8102, 28 November 2026) are within 0.31 of it after 8 h, 0.63 after 24 h
# and 0.78 after 48 h.
_THEIRS = 0.55
# From this relative standard deviation of the effect on, a neighbour is named. Of words only; by judgement.
_NAMED = 0.1
# Time constant of disturbances by which levels are whitened, h; 1 and 24 give the same within 0.02.
_FADES_H = DISTURBANCE_H[1]
# What six hours at full level give more or less than the law of metered heat says, over what windows of the record do:
# 2.1 in the 8 of 15 generated houses with a heat meter whose heat falls.
_HELD = 2.0
# From this relative standard deviation on it is noted. Of words only; by judgement.
_NOTED = 0.05
# Relative standard deviation of the heat of full level where nothing near it was seen and no heat metered: what a level
# gives may sag, or be switched by a machine that cycles. By judgement.
_UNSEEN_LEVEL_SD = 0.6


class Unknown(NamedTuple):
    """Relative standard deviations by what levels do not say: of the effect on the own zone, and of the heat alone,
    which other zones get too; notes on it, and advice.
    """

    sd: float = 0.0
    heat_sd: float = 0.0
    notes: Sequence[str] = ()
    advice: str = ""


def unknown_heat(
    runs: Sequence[Record], layout: Layout, a: int, heat_input: HeatInput, laws: Estimates, config: IdentificationConfig
) -> Unknown:
    """What is unknown of the heat of actuator `a`: less where it is measured, nothing where the level is the heat."""
    if not levels_only(heat_input, layout, a, config):
        sd = _held_sd(runs, layout, a, heat_input)
        note = f"heat of full level differs by ± {100 * sd:.0f} % with how long it is held"
        return Unknown(sd, 0.0, [note] if sd > _NOTED else [])
    neighbours_sd, advice = confounding(runs, layout, a, config)
    unknown, notes = [shared_sd(layout, a)], [advice] if advice else []
    weather = weather_of(runs, a)
    if weather is not None and OUTDOORS in laws:
        unknown.append(laws[OUTDOORS][1] * weather.spread_K)
        notes.insert(0, outdoors_in_words(laws, weather))
    highest = max((float(np.max(run.u[a])) for run in runs), default=1.0)
    unknown.append(_UNSEEN_LEVEL_SD * max(1.0 - highest, 0.0))
    heat_sd = float(np.linalg.norm(unknown))
    return Unknown(float(np.hypot(heat_sd, neighbours_sd)), heat_sd, notes, advice)


def _held_sd(runs: Sequence[Record], layout: Layout, a: int, heat_input: HeatInput) -> float:
    """Relative standard deviation of the metered heat of a level that is held, of a machine that feeds nothing else.

    Heat falls as water and emitter warm: a law by the level is right in the mean of its record, where levels are held
    for minutes to hours.
    """
    law = heat_input.law
    if law is None or len(layout.fed_by(layout.machine_of[a])) > 1:
        return 0.0
    squares = total = 0.0
    for run in runs:
        n = steps_in(EFFECT_H * HOUR_S, run.step_s)
        if run.n_steps < n:
            continue
        u, heat_W = run.u[a], layout.signs[a] * run.heat_W[a]
        on = (u > LEVEL_EDGE) & np.isfinite(heat_W)
        courses = heat_W, law(u, run.T_out_C[:-1])
        metered, expected = (np.convolve(np.where(on, W, 0.0), np.ones(n), "valid") for W in courses)
        acted = expected > 0.0
        squares += float(np.sum((metered - expected)[acted] ** 2 / expected[acted]))
        total += float(expected[acted].sum())
    return _HELD * float(np.sqrt(squares / total)) if total > 0.0 else 0.0


def confounding(runs: Sequence[Record], layout: Layout, a: int, config: IdentificationConfig) -> tuple[float, str]:
    """What the neighbours of actuator `a` may have done to its zone, as a share of its effect.

    And advice that names those that cause most of it.
    """
    home = layout.home[a]
    neighbours = [b for b in others_of(layout, a, config) if layout.home[b] != home]
    if not runs or not neighbours:
        return 0.0, ""
    own, *others = (np.concatenate([_whitened(run.u[b], run.step_s) for run in runs]) for b in (a, *neighbours))
    power = float(own @ own)
    if not power > 0.0:
        return 0.0, ""
    theirs = _THEIRS / len(layout.floor_area_m2)
    shares = [theirs * max(float(own @ level) / power, 0.0) for level in others]
    named = [layout.names.actuators[b] for b, share in zip(neighbours, shares, strict=True) if share > _NAMED]
    together = float(sum(shares))  # they are heated for one reason
    advice = (
        f"levels went together with those of {', '.join(named)}: ± {100 * together:.0f} % of the effect may be theirs: "
        "set them at different times"
    )
    return together, advice if named else ""


def shared_sd(layout: Layout, a: int) -> float:
    """Relative standard deviation of the heat of a level of actuator `a`, whose machine cannot serve all at once.

    With all at full level it is the reciprocal of their shares' sum, alone it is 1; anything between is as likely. A
    share that is not known (0) counts as the whole machine.
    """
    share_sum = float(layout.weights[layout.fed_by(layout.machine_of[a])].sum())
    return (1.0 - 1.0 / share_sum) / float(np.sqrt(12.0)) if share_sum > 1.0 else 0.0


def _whitened(u: Array, step_s: float) -> Array:
    """Levels (n,) less what they were before, which fades with a disturbance, and without their mean (n − 1,)."""
    changes = u[1:] - np.exp(-step_s / HOUR_S / _FADES_H) * u[:-1]
    return np.asarray(changes - changes.mean()) if changes.size else changes
