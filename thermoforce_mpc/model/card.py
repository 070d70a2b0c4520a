"""Model card: source, training data and quality of a model, and the verdict on it by data that it had not seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.late_sensor import LateSensor
from thermoforce_mpc.model.machine.blocked_hours import HourEffects, HourSeen
from thermoforce_mpc.model.machine.other_load import OtherLoad
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor

_GIVEN = "given"
_UNJUDGED = (
    "This model may not act, since it was not judged on data that it had not seen. Next: identify it again from its "
    "data, or turn the gate off (gate.enabled: false) to act on it all the same."
)

# Lead times that must be judged: a plan is made anew every step and pre-heats by hours.
JUDGED_H = (1.0, 6.0)
# Farther than this from what is predicted, or outside its comfort band, a zone is not left to the plan, K: several
# times what plans miss (0.3 K at most is kept for that); categories I and II of EN 16798-1 are as far apart. No bench
# chose it.
FAR_K = 1.0
# Largest RMSE by lead time, K: a plan that errs by more within the hours of a pre-heating is not the one that decides.
# One hour ahead half of it must hold.
MOST_ERROR_K = {JUDGED_H[0]: 0.5 * FAR_K, JUDGED_H[1]: FAR_K}
# Largest relative standard deviation of the effect of eight hours at full level, the length of a pre-heating; plans of
# later steps correct what comes later. At 0.43 the sign is certain to 99 %; at 0.4 the 90 % interval is a third to five
# thirds of what was planned, which re-planning still corrects.
MOST_RELATIVE_SD = 0.4
# Relative standard deviation of the effect of a day on another zone from which a record does not tell it. By judgement.
UNTOLD_SD = 0.5
AIRED_STEPS, AIRED_K = "aired_steps", "aired_K"
"""What a card's `scores` call the number of steps in which air came into the zone, and the mean of what it took, K."""
TOGETHER_SD = "together_24h_relative_sd"
"""What a card's `uncertainty` calls the relative standard deviation of what a day of all actuators does to its zone."""


@dataclass(frozen=True)
class HorizonScore:
    """Held-out errors at lead time `hours`, RMSE in K, and tests, which count an earlier held-out part as well.

    `persistence_K`: the temperature stays as it is; `weather_K`: the same model fitted without the actuator.
    `better_t`: paired t statistic for the model being better than the weather alone, over `blocks` blocks of hours (NaN
    with fewer than 4); `persistence_t`: the same for persistence being better than the model.
    """

    hours: float
    model_K: float
    persistence_K: float
    weather_K: float
    better_t: float
    blocks: int
    persistence_t: float = float("nan")


@dataclass(frozen=True)
class Competence:
    """Verdict on a model; `identification.validation.competence` computes it and owns the criteria.

    `competent`: whether a controller may act on it. `reasons`: each criterion that it misses, in words. `advice`: what
    to do about them. `effect_K` and `effect_sd_K`: change of the zone after 8 h at full level and its standard
    deviation, K. `sign_probability`: that the effect has the sign of the mode. `log_odds`: that the actuator acts at
    all (NaN where an older file does not say). `held_out_h`: held-out hours. `plainly`: the first reason in words for
    the owner of the building; empty where an older file has none.
    """

    competent: bool
    reasons: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    horizons: tuple[HorizonScore, ...] = ()
    effect_K: float = float("nan")
    effect_sd_K: float = float("nan")
    sign_probability: float = float("nan")
    log_odds: float = float("nan")
    held_out_h: float = float("nan")
    plainly: str = ""

    @property
    def relative_sd(self) -> float:
        """Standard deviation of the effect of 8 h at full level, as a share of it."""
        return self.effect_sd_K / abs(self.effect_K) if self.effect_K else float("inf")

    def contradiction(self, *, by_loops: bool) -> str:
        """Why this verdict cannot follow from its own numbers, or ''.

        `by_loops`: levels are signed, so that the plant's own loops keep the band whatever is predicted.
        """
        if not self.competent:
            return ""
        if self.reasons:
            return f"it is competent and is not, since {self.reasons[0]}"
        if not self.relative_sd <= MOST_RELATIVE_SD:
            return f"its effect is known to ± {100 * self.relative_sd:.0f} % only"
        errors_K = {score.hours: score.model_K for score in self.horizons}
        for hours in JUDGED_H:
            error_K, most_K = errors_K.get(hours, math.nan), math.inf if by_loops else MOST_ERROR_K[hours]
            if not error_K <= most_K:
                return f"its error {hours:g} h ahead is {error_K:.3g} K"
        return ""

    def in_words(self) -> str:
        """One line for an engineer: the verdict, and what it rests on."""
        if self.competent:
            return f"competent: the effect of 8 h at full level is known to ± {100 * self.relative_sd:.0f} %"
        return f"not competent: {'; '.join(self.reasons)}"

    def sentence(self) -> str:
        """For the owner of the building: whether the model may act, why not, and what to do next."""
        if self.competent:
            return (
                "This model may act: its predictions held on data that it had not seen, and what full level does in "
                f"8 h is known to ± {100 * self.relative_sd:.0f} %."
            )
        why = f", since {self.plainly}" if self.plainly else ""
        to_do = f" Next: {self.advice[0]}." if self.advice else ""
        return f"This model may not act{why}.{to_do}"


@dataclass(frozen=True)
class ModelCard:
    """Source, data and quality of a model, in JSON types.

    `data` maps the name of each record to its SHA-256, `ranges` each signal to the (low, high) of the identification
    data. `competence` is the verdict on held-out data; None: not judged (given by hand, or identified before there was
    one). `sun_on_sensor` is the sun in the readings of the zone sensor, `late_sensor` how late it reads, `foreign_heat`
    what the heat meter of the actuator shows beside its heat; None: none was found. `blocked_hours`: hours of the day
    in which nothing came while it was probed, whatever was asked for (`machine.blocked_hours`), of signed levels no
    heat; `blocked_cooling_hours`: of signed levels no cold. `hour_effects`: what predictions an hour ahead tell of
    hours of the day in which less of the effect of acting came (`machine.blocked_hours.HourSeen`): time, s, error,
    effect and promise, K.
    """

    source: str = _GIVEN
    data: Mapping[str, str] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    scores: Mapping[str, float] = field(default_factory=dict)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    competence: Competence | None = None
    sun_on_sensor: SunOnSensor | None = None
    late_sensor: LateSensor | None = None
    foreign_heat: OtherLoad | None = None
    blocked_hours: tuple[int, ...] = ()
    blocked_cooling_hours: tuple[int, ...] = ()
    hour_effects: tuple[tuple[float, float, float, float], ...] = ()

    def __post_init__(self) -> None:
        """Raise `DataError` for hours that are none of a day, ranges without ends, effects that cannot be judged."""
        hours = (*self.blocked_hours, *self.blocked_cooling_hours)
        if wrong := [hour for hour in hours if not 0 <= hour < 24]:
            raise DataError(f"blocked hours: {wrong[0]} is no hour of the day, 0 to 23")
        if away := [name for name, (low, high) in self.ranges.items() if not low <= high]:
            raise DataError(f"ranges: {away[0]}: {self.ranges[away[0]]}, expected the least and the largest value")
        HourEffects(seen=tuple(HourSeen(*one) for one in self.hour_effects))

    @property
    def air_in_words(self) -> str:
        """Steps in which air came into the zone, and what is made of them; '' where none did."""
        steps = self.scores.get(AIRED_STEPS, 0.0)
        if not steps:
            return ""
        return (
            f"in {steps:.0f} step{'s' * (steps != 1.0)} air came in, as through a window, and moved the room by "
            f"{self.scores[AIRED_K]:.1f} K in the mean: that counts as no effect of anything else "
            "(identification.options.air_through_windows)"
        )

    @property
    def together_sd(self) -> float:
        """Relative standard deviation of what all actuators do to the zone in a day; infinite where not said."""
        return self.uncertainty.get(TOGETHER_SD, math.inf)

    @property
    def only_not_apart(self) -> bool:
        """Whether the model may not act for no other reason than that the effect of its own actuator is not known."""
        verdict = self.competence
        return verdict is not None and len(verdict.reasons) == 1 and not verdict.relative_sd <= MOST_RELATIVE_SD

    @property
    def unfit(self) -> str:
        """Why a controller may not act on the model, in words; empty where it may.

        A model that was identified but not judged may not; one that was given by hand is its author's affair.
        """
        if self.competence is None:
            return "" if self.source == _GIVEN else _UNJUDGED
        if self.competence.competent:
            return ""
        return f"{self.competence.sentence()} ({'; '.join(self.competence.reasons)})"
