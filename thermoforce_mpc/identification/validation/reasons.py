"""What an incompetent model misses, in words: for an engineer, for the owner of the building, and what to do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from thermoforce_mpc.data import HOUR_S, Record
from thermoforce_mpc.identification.estimation.records import LEAD_REACH
from thermoforce_mpc.identification.validation.errors_ahead import HeldOutErrors
from thermoforce_mpc.model.card import HorizonScore

# Most extra hours that are advised; beyond, more of the same data is not the answer.
_MOST_ADVISED_H = 30.0 * 24.0
# Below this share of the t statistic needed, more data are not expected to show an effect.
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
# Level from which full actuation counts as seen.
_NEARLY_FULL = 0.9
# Correlation of the errors with the sun from which it is named as their cause.
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
    if highest < _NEARLY_FULL:
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
