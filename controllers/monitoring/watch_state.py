"""Options of the watch over a model, its state during a run, and the scaled models that it tries."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.model.machine.blocked_hours import BlockedHours, Directions
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import PredictorState
from thermoforce_mpc.model.thermal_model import ZoneModel
from thermoforce_mpc.scenario.settings import StrictModel

GAIN_BOUNDS = (0.3, 3.0)
"""Limits of gain and heat, as factors of the identified ones."""


@dataclass(frozen=True)
class ScaledModel:
    """The `model` in use; its gain and the heat of its machine are `gain` and `heat` times the identified ones."""

    model: ZoneModel
    gain: float = 1.0
    heat: float = 1.0

    @property
    def factors(self) -> tuple[float, float]:
        """All of what `model` differs in from the identified one."""
        return self.gain, self.heat

    @property
    def adapted(self) -> bool:
        """Whether `model` is another than the identified one."""
        return self.factors != (1.0, 1.0)


def scaled(identified: ZoneModel, gain: float, heat: float, n_steps: int) -> ScaledModel | None:
    """The identified model with other factors, within `GAIN_BOUNDS`; None if not certified over `n_steps` steps.

    Where heat is not modelled, `heat` has no effect.
    """
    gain, heat = (float(np.clip(factor, *GAIN_BOUNDS)) for factor in (gain, heat))
    operator = replace(identified.operator, gains=gain * identified.operator.gains)
    law = operator.heat_input.law
    if law is not None:
        # The heat of v = 1 scales with the machine, and the gain per v with it.
        c0, c1, c2, c3 = (heat * c for c in law.coefficients)
        weaker = replace(law, coefficients=(c0, c1, c2, c3))
        operator = replace(operator, heat_input=operator.heat_input.with_law(weaker), gains=operator.gains * heat)
    if not certificate(operator, n_steps).certified:
        return None
    return ScaledModel(replace(identified, operator=operator), gain, heat)


IN_USE = "the model in use"


class WatchConfig(StrictModel):
    """Options of the watch."""

    enabled: bool = Field(
        True,
        description="hand control back while predictions are worse than promised or actuator or machine do not follow",
    )
    # Largest probability of an alarm in 30 days while errors are as promised.
    false_alarm: ClassVar[float] = 0.05
    blocked_hours: bool = Field(
        True, description="plan without hours of the day in which nothing comes, whatever is asked for"
    )
    # Promises of errors below this at 1 h, and √6 times this at 6 h, are not held to, K: the resolution of sensors.
    least_K: ClassVar[float] = 0.1
    # A band counts with at most this many times the median band of the last week: calibration widens it after errors.
    widest: ClassVar[float] = 1.25
    # Heat or power this many times more or less than modelled and than before is a fault.
    machine_factor: ClassVar[float] = 1.35
    # Control returns after predictions were as promised for this long, h: two forecasts of 6 h.
    return_h: ClassVar[float] = 12.0


@dataclass(frozen=True)
class Issued:
    """A prediction recorded at `time_s`: state and inputs of the forced response, and the promise at each lead.

    `operator` at the control step; `forced_K` (r,) K; `features` (n, 4); `median_C`, `below_K`, `above_K` (L,): free
    response and distances to the ends of its 80 % band at the leads.
    """

    time_s: float
    operator: OperatorParameters
    forced_K: Array
    features: Array
    median_C: Array
    below_K: Array
    above_K: Array
    judged: int = 0


class Judged(NamedTuple):
    """A prediction that came due at `time_s`, or arrays (k,) of several.

    Index of its `lead`, error (measured − predicted), promise, and predicted effect of the levels since, all K.
    """

    time_s: Any
    lead: Any
    error_K: Any
    promise_K: Any
    effect_K: Any

    @classmethod
    def of(cls, rows: Array) -> Judged:
        """Those of `Track.judged` (k, 5)."""
        return cls(*rows.T)


_NONE_JUDGED, _NO_BANDS = np.empty((0, len(Judged._fields))), np.empty((0, 0))


@dataclass(frozen=True)
class Track:
    """A model under test: predictions pending and compared (`judged`), and the evidence against it.

    `judged` (k, 5): the fields of `Judged`. `bands` (k, 1 + L) of the last week: time, s, and half-width at each lead,
    K. `evidence` maps (lead, phase, side) to the detector's M. While standing back `adaptation`
    is the model, `predictor` the state of its predictor.
    """

    name: str = IN_USE
    adaptation: ScaledModel | None = None
    predictor: PredictorState | None = None
    pending: tuple[Issued, ...] = ()
    judged: Array = field(default_factory=lambda: _NONE_JUDGED)
    bands: Array = field(default_factory=lambda: _NO_BANDS)
    evidence: dict[tuple[int, int, int], float] = field(default_factory=dict)

    @property
    def worst(self) -> tuple[float, int, int]:
        """Largest evidence against the model, the index of its lead, and the side (+1: warmer than predicted)."""
        if not self.evidence:
            return 0.0, 0, 1
        (lead, _, side), M = max(self.evidence.items(), key=lambda item: item[1])
        return M, lead, side

    def cleared(self) -> Track:
        """This track without evidence."""
        return replace(self, evidence={})


@dataclass(frozen=True)
class WatchState:
    """State of the watch during a run.

    `tracks`: the model in use; while standing back also its candidates for return. `blocked`: hours in which nothing
    comes whatever is asked for, by direction. `asked`: (start s, mean level) that the last plans requested. `ratios`:
    (time s, measured heat or power over modelled). `alarm`: why control was handed back at `since_s`, empty while the
    model is in use; `of_levels`: for levels that were not followed. `wait_h`: shortest time of standing back;
    `returned_s`: last return, and `news` what to say of it in this step's plan.
    """

    tracks: tuple[Track, ...] = (Track(),)
    blocked: Directions = (BlockedHours(),)
    asked: tuple[tuple[float, float], ...] = ()
    ratios: tuple[tuple[float, float], ...] = ()
    alarm: str = ""
    of_levels: bool = False
    since_s: float = -math.inf
    wait_h: float = 0.0
    returned_s: float = -math.inf
    news: str = ""

    def reason(self, time_s: float) -> str:
        """Why control was handed back, and how long before `time_s`."""
        return f"watch: {self.alarm} (found {(time_s - self.since_s) / HOUR_S:.1f} h ago)"
