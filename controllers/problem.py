"""The optimisation problem of one control step, as numbers: what every solver is given.

    minimise    sum_k  price_k · P_k(u_k) · Δt  +  w · s_k · Δt  +  ε u_k²  +  π · p  −  λ' F_N
    subject to  F_{k+1} = A F_k + g m(x_k) u_k            forced response (paper eq:operator)
                lower_k - s_k ≤ T_free,k + F_k ≤ upper_k + s_k,   s_k ≥ 0,   0 ≤ u_k ≤ u_max
                P_k(u_k) ≤ p_0 + p,   p ≥ 0                       peak power beyond what was reached already
                u_k = v_j for all steps k of move j               move blocking

The free response T_free enters as a fixed vector. The slack s makes every instance feasible. λ values the heat that is
left in the building at the end of the horizon.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.operator.rollout import forced_rollout

J_PER_KWH = 3.6e6
# Solvers count peak power in this unit, so that its constraints are of the size of the others.
PEAK_UNIT_W = 1000.0


@dataclass(frozen=True)
class Weights:
    """What an hour of discomfort is worth, and the tiny curvature that makes the optimum unique.

    `comfort` currency/(K·h); `curvature` currency per step and u²; `peak` currency per W of peak power (mean over a
    step) beyond the highest reached so far.
    """

    comfort: float
    curvature: float
    peak: float = 0.0


@dataclass(frozen=True)
class ProblemShape:
    """What does not change from one instance to the next, so that a solver is built once.

    `move_of_step` (N,) numbers the move each step belongs to (0 … M − 1, nondecreasing): steps of one move share one
    level. `u_max` is the highest level; below `lowest_level` the machine switches. `peak` says whether peak power is
    in the objective.
    """

    move_of_step: NDArray[np.intp]
    u_max: float = 1.0
    lowest_level: float = 1.0
    peak: bool = False

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return int(self.move_of_step.size)

    @property
    def n_moves(self) -> int:
        """Number of moves M."""
        return int(self.move_of_step[-1]) + 1

    @property
    def first_steps(self) -> NDArray[np.intp]:
        """The first step of each move, shape (M,)."""
        return np.searchsorted(self.move_of_step, np.arange(self.n_moves))

    def linear_in_u(self, operator: OperatorParameters) -> bool:
        """Whether power and heat are proportional to u: then the problem is convex, a quadratic programme."""
        if operator.feedback_active:  # the gain of an action depends on the actions before it
            return False
        heat = operator.heat_input.heat
        return self.lowest_level >= self.u_max and (heat is None or heat.lowest_level >= self.u_max)


def every_step(n_steps: int) -> NDArray[np.intp]:
    """`ProblemShape.move_of_step` without move blocking."""
    return np.arange(n_steps)


def blocked_moves(n_steps: int, step_s: float, free_h: float, hold_h: float) -> NDArray[np.intp]:
    """`ProblemShape.move_of_step`: every step of the first `free_h` hours is a move, later ones hold for `hold_h`."""
    free = min(n_steps, max(1, round(free_h * HOUR_S / step_s)))
    hold = max(1, round(hold_h * HOUR_S / step_s))
    later = free + np.arange(n_steps - free) // hold
    return np.concatenate([np.arange(free), later]).astype(np.intp)


@dataclass(frozen=True)
class MPCProblem:
    """Numbers of one instance over N steps, r modes.

    `forced_state_K` (r,): F now. `features` (N, 4): raw features at the start of each step.
    (N,): `T_free_C`, `lower_C`, `upper_C` at the end of each step (margins already inside); `price_per_kWh`,
    `power_fixed_W` (while on) and `power_per_u_W` over each step. `u_max` is the highest level; below `lowest_level`
    the machine is on for the share u / `lowest_level` of a step, so the power is linear in u when the two are equal.
    `terminal_price_per_K` (r,) is what a kelvin of each mode is worth at the end, currency/K; `peak_so_far_W` the
    highest mean power over a step reached before.
    """

    forced_state_K: Array
    features: Array
    T_free_C: Array
    lower_C: Array
    upper_C: Array
    price_per_kWh: Array
    power_fixed_W: Array
    power_per_u_W: Array
    step_s: float
    u_max: float
    lowest_level: float
    weights: Weights
    terminal_price_per_K: Array
    peak_so_far_W: float = 0.0

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return int(self.T_free_C.size)

    @property
    def price_per_W(self) -> Array:
        """What one watt held over each step costs, currency/W, shape (N,)."""
        return np.asarray(self.price_per_kWh * self.step_s / J_PER_KWH, dtype=np.float64)

    @property
    def comfort_price(self) -> float:
        """What one kelvin of violation at the end of one step costs, currency/K."""
        return self.weights.comfort * self.step_s / HOUR_S

    def power_W(self, u: Array) -> Array:
        """Mean electric power over each step for levels `u` (..., N), W."""
        on_share = np.minimum(u / self.lowest_level, 1.0)
        return np.asarray(self.power_fixed_W * on_share + self.power_per_u_W * u, dtype=np.float64)

    def forced_K(self, operator: OperatorParameters, u: Array) -> Array:
        """Forced response at the end of each step for levels `u` (..., N), K, shape (..., N)."""
        return np.asarray(self.modes_K(operator, u).sum(axis=-1), dtype=np.float64)

    def modes_K(self, operator: OperatorParameters, u: Array) -> Array:
        """Forced state of every mode at the end of each step for levels `u` (..., N), K, shape (..., N, r)."""
        return forced_rollout(operator, self.forced_state_K, u, self.features)

    def slack_K(self, T_zone_C: Array) -> Array:
        """Violation of the comfort bounds at the end of each step, K, shape as `T_zone_C`."""
        below, above = self.lower_C - T_zone_C, T_zone_C - self.upper_C
        return np.maximum(np.maximum(below, above), 0.0)

    def cost(self, operator: OperatorParameters, u: Array) -> Array:
        """Objective for levels `u` (..., N), currency, shape (...,)."""
        return self.cost_under(u, self.modes_K(operator, u))

    def cost_under(self, u: Array, modes: Array) -> Array:
        """Objective for levels `u` (..., N) that lead to the forced state `modes` (..., N, r) K, currency, (...,)."""
        slack = self.slack_K(self.T_free_C + modes.sum(axis=-1))
        power = self.power_W(u)
        energy = (self.price_per_W * power).sum(axis=-1)
        comfort = self.comfort_price * slack.sum(axis=-1)
        peak = self.weights.peak * np.maximum(power.max(axis=-1) - self.peak_so_far_W, 0.0)
        left = modes[..., -1, :] @ self.terminal_price_per_K
        curvature = self.weights.curvature * (u**2).sum(axis=-1)
        return np.asarray(energy + comfort + peak + curvature - left, dtype=np.float64)

    def finite(self) -> bool:
        """Whether every number of the instance is finite."""
        arrays = (
            self.forced_state_K, self.features.ravel(), self.T_free_C, self.lower_C, self.upper_C, self.price_per_kWh,
            self.power_fixed_W, self.power_per_u_W, self.terminal_price_per_K, [self.peak_so_far_W],
        )  # fmt: skip
        return bool(np.isfinite(np.concatenate(arrays)).all())


@dataclass(frozen=True)
class Solution:
    """What a solver answers; `ok` only after its status, finiteness and bounds were checked.

    `u` (N,) levels (empty when not ok), `status` the solver's own word, `problem` what is wrong in one phrase.
    """

    ok: bool
    u: Array
    status: str
    iterations: int
    problem: str = ""


# Largest violation of 0 ≤ u ≤ u_max that is a solver's bound relaxation rather than an error.
_BOUND_TOLERANCE = 1e-6
# How far the objective that a solver claims may lie below what its levels really cost: a solver that takes violated
# constraints for satisfied ones claims too little.
_CLAIM_TOLERANCE = 1e-4


def checked_solution(
    problem: MPCProblem,
    modes_of: Callable[[Array], Array],
    u: Array,
    claimed: float,
    status: str,
    iterations: int,
    tolerance: float = _CLAIM_TOLERANCE,
) -> Solution:
    """What a solver that reports success really found: refused unless finite, inside bounds and as cheap as claimed.

    All constraints but the bounds of u are soft, so levels inside the bounds are feasible; whether the solver solved
    *this* problem shows in what the levels cost by our own rollout: `modes_of` gives the forced state (N, r) of levels.
    """
    if u.shape != (problem.n_steps,) or not np.isfinite(u).all() or not np.isfinite(claimed):
        return Solution(
            False, np.empty(0), status, iterations, f"{status} was reported, but the solution is not finite"
        )
    if u.min() < -_BOUND_TOLERANCE or u.max() > problem.u_max + _BOUND_TOLERANCE:
        what = f"{status} was reported, but u leaves its bounds (from {u.min():.4g} to {u.max():.4g})"
        return Solution(False, np.empty(0), status, iterations, what)
    u = np.clip(u, 0.0, problem.u_max)
    cost = float(problem.cost_under(u, modes_of(u)))
    if not abs(cost - claimed) <= tolerance * (1.0 + abs(cost)):
        what = f"{status} was reported with an objective of {claimed:.6g}, but its levels cost {cost:.6g}"
        return Solution(False, np.empty(0), status, iterations, what)
    return Solution(True, u, status, iterations)
