"""Solver for a machine whose level is held for a step and is either zero or at least its lowest level.

The choice between off and on is not convex. Only the first step is applied, so only there it must be exact: each of a
few levels is tried in the first step, with its own heat and power. The rest of the horizon is the convex problem of a
switching machine: switching is the cheapest way to deliver a given heat, and later steps can approximate it by being
fully off or on. This takes one quadratic programme per level.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from pydantic import Field

from controllers.errors import ControllerConfigError
from controllers.ipopt import straightened
from controllers.problem import MPCProblem, ProblemShape, Solution, checked_solution
from controllers.qp import QPSolver
from controllers.qp_backends import QPConfig
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.features import OUTDOOR
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.scenario.settings import StrictModel


class SemiContinuousConfig(StrictModel):
    """Levels tried in the first step."""

    n_levels: int = Field(8, ge=2, le=50, description="number of levels from the lowest to the highest, besides off")


class SemiContinuousSolver:
    """Solves `MPCProblem`s of one operator and shape by trying levels in the first step.

    Raises:
        ControllerConfigError: the horizon is a single step, or the rest of the problem is not convex.
    """

    def __init__(self, operator: OperatorParameters, shape: ProblemShape, config: SemiContinuousConfig, qp: QPConfig):
        if shape.n_steps < 2:
            raise ControllerConfigError(
                "solver semi_continuous: it tries levels in the first step and plans the rest of the horizon, which is "
                "a single step here; give a longer controller.options.horizon_h, or solver: ipopt"
            )
        self.operator, self.shape = operator, shape
        self._levels = np.concatenate([[0.0], np.linspace(shape.lowest_level, shape.u_max, config.n_levels)])
        switching = replace(operator, heat_input=operator.heat_input.at_lowest_level(1.0))
        later = shape.move_of_step[1:] - shape.move_of_step[1]
        self._later = QPSolver(switching, replace(shape, move_of_step=later, lowest_level=shape.u_max), qp)

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Cheapest first level with its optimal continuation; `guess` is not used. On failure `ok` is False."""
        if not problem.finite():
            return Solution(False, np.empty(0), "not started", 0, "the problem holds numbers that are not finite")
        best, least, failures, iterations = None, np.inf, [], 0
        for level in self._levels:
            later = straightened(after_first_step(problem, self.operator, float(level)))
            solution = self._later.solve(later)
            iterations += solution.iterations
            if not solution.ok:
                failures.append(f"u = {level:.2f}: {solution.problem}")
                continue
            cost = first_step_cost(problem, self.operator, float(level)) + later.cost(self._later.operator, solution.u)
            if cost < least:
                best, least = (float(level), solution), float(cost)
        if best is None:
            return Solution(False, np.empty(0), "no level", iterations, "; ".join(failures))
        level, solution = best
        T_out = problem.features[1:, OUTDOOR]
        u = np.concatenate([[level], held_level(self.operator.heat_input, solution.u, T_out, self.shape.u_max)])
        # The held levels must deliver the heat planned as shares: the claimed cost is theirs with that heat.
        after = after_first_step(problem, self.operator, level)
        planned = np.vstack([after.forced_state_K, after.modes_K(self._later.operator, solution.u)])
        claimed = float(problem.cost_under(u, planned))
        status = f"held level, {solution.status}"
        return checked_solution(problem, partial(problem.modes_K, self.operator), u, claimed, status, iterations)


def after_first_step(problem: MPCProblem, operator: OperatorParameters, level: float) -> MPCProblem:
    """The problem that remains after the first step at `level`, N − 1 steps."""
    p = problem
    return replace(
        p,
        forced_state_K=operator.step(p.forced_state_K, np.asarray(level), p.features[0]),
        features=p.features[1:],
        T_free_C=p.T_free_C[1:],
        lower_C=p.lower_C[1:],
        upper_C=p.upper_C[1:],
        price_per_kWh=p.price_per_kWh[1:],
        power_fixed_W=p.power_fixed_W[1:],
        power_per_u_W=p.power_per_u_W[1:],
        peak_so_far_W=max(p.peak_so_far_W, float(_first_power_W(p, level))),
    )


def first_step_cost(problem: MPCProblem, operator: OperatorParameters, level: float) -> float:
    """Cost of the first step at `level`, currency: energy, comfort violation at its end, and increase of the peak."""
    p = problem
    power_W = _first_power_W(p, level)
    T = p.T_free_C[0] + operator.step(p.forced_state_K, np.asarray(level), p.features[0]).sum()
    slack = max(p.lower_C[0] - T, T - p.upper_C[0], 0.0)
    peak = p.weights.peak * max(power_W - p.peak_so_far_W, 0.0)
    return float(p.price_per_W[0] * power_W + p.comfort_price * slack + peak + p.weights.curvature * level**2)


def held_level(heat_input: HeatInput, share: Array, T_out_C: Array, u_max: float) -> Array:
    """Held level with the same heat as full level for `share` (N,) of the step, shape (N,)."""
    if heat_input.heat is None:
        return np.asarray(share, dtype=np.float64)
    heat = heat_input.heat
    fixed_W, per_u_W = heat.parts(T_out_C)
    wanted_W = np.asarray(share) * heat(np.ones_like(T_out_C), T_out_C)
    lowest_W = fixed_W + per_u_W * heat.lowest_level
    # Where heat does not increase with the level, the lowest level is used.
    above = np.maximum((wanted_W - fixed_W) / np.where(per_u_W > 0, per_u_W, np.inf), heat.lowest_level)
    below = wanted_W / (fixed_W / heat.lowest_level + per_u_W)
    return np.clip(np.where(wanted_W >= lowest_W, above, below), 0.0, u_max)


def _first_power_W(problem: MPCProblem, level: float) -> float:
    on = min(level / problem.lowest_level, 1.0)
    return float(problem.power_fixed_W[0] * on + problem.power_per_u_W[0] * level)
