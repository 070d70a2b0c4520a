"""Held levels of plans in which later steps are relaxed: of the same heat as the actuator that switches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import MPCProblem
from controllers.optimisation.solution import Solution, failed
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.features import OUTDOOR
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Largest difference between the heat planned as a share of later steps and that of the level it is reported as, K.
_SAME_K = 1e-4


def as_held(model: PlanModel, problem: MPCProblem, solution: Solution) -> Solution:
    """A checked solution with the levels of later steps as they will be held; failed where their heat is another."""
    machinery, later = model.shape.machinery, slice(model.shape.n_held, None)
    if not solution.ok or solution.evaluation is None or not machinery.held.any():
        return solution
    u = solution.u.copy()
    for a in np.flatnonzero(machinery.held):
        T_out_C = problem.features[model.operator.home[a], later, OUTDOOR]
        heat_input = model.operator.of_actuator(int(a)).heat_input
        u[a, later] = held_level(heat_input, u[a, later], T_out_C, float(machinery.u_max[a]))
    fine = model.by_steps
    planned = fine.evaluate(problem, fine.numbers(problem), solution.u, solution.own_values)
    evaluation = fine.evaluate(problem, fine.held_numbers(problem), u, solution.own_values)
    off_K = float(np.abs(evaluation.forced_K - planned.forced_K).max())
    if not off_K <= _SAME_K:
        why = f"levels of later steps bring another heat than planned ({off_K:.2g} K)"
        return failed(solution.status, solution.iterations, why)
    return replace(solution, u=u, evaluation=replace(evaluation, broken=""))


def held_level(heat_input: HeatInput, u: Array, T_out_C: Array, u_max: float) -> Array:
    """Held level with the same heat as `u_max` for the share `u` / `u_max` (N,) of the step, shape (N,)."""
    if heat_input.heat is None:
        return np.asarray(u, dtype=np.float64)
    heat = heat_input.heat
    fixed_W, per_u_W = heat.parts(T_out_C)
    target_W = np.asarray(u) / u_max * heat(np.full_like(T_out_C, u_max), T_out_C)
    lowest_W = fixed_W + per_u_W * heat.lowest_level
    # Where heat does not increase with the level, the lowest level is used.
    above = np.maximum((target_W - fixed_W) / np.where(per_u_W > 0, per_u_W, np.inf), heat.lowest_level)
    below = target_W / (fixed_W / heat.lowest_level + per_u_W)
    return np.clip(np.where(target_W >= lowest_W, above, below), 0.0, u_max)
