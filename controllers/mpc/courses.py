"""What a rule would do by the model of a plan.

A course is stepped forward: each level by what the model predicts until then. Free response, weather, bounds and
machines are the plan's; only the levels differ (paper eq:effect).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from controllers.optimisation.problem import MPCProblem
from controllers.safety.fallback_policy import FallbackPolicy
from thermoforce_mpc.data import Array, Boundary, Layout
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.model.operator.building import BuildingOperator

# Levels that a loop at the comfort bound is tried with: every 5 %, between which meters do not tell.
_LEVELS = 21
# A law gives the level of an actuator (its number) in a step (its number) from the temperatures at its start (Z,), °C,
# the forced state (Z, A, r), K, and the levels so far (A, N).
Law = Callable[[int, int, Array, Array, Array], float]


class Courses:
    """Rolls out rules over the N steps of `boundary`; `rules` (A,): the on/off rule of each actuator."""

    def __init__(
        self,
        problem: MPCProblem,
        operator: BuildingOperator,
        layout: Layout,
        rules: Sequence[FallbackPolicy],
        boundary: Boundary,
        T_zone_C: Array,
    ) -> None:
        """In the instance of a plan, from the temperatures (Z,), °C, that were read; NaN: what the model has."""
        self._operator, self._layout, self._machinery = operator, layout, problem.machinery
        self._rules, self._boundary = tuple(rules), boundary
        self._sees_plan = operator.of_actuator(0).feedback_active
        self._forced_K, self._features, self._T_free_C = problem.forced_state_K, problem.features, problem.T_free_C
        self._T_now_C = np.where(np.isfinite(T_zone_C), T_zone_C, problem.T_now_C)
        self._u_min, self._u_max = problem.level_bounds
        self._capacity = problem.capacity
        comes = np.ones((1, problem.n_steps)) if problem.available is None else problem.available
        self._comes = np.broadcast_to(comes, self._u_max.shape)
        m = self._machinery
        full = m.fed_by @ (m.share * np.maximum(self._u_max, 0.0).max(axis=1))
        self._clipped = not m.exclusive and self._capacity is None and bool((full <= 1.0).all())
        self._by_level: dict[tuple[int, float], list[float]] = {}
        self._setpoints: dict[int, list[float]] = {}
        self._tried: dict[int, tuple[Array, Array | None]] = {}

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
        actuators, T_free_C = range(u.shape[0]), self._T_free_C.T
        for k in range(n):
            for a in actuators:
                u[a, k] = law(a, k, T_C, forced, u)
            u[:, k] = self._limited_at(u[:, k], k)
            forced = self._next(forced, u[:, k], k)
            T_C = compose(T_free_C[k], np.add.reduce(forced, axis=(1, 2)))
        return u

    def _limited_at(self, u: Array, k: int) -> Array:
        """`limited` for the levels (A,) of step `k`."""
        if self._clipped:  # each is within its limits, and no machine is short
            return np.minimum(np.maximum(u, self._u_min[:, k]), self._u_max[:, k])
        return self.limited(u[:, None], k)[:, 0]

    def _next(self, forced: Array, u: Array, k: int) -> Array:
        """Forced state (Z, A, r), K, after step `k` with levels (A,); a rule knows few, whose drives are kept."""
        if self._sees_plan:
            return self._after(forced, u[:, None], k)
        return self._operator.advance(
            forced, np.array([self._driven_by(a, level)[k] for a, level in enumerate(u.tolist())])
        )

    def _driven_by(self, a: int, level: float) -> list[float]:
        """Drive (N,) of actuator `a` at a level, as far as it comes."""
        found = self._by_level.get((a, level))
        if found is None:
            u = np.full(self._features.shape[1], level)
            drive = self._operator.of_actuator(a).drive(u, self._features[self._operator.home[a]])
            found = self._by_level[a, level] = (drive * self._comes[a]).tolist()
        return found

    def _after(self, forced: Array, u: Array, k: int) -> Array:
        """Forced state (..., Z, A, r), K, after step `k` with levels (..., A, 1), of which what comes acts."""
        features = self._features[:, k : k + 1]
        if self._sees_plan:
            return self._operator.rollout(forced, u, features)[..., 0, :]
        drive = self._operator.drive(u, features) * self._comes[:, k : k + 1]
        return self._operator.driven(forced, drive)[..., 0, :]

    def rule(self, a: int, k: int, T_C: Array, forced: Array, u: Array) -> float:
        """Level of the on/off rule of the fallback; where loops of the building act, theirs."""
        rule, T_zone_C = self._rules[a], float(T_C[self._layout.home[a]])
        if rule.mode == "both" or not math.isfinite(T_zone_C):
            return self.loop(a, k, T_C, forced, u)
        if a not in self._setpoints:
            self._setpoints[a] = rule.setpoints_C(self._boundary, self._boundary.time_s[:-1])[0].tolist()
        return rule.switched(T_zone_C, self._setpoints[a][k])

    def loop(self, a: int, k: int, T_C: Array, forced: Array, u: Array) -> float:
        """The least level that keeps the zone inside its bounds at the end of the step, as a good loop finds it."""
        z = self._layout.home[a]
        if a not in self._tried:
            self._tried[a] = self._levels_of_loop(a)
        levels, drives = self._tried[a]
        if drives is None:
            tried = np.repeat(u[None, :, k : k + 1], levels.size, axis=0)
            tried[:, a, 0] = levels
            ends = self._after(forced, tried, k)[:, z]
        else:
            acts = np.array([0.0 if other == a else self._driven_by(other, u[other, k])[k] for other in range(len(u))])
            acts = np.repeat(acts[None], levels.size, axis=0)
            acts[:, a] = drives[:, k]
            ends = self._operator.poles[z] * forced[z] + self._operator.gains[z] * acts[..., None]
        T_end_C = compose(self._T_free_C[z, k], ends.sum(axis=(1, 2)))
        low, high = self._boundary.lower_C[z, k + 1], self._boundary.upper_C[z, k + 1]
        # A heating loop does not act on the upper bound, nor a cooling loop on the lower.
        mode = self._layout.mode(a)
        below = np.maximum(low - T_end_C, 0.0) if mode != "cooling" else np.zeros(levels.size)
        above = np.maximum(T_end_C - high, 0.0) if mode != "heating" else np.zeros(levels.size)
        outside = np.round(below + above, 6)
        return float(levels[int(np.argmin(outside))])

    def _levels_of_loop(self, a: int) -> tuple[Array, Array | None]:
        """Levels (k,) that a loop is tried with, least first, and their drives (k, N) where no temperature enters."""
        m = self._machinery
        levels = np.linspace(m.u_min[a], m.u_max[a], _LEVELS if m.u_min[a] == 0.0 else 2 * _LEVELS - 1)
        levels = levels[np.argsort(np.abs(levels), kind="stable")]
        if self._sees_plan:
            return levels, None
        u = np.repeat(levels[:, None], self._features.shape[1], axis=1)
        drives = self._operator.of_actuator(a).drive(u, self._features[self._operator.home[a]]) * self._comes[a]
        return levels, drives
