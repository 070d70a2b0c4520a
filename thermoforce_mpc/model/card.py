"""Model card: source, training data and quality of a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from thermoforce_mpc.model.competence import Competence
from thermoforce_mpc.model.machine.foreign_load import ForeignLoad
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor

_GIVEN = "given"
_UNJUDGED = (
    "This model may not act, since it was not judged on data that it had not seen; the building is controlled without "
    "it. Next: identify it again from its data, or turn the gate off (gate.enabled: false) to act on it all the same."
)


@dataclass(frozen=True)
class ModelCard:
    """Source, data and quality of a model, in JSON types.

    `data` maps the name of each record to its SHA-256, `ranges` each signal to the (low, high) of the identification
    data, `scores` and `uncertainty` hold numbers by name, `config` is the configuration of the identification.
    `competence` is the verdict on held-out data; None: not judged (given by hand, or identified before there was one).
    `sun_on_sensor` is the sun in the readings of the zone sensor, which is no warmth of the room; `foreign_heat`
    what the heat meter of the actuator shows beside its heat. None: none was found. `blocked_hours`: hours of the day
    in which nothing came while it was probed, whatever was asked for (`machine.blocked_hours`).
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
    foreign_heat: ForeignLoad | None = None
    blocked_hours: tuple[int, ...] = ()

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
