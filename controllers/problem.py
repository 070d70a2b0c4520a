"""The optimisation problem of one control step in numbers: input and output of every solver.

    minimise    sum_k  price_k · P_k(u_k) · Δt  +  w · s_k · Δt  +  ε u_k²  +  π · p  −  λ' F_N
    subject to  F_{k+1} = A F_k + g m(x_k) u_k            forced response (paper eq:operator)
                lower_k - s_k ≤ T_free,k + F_k ≤ upper_k + s_k,   s_k ≥ 0,   0 ≤ u_k ≤ u_max
                (one zone's heating and cooling: −c ≤ u_k, with price and power of cooling for u_k < 0)
                P_k(u_k) ≤ p_0 + p,   p ≥ 0                       p: peak power above the highest so far, p_0
                u_k = v_j for all steps k of move j               move blocking

The free response T_free enters as a fixed vector. The slack s makes every instance feasible. λ is the value of the heat
stored in the building at the end of the horizon.
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
# Unit of peak power in solvers, W; scales its constraints like the others.
PEAK_UNIT_W = 1000.0


@dataclass(frozen=True)
class Weights:
    """Weights of the objective on comfort violation, curvature and peak power.

    `comfort` currency/(K·h); `curvature` currency per step and u², makes the optimum unique; `peak` currency per W of
    peak power (mean over a step) above the highest so far.
    """

    comfort: float
    curvature: float
    peak: float = 0.0


@dataclass(frozen=True)
class ProblemShape:
    """Structure shared by all instances, from which a solver is built once.

    `move_of_step` (N,) numbers the move each step belongs to (0 … M − 1, nondecreasing): steps of one move share one
    level. `u_max` is the highest level, `u_min` the lowest (below 0: cooling); between 0 and `lowest_level` the machine
    switches. `peak`: peak power is in the objective.
    """

    move_of_step: NDArray[np.intp]
    u_max: float = 1.0
    lowest_level: float = 1.0
    peak: bool = False
    u_min: float = 0.0

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
        """Whether power and heat are proportional to u, so that the problem is a convex quadratic programme."""
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
class Cooling:
    """Cooling beside heating: lowest level `u_min` < 0, `price_per_kWh` and power over −u, `power_per_u_W`, (N,)."""

    u_min: float
    price_per_kWh: Array
    power_per_u_W: Array


@dataclass(frozen=True)
class MPCProblem:
    """Numbers of one instance over N steps, r modes.

    `forced_state_K` (r,): initial F. `features` (N, 4): raw features at the start of each step.
    (N,): `T_free_C`, `lower_C`, `upper_C` at the end of each step (margins already inside); `price_per_kWh`,
    `power_fixed_W` (while on) and `power_per_u_W` over each step. `u_max` is the highest level; below `lowest_level`
    the machine is on for the share u / `lowest_level` of a step, so the power is linear in u when the two are equal.
    `terminal_price_per_K` (r,): value of one kelvin of each mode at the end, currency/K; `peak_so_far_W`: highest mean
    power over a step so far. `cooling`: what levels below 0 cost; None where there are none.
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
    cooling: Cooling | None = None

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return int(self.T_free_C.size)

    @property
    def u_min(self) -> float:
        """Lowest level."""
        return 0.0 if self.cooling is None else self.cooling.u_min

    @property
    def price_per_W(self) -> Array:
        """Cost of one watt held over each step, currency/W, shape (N,)."""
        return np.asarray(self.price_per_kWh * self.step_s / J_PER_KWH, dtype=np.float64)

    @property
    def cooling_cost_per_u(self) -> Array:
        """Energy cost of cooling over each step per unit of −u, currency, shape (N,); 0 without cooling."""
        if self.cooling is None:
            return np.zeros(self.n_steps)
        return np.asarray(self.cooling.price_per_kWh * self.cooling.power_per_u_W * self.step_s / J_PER_KWH)

    @property
    def comfort_price(self) -> float:
        """Cost of one kelvin of violation at the end of one step, currency/K."""
        return self.weights.comfort * self.step_s / HOUR_S

    def power_W(self, u: Array) -> Array:
        """Mean electric power over each step for levels `u` (..., N), W."""
        if self.cooling is not None:
            return self._heating_W(np.maximum(u, 0.0)) + self.cooling.power_per_u_W * np.maximum(-u, 0.0)
        return self._heating_W(u)

    def energy_cost(self, u: Array) -> Array:
        """Cost of energy over each step for levels `u` (..., N), currency, shape (..., N)."""
        if self.cooling is None:
            return np.asarray(self.price_per_W * self.power_W(u))
        return self.price_per_W * self._heating_W(np.maximum(u, 0.0)) + self.cooling_cost_per_u * np.maximum(-u, 0.0)

    def _heating_W(self, u: Array) -> Array:
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
        """Objective for levels `u` (..., N) with forced state `modes` (..., N, r), K; currency, shape (...,)."""
        slack = self.slack_K(self.T_free_C + modes.sum(axis=-1))
        power = self.power_W(u)
        energy = self.energy_cost(u).sum(axis=-1)
        comfort = self.comfort_price * slack.sum(axis=-1)
        peak = self.weights.peak * np.maximum(power.max(axis=-1) - self.peak_so_far_W, 0.0)
        left = modes[..., -1, :] @ self.terminal_price_per_K
        curvature = self.weights.curvature * (u**2).sum(axis=-1)
        return np.asarray(energy + comfort + peak + curvature - left, dtype=np.float64)

    def finite(self) -> bool:
        """Whether every number of the instance is finite."""
        arrays = (
            self.forced_state_K, self.features.ravel(), self.T_free_C, self.lower_C, self.upper_C, self.price_per_kWh,
            self.power_fixed_W, self.power_per_u_W, self.terminal_price_per_K, self.cooling_cost_per_u,
            [self.peak_so_far_W, self.u_min],
        )  # fmt: skip
        return bool(np.isfinite(np.concatenate(arrays)).all())


@dataclass(frozen=True)
class Solution:
    """Result of a solver; `ok` only if status, finiteness, bounds and objective passed the checks.

    `u` (N,): levels, empty when not ok; `status`: the solver's own status; `problem`: reason of a failure.
    """

    ok: bool
    u: Array
    status: str
    iterations: int
    problem: str = ""


# Largest violation of 0 ≤ u ≤ u_max accepted as a solver's bound relaxation.
_BOUND_TOLERANCE = 1e-6
# Relative tolerance between a solver's objective and the recomputed one: they differ if the solver accepted violated
# constraints.
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
    """Check the result of a solver that reports success.

    The solution is refused unless it is finite, within the bounds of u, and its objective, recomputed by rollout,
    agrees with `claimed`. All inequalities except the bounds of u are soft, so levels within them are feasible; a
    different objective shows that another problem was solved. `modes_of` maps levels (N,) to forced states (N, r), K.
    """
    if u.shape != (problem.n_steps,) or not np.isfinite(u).all() or not np.isfinite(claimed):
        return Solution(
            False, np.empty(0), status, iterations, f"{status} was reported, but the solution is not finite"
        )
    if u.min() < problem.u_min - _BOUND_TOLERANCE or u.max() > problem.u_max + _BOUND_TOLERANCE:
        what = f"{status} was reported, but u leaves its bounds (from {u.min():.4g} to {u.max():.4g})"
        return Solution(False, np.empty(0), status, iterations, what)
    u = np.clip(u, problem.u_min, problem.u_max)
    cost = float(problem.cost_under(u, modes_of(u)))
    if not abs(cost - claimed) <= tolerance * (1.0 + abs(cost)):
        what = f"{status} was reported with an objective of {claimed:.6g}, but its levels cost {cost:.6g}"
        return Solution(False, np.empty(0), status, iterations, what)
    return Solution(True, u, status, iterations)
