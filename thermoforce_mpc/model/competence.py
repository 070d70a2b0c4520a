"""Competence of a model: what its own held-out data say of it, and whether that is enough to act on it.

Only the value that travels with the model; `identification.competence` computes it and owns the criteria.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class HorizonScore:
    """Held-out errors at one lead time, RMSE in K, and tests, which count an earlier held-out part as well.

    `hours`: lead time, h. `model_K`: the model; `persistence_K`: the temperature stays as it is; `weather_K`: the same
    model fitted without the actuator. `better_t`: paired t statistic for the model being better than the weather alone,
    over `blocks` blocks of hours (NaN with fewer than 4); `persistence_t`: the same for persistence being better
    than the model.
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
    """Verdict on a model.

    `competent`: whether a controller may act on it. `reasons`: each criterion that it misses, in words. `advice`: what
    to do about them. `horizons`: held-out errors by lead time. `effect_K` and `effect_sd_K`: change of the zone after
    8 h at full level and its standard deviation, K. `sign_probability`: probability that the effect has the sign of
    the mode. `log_odds`: that the actuator acts at all (NaN where an older file does not say). `held_out_h`: held-out
    hours. `plainly`: the first reason in words for the owner of the building; empty where an older file has none.
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
        return f"This model may not act{why}; the building is controlled without it.{to_do}"
