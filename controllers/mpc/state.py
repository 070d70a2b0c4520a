"""State that an MPC passes from step to step."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from controllers.actuation.actuator import ActuationState
from controllers.monitoring.meters import MeterState
from controllers.monitoring.sun_on_sensors import SunState
from controllers.monitoring.watch import ScaledModel, WatchState
from controllers.monitoring.zone_sensors import SensorState
from controllers.mpc.margins import Margins
from controllers.safety.fallback_policy import GoodPlan
from thermoforce_mpc.data import DAY_S, YEAR_S, Array, Boundary, Names, Observation, Record, month_of
from thermoforce_mpc.model.predictor import PredictorState


@dataclass(frozen=True)
class MPCState:
    """Controller state passed from one plan to the next.

    `first_s`: time of the first plan, s; `peak_W`: highest mean power of the building over a step since, W; `good`:
    last solved plan that was followed; `predictor`: state of the predictor. Of each actuator (A,): `actuation` (state
    of its machine), `adaptation` (None at the start of a run) and `watch` (what the watch knows of its predictions).
    `margins`: what was learned of bounds, predictions and capacities. `sensors` (Z,): what is known of the zone
    sensors, and `sun` of the sun on them; `meters`: of weather sensors and meters. `boundary`: the last forecast of the
    boundary conditions without gaps. `failures`: consecutive failed plans. `ruled`: whether the on/off rule's levels
    acted, since the plan's own statement priced them lower. `tank`: what is set at the tank of hot water, and since
    when, s; None: nothing. `last_s`: time of the last plan, s.
    """

    first_s: float
    peak_W: float = 0.0
    actuation: tuple[ActuationState, ...] = (ActuationState(),)
    good: GoodPlan | None = None
    predictor: PredictorState | None = None
    adaptation: tuple[ScaledModel | None, ...] = (None,)
    watch: tuple[WatchState, ...] = (WatchState(),)
    margins: Margins = field(default_factory=Margins)
    sensors: tuple[SensorState, ...] = (SensorState(),)
    meters: tuple[MeterState, ...] = ()
    sun: SunState = field(default_factory=SunState)
    boundary: Boundary | None = None
    failures: int = 0
    ruled: bool = False
    tank: tuple[float, float] | None = None
    last_s: float | None = None

    @classmethod
    def begin(
        cls, time_s: float, names: Names, watch: tuple[WatchState, ...], meters: tuple[MeterState, ...]
    ) -> MPCState:
        """The state at the begin of a run of a building."""
        actuators, zones = len(names.actuators), len(names.zones)
        return cls(
            time_s,
            adaptation=(None,) * actuators,
            watch=watch,
            margins=Margins.nothing(zones, len(names.machines)),
            sensors=(SensorState(),) * zones,
            meters=meters,
        )

    @property
    def rows(self) -> dict[str, int]:
        """How many zones, actuators and machines it is of."""
        return {"zones": len(self.sensors), "actuators": len(self.actuation), "machines": self.margins.unused.size}

    def without_forced(self) -> MPCState:
        """Without the forced state so far, where what it was estimated from does not hold any more."""
        return self if self.predictor is None else replace(self, predictor=replace(self.predictor, forced=None))

    def not_followed(self) -> MPCState:
        """After a plan that did not act: readings have taught what they did, and the building's own control acted."""
        asked = [(*watch.asked[:-1], (watch.asked[-1][0], math.nan)) if watch.asked else () for watch in self.watch]
        return replace(
            self,
            good=None,
            tank=None,
            actuation=tuple(ActuationState(native=True) for _ in self.actuation),
            watch=tuple(replace(watch, asked=of) for watch, of in zip(self.watch, asked, strict=True)),
        )

    def peak_after(self, observation: Observation, of: str = "run", *, at_the_meter: bool = False) -> float:
        """The peak power with which a higher one is compared, W: mean of the building over a step, see `metered_W`.

        `of`: "run": highest since the first plan; "month": of the calendar month, by the record; "three_days": above
        which today's highest counts among the three highest days of the month.
        """
        history = observation.history
        power_W = metered_W(history, observation.boundary, at_the_meter=at_the_meter)
        if of != "run":
            return _peak_of_month(history, power_W, three_days=of == "three_days")
        if power_W.size and observation.time_s > self.first_s and np.isfinite(power_W[-1]):
            return max(self.peak_W, float(power_W[-1]))
        return self.peak_W


def metered_W(history: Record, boundary: Boundary, *, at_the_meter: bool) -> Array:
    """Mean power of the building over each step (n,), W: what plans that follow are compared with.

    What the meter read where plans count other loads behind it (`at_the_meter`) or there are none; of machines alone
    where plans are, or no meter was read.
    """
    same = at_the_meter or not boundary.others_W.size
    return history.meter_W if same and history.meter_W.size else np.asarray(history.power_W.sum(axis=0))


def highest_of_days_W(history: Record, power_W: Array) -> dict[tuple[int, int], float]:
    """The highest `power_W` (n,) over a step by month and day, W; days without one are left out.

    Numbers of months and days go on from year to year.
    """
    known = np.isfinite(power_W)
    each = _months_and_days(history.time_s[:-1][known], history)
    highest: dict[tuple[int, int], float] = {}
    for month, day in np.unique(each, axis=0).tolist():
        highest[month, day] = float(power_W[known][each[:, 1] == day].max())
    return highest


def _months_and_days(time_s: Array, history: Record) -> NDArray[np.int64]:
    """Month and day of instants `time_s` (n,) of a record (n, 2)."""
    if history.origin is None:  # days of simulated years count from 0
        month, day = 12 * np.floor(time_s / YEAR_S) + month_of(time_s), np.floor(time_s / DAY_S)
    else:
        import pandas as pd  # only here

        from thermoforce_mpc.data.dataframes import stamps

        at = pd.DatetimeIndex(stamps(time_s, history.origin))
        month, day = 12 * np.asarray(at.year) + at.month, 366 * np.asarray(at.year) + at.day_of_year
    return np.stack([month, day], axis=1).astype(np.int64)


def _peak_of_month(history: Record, power_W: Array, *, three_days: bool) -> float:
    """See `MPCState.peak_after`."""
    ((this_month, today),) = _months_and_days(history.time_s[-1:], history).tolist()
    highest = {day: W for (month, day), W in highest_of_days_W(history, power_W).items() if month == this_month}
    if not three_days:
        return max(highest.values(), default=0.0)
    third = sorted(highest.values())[-3] if len(highest) >= 3 else 0.0
    return max(highest.get(today, 0.0), third)
