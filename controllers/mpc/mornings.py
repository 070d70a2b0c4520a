"""Each morning: what was believed of the last day, what came, and what the on/off rule would have had.

A day is lived again in hindsight: its free response is what was measured less the forced response of what acted, so
that its weather and people are the day's own, and the rule's levels go in front of the operator (paper eq:effect).
Power is of the model for both, so that neither meters nor other loads tell them apart; the heat that either leaves in
the slowest mode counts at what it took to make. A day that was dearer and less comfortable than the rule's, and other
than believed, is said. After two such mornings running control stands back for a day; after the next, for twice as
long.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.mpc.courses import Courses
from controllers.optimisation.problem import EquipmentLayout
from controllers.safety.fallback_policy import FallbackPolicy
from thermoforce_mpc.data import DAY_S, HOUR_S, J_PER_KWH, Array, Boundary, Layout, Plan, Record
from thermoforce_mpc.data.dataframes import compose
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import feature_matrix

# Hour of the day at which a day begins and ends: the night's heat belongs to the day before.
_MORNING_H = 6.0
# A day is dearer, less comfortable, and other than believed, from these on: shares of cost, K·h of all zones together.
_DEARER, _COLDER_KH, _OTHER_COST = 0.03, 0.3, 0.1
# Such mornings running before control stands back; for how many days, and the most.
_RUNNING, _FIRST_DAYS, _MOST_DAYS = 2, 1, 4


@dataclass(frozen=True)
class DayBelieved:
    """What a plan believed of the day from its time on: `boundary` of the day, cost and K·h outside the bounds."""

    boundary: Boundary
    cost: float
    K_h: float

    @property
    def time_s(self) -> float:
        """When the day began, s."""
        return float(self.boundary.time_s[0])


@dataclass(frozen=True)
class MorningState:
    """State of the comparison: the day `believed` now; `failed` mornings running, days of the last standing back, until
    when control stands back, s, and why; `news` of this step.
    """

    believed: DayBelieved | None = None
    failed: int = 0
    days: int = 0
    until_s: float = -math.inf
    why: str = ""
    news: str = ""

    def stands_back(self, time_s: float) -> str:
        """Why control stands back at `time_s`; '' where it does not."""
        return self.why if time_s < self.until_s - 1.0 else ""


@dataclass(frozen=True)
class _Day:
    """Cost, currency, and K·h outside the bounds, of a day."""

    cost: float
    K_h: float

    def in_words(self) -> str:
        return f"{self.cost:.3g} and {self.K_h:.1f} K·h outside the bounds"


class Mornings:
    """Compares a day with what was believed of it and with the rule's; it holds no state.

    `operator`: the model's; `rules` (A,), `powers` (M,): of its actuators and machines.
    """

    def __init__(
        self,
        operator: BuildingOperator,
        layout: Layout,
        machinery: EquipmentLayout,
        rules: Sequence[FallbackPolicy],
        powers: Sequence[PowerModel],
    ) -> None:
        self._operator, self._layout, self._machinery = operator, layout, machinery
        self._rules, self._powers = tuple(rules), tuple(powers)
        self._n = round(DAY_S / operator.step_s)

    def validate(self, state: MorningState, history: Record, forced_K: Array | None) -> MorningState:
        """The state after the day that ended now, if one was believed; `forced_K` (Z, A, n + 1, r): until now, or None.

        A day in which something else acted, or of which a reading is missing, is not judged.
        """
        believed, now = state.believed, float(history.time_s[-1])
        state = replace(state, news="")
        if believed is None or now < believed.time_s + DAY_S - 1.0:
            return state
        state = replace(state, believed=None)
        if now > believed.time_s + DAY_S + 1.0 or forced_K is None or history.n_steps < self._n:
            return state
        day = history.last(self._n)
        known = (day.u, day.T_zone_C, day.T_out_C, day.solar_W_m2)
        if not all(np.isfinite(values).all() for values in known):
            return state
        came, ruled = self._lived(day, forced_K[:, :, -self._n - 1 :], believed.boundary)
        if not _worse(came, ruled, believed):
            return replace(state, failed=0, days=0 if state.failed == 0 else state.days)
        said = (
            f"the last day cost {came.in_words()}, where {believed.cost:.3g} and {believed.K_h:.1f} were believed; the "
            f"on/off rule would have had {ruled.in_words()} by the same model"
        )
        failed = state.failed + 1
        if failed < _RUNNING:
            return replace(state, failed=failed, news=said)
        days = min(2 * state.days, _MOST_DAYS) if state.days else _FIRST_DAYS
        why = f"{said}, the {failed}. day running: control stands back for {24 * days} h"
        # One such day more after the return is enough.
        return replace(state, failed=_RUNNING - 1, days=days, until_s=now + days * DAY_S, why=why, news=why)

    def believing(self, state: MorningState, plan: Plan, boundary: Boundary) -> MorningState:
        """The state with what `plan` believes of the day that begins now, where one does and it holds all of it."""
        now_h = float(boundary.time_s[0]) % DAY_S / HOUR_S
        if abs(now_h - _MORNING_H) * HOUR_S > 1.0 or plan.u.shape[1] < self._n or boundary.n_steps < self._n:
            return state
        day = boundary.head(self._n)
        K_h = float(np.nansum(day.outside_K(plan.T_zone_C[:, : self._n]))) * day.step_s / HOUR_S
        cost = self._cost(plan.u[:, : self._n], day.T_out_C[:-1], day)
        return replace(state, believed=DayBelieved(day, cost, K_h))

    def _lived(self, day: Record, forced_K: Array, boundary: Boundary) -> tuple[_Day, _Day]:
        """The day as it was and as it would have been under the rule; `forced_K` (Z, A, n + 1, r)."""
        T_free_C = day.T_zone_C - forced_K.sum(axis=(1, 3))
        features = np.stack(
            [feature_matrix(free, day.T_out_C[:-1], day.solar_W_m2[:-1], day.time_s[:-1]) for free in T_free_C[:, :-1]]
        )
        courses = Courses(
            self._operator,
            self._layout,
            self._machinery,
            self._rules,
            boundary,
            day.T_zone_C[:, 0],
            forced_K[:, :, 0],
            features,
            T_free_C[:, 1:],
        )
        u = courses.follow(courses.rule)
        after_K = courses.forced(u)
        levels = np.clip(day.u, self._machinery.u_min[:, None], self._machinery.u_max[:, None])
        more = self._left_over(forced_K[:, :, -1] - after_K[:, :, -1], features[:, -1])
        T_out = day.T_out_C[:-1]
        kept, owed = (
            self._cost(np.maximum(sign * more, 0.0)[:, None], T_out[-1:], boundary, slice(-1, None)) for sign in (1, -1)
        )
        hours = day.step_s / HOUR_S
        came, ruled = (
            _Day(self._cost(of, T_out, boundary), float(np.nansum(boundary.outside_K(T_C))) * hours)
            for of, T_C in ((levels, day.T_zone_C[:, 1:]), (u, compose(T_free_C[:, 1:], after_K.sum(axis=(1, 3)))))
        )
        return replace(came, cost=came.cost - kept + owed), ruled

    def _left_over(self, left_K: Array, features: Array) -> Array:
        """Steps at full level (A,) that made `left_K` (Z, A, r) more, as the slowest mode of each home zone has it."""
        out = np.zeros(len(self._layout.home))
        for a, z in enumerate(self._layout.home):
            pair = self._operator.of_actuator(a)
            slowest = int(np.flatnonzero(pair.acting)[-1])
            per_step = pair.gains[slowest] * float(pair.drive(np.ones(1), features[z : z + 1])[0])
            out[a] = left_K[z, a, slowest] / per_step if per_step else 0.0
        return np.clip(out, -self._n, self._n)

    def _cost(self, u: Array, T_out_C: Array, boundary: Boundary, steps: slice = slice(None)) -> float:
        """What levels (A, n) in `steps` of the day cost, currency; beyond full level in proportion."""
        total, over = 0.0, np.maximum(np.abs(u), 1.0)
        for m, power in enumerate(self._powers):
            fed = self._layout.fed_by(m)
            heating, cooling = boundary.heating_price_per_kWh[m, :-1][steps], boundary.price_per_kWh[m, :-1][steps]
            if len(fed) == 1:
                level, times = u[fed[0]], over[fed[0]]
                power_W, price = power(level / times, T_out_C) * times, np.where(level < 0.0, cooling, heating)
            else:
                weights, times = np.array([self._layout.weights[a] for a in fed]), over[fed].max(axis=0)
                power_W, price = power.of_actuators(np.maximum(u[fed], 0.0) / times, weights, T_out_C) * times, heating
            total += float((power_W * price).sum()) * boundary.step_s / J_PER_KWH
        return total


def _worse(came: _Day, ruled: _Day, believed: DayBelieved) -> bool:
    """Whether a day was dearer and less comfortable than the rule's, and other than it was believed to be."""
    dearer = came.cost - ruled.cost > _DEARER * abs(ruled.cost)
    colder = came.K_h - ruled.K_h > _COLDER_KH
    other = came.K_h - believed.K_h > _COLDER_KH or came.cost - believed.cost > _OTHER_COST * abs(believed.cost)
    return dearer and colder and other
