"""What a rule would do by the model of a plan, and what it would have had of the last day.

A course is stepped forward: each level by what the model predicts until then. Free response, weather, bounds and
machines are the plan's; only the levels differ (paper eq:effect).

Each morning the last day is lived again in hindsight: its free response is what was measured less the forced response
of what acted, so that its weather and people are the day's own, and the on/off rule's levels go in front of the
operator. Power is of the model for both, so that neither meters nor other loads tell them apart; the heat that either
leaves in the slowest mode counts at what it took to make. A day that was dearer and less comfortable than the rule's,
and other than believed, is said. After two such mornings running control stands back for a day; after the next, for
twice as long.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.optimisation.problem import EquipmentLayout, MPCProblem
from controllers.safety.fallback_policy import FallbackPolicy
from thermoforce_mpc.data import DAY_S, HOUR_S, J_PER_KWH, Array, Boundary, Layout, Plan, Record
from thermoforce_mpc.data.dataframes import compose
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import ZONE, feature_matrix

# Levels that a loop at the comfort bound is tried with.
_LEVELS = 21
# A law gives the level of an actuator (its number) in a step (its number) from the temperatures at its start (Z,), °C,
# the forced state (Z, A, r), K, and the levels so far (A, N).
Law = Callable[[int, int, Array, Array, Array], float]


class Courses:
    """Rolls out rules over N steps; `rules` (A,): the on/off rule of each actuator.

    `boundary`: of the steps; `T_now_C` (Z,): temperatures now, °C.
    """

    def __init__(
        self,
        operator: BuildingOperator,
        layout: Layout,
        machinery: EquipmentLayout,
        rules: Sequence[FallbackPolicy],
        boundary: Boundary,
        T_now_C: Array,
        forced_K: Array,
        features: Array,
        T_free_C: Array,
    ) -> None:
        """In free response `T_free_C` (Z, N), with `features` (Z, N, 4) and `forced_K` (Z, A, r): forced state now."""
        self._operator, self._layout, self._machinery = operator, layout, machinery
        self._rules, self._boundary, self._T_now_C = tuple(rules), boundary, T_now_C
        self._forced_K, self._features, self._T_free_C = forced_K, features, T_free_C
        whole = np.ones((1, T_free_C.shape[1]))
        self._u_min, self._u_max = machinery.u_min[:, None] * whole, machinery.u_max[:, None] * whole
        self._capacity: Array | None = None
        self._comes = whole

    @classmethod
    def of_plan(
        cls,
        problem: MPCProblem,
        operator: BuildingOperator,
        layout: Layout,
        rules: Sequence[FallbackPolicy],
        boundary: Boundary,
        T_zone_C: Array,
    ) -> Courses:
        """In the instance of a plan, from the temperatures (Z,), °C, that were read; NaN: what the model has."""
        known_C = problem.features[:, 0, ZONE] + problem.forced_state_K.sum(axis=(1, 2))
        T_now_C = np.where(np.isfinite(T_zone_C), T_zone_C, known_C)
        state, machinery = problem.forced_state_K, problem.machinery
        found = cls(operator, layout, machinery, rules, boundary, T_now_C, state, problem.features, problem.T_free_C)
        found._u_min, found._u_max = problem.level_bounds
        found._capacity = problem.capacity
        if problem.available is not None:
            found._comes = problem.available
        return found

    def limited(self, u: Array, first: int = 0) -> Array:
        """Levels (A, n) within limits, of which no more act together than may, and no machine beyond its capacity.

        `first`: number of the step that they begin with.
        """
        m, steps = self._machinery, slice(first, first + u.shape[1])
        u = np.clip(u, self._u_min[:, steps], self._u_max[:, steps])
        for k in range(u.shape[1] if m.exclusive else 0):
            u[list(self._layout.excluded([float(abs(level)) for level in u[:, k]])), k] = 0.0
        load = m.fed_by @ (m.share[:, None] * np.maximum(u, 0.0))
        if self._capacity is not None:
            load = load / self._capacity[:, steps]
        return np.asarray(u / np.maximum(load, 1.0)[m.machine_of])

    def follow(self, law: Law) -> Array:
        """Levels (A, N) of a law that sees the predicted temperature at the start of each step."""
        n = self._boundary.n_steps
        u = np.zeros((self._machinery.u_max.size, n))
        forced, T_C = self._forced_K, self._T_now_C
        for k in range(n):
            for a in range(u.shape[0]):
                u[a, k] = law(a, k, T_C, forced, u)
            u[:, k : k + 1] = self.limited(u[:, k : k + 1], k)
            forced = self._after(forced, u[:, k : k + 1], k)
            T_C = compose(self._T_free_C[:, k], forced.sum(axis=(1, 2)))
        return u

    def forced(self, u: Array) -> Array:
        """Forced state at the end of each step under levels (A, N), (Z, A, N, r), K."""
        if self._operator.of_actuator(0).feedback_active:
            return self._operator.rollout(self._forced_K, u, self._features)
        return self._operator.driven(self._forced_K, self._operator.drive(u, self._features) * self._comes)

    def _after(self, forced: Array, u: Array, k: int) -> Array:
        """Forced state (..., Z, A, r), K, after step `k` with levels (..., A, 1), of which what comes acts."""
        features = self._features[:, k : k + 1]
        if self._operator.of_actuator(0).feedback_active:
            return self._operator.rollout(forced, u, features)[..., 0, :]
        drive = self._operator.drive(u, features) * self._comes[:, k : k + 1]
        return self._operator.driven(forced, drive)[..., 0, :]

    def rule(self, a: int, k: int, T_C: Array, forced: Array, u: Array) -> float:
        """Level of the on/off rule of the fallback; where loops of the building act, theirs."""
        zone = self._layout.home[a]
        level, _ = self._rules[a].rule_at(float(T_C[zone]), self._boundary, float(self._boundary.time_s[k]))
        return self.loop(a, k, T_C, forced, u) if level is None else level

    def loop(self, a: int, k: int, T_C: Array, forced: Array, u: Array) -> float:
        """The least level that keeps the zone inside its bounds at the end of the step, as a good loop finds it."""
        z, m = self._layout.home[a], self._machinery
        levels = np.linspace(m.u_min[a], m.u_max[a], _LEVELS if m.u_min[a] == 0.0 else 2 * _LEVELS - 1)
        levels = levels[np.argsort(np.abs(levels), kind="stable")]
        tried = np.repeat(u[None, :, k : k + 1], levels.size, axis=0)
        tried[:, a, 0] = levels
        end = self._after(forced, tried, k)[:, z].sum(axis=(1, 2))
        T_end_C = compose(self._T_free_C[z, k], end)
        low, high = self._boundary.lower_C[z, k + 1], self._boundary.upper_C[z, k + 1]
        # A heating loop does not act on the upper bound, nor a cooling loop on the lower.
        mode = self._layout.mode(a)
        below = np.maximum(low - T_end_C, 0.0) if mode != "cooling" else np.zeros(levels.size)
        above = np.maximum(T_end_C - high, 0.0) if mode != "heating" else np.zeros(levels.size)
        outside = np.round(below + above, 6)
        return float(levels[int(np.argmin(outside))])


# Hour of the day at which a day begins and ends: the night's heat belongs to the day before.
_MORNING_H = 6.0
# A day is dearer, less comfortable, and other than believed, from these on: shares of cost, K·h of all zones together.
# Chosen so that no clean day of bestest_air and house:4rooms is claimed (2026-11-28); no bench has chosen between them.
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
