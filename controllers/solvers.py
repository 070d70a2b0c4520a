"""Solver protocol and selection of the solver for a problem."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from controllers.actuation import Actuation
from controllers.errors import ControllerConfigError
from controllers.ipopt import IpoptSolver
from controllers.mpc_config import MPCConfig
from controllers.problem import MPCProblem, ProblemShape, Solution, blocked_moves
from controllers.qp import QPSolver
from controllers.search import CandidateSearch
from controllers.semi_continuous import SemiContinuousSolver
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.parameters import OperatorParameters


class Solver(Protocol):
    """Solver of `MPCProblem`s of one operator and horizon."""

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance; a failure is returned as a `Solution` with `ok` False.

        `guess` (N,): warm start, used by iterative solvers. The result does not depend on instances solved before.
        """
        ...


def build_solver(config: MPCConfig, operator: OperatorParameters, actuation: Actuation) -> Solver:
    """The solver named in `config`, or for `auto` the fastest one that fits the problem, over the horizon of `config`.

    Raises:
        ControllerConfigError: the solver named does not fit the problem.
    """
    n_steps = config.n_steps(operator.step_s)
    if config.solver == "search" and operator.heat_input.lowest == 0.0:
        return CandidateSearch(operator, n_steps, config.search)
    shape = ProblemShape(
        blocked_moves(n_steps, operator.step_s, config.move_blocking.free_h, config.move_blocking.hold_h),
        actuation.highest,
        actuation.lowest_level,
        peak=config.objective.peak_price_per_kW > 0,
        u_min=operator.heat_input.lowest,
    )
    if shape.u_min < 0.0 and config.solver not in ("auto", "qp"):
        raise ControllerConfigError(
            f"controller.options.solver: {config.solver} does not plan heating and cooling together; use auto or qp"
        )
    chosen = config.solver
    if chosen == "auto":
        switching = replace(operator, heat_input=operator.heat_input.at_lowest_level(1.0))
        convex_but_for_levels = replace(shape, lowest_level=shape.u_max).linear_in_u(switching)
        if shape.linear_in_u(operator):
            chosen = "qp"
        else:
            chosen = "semi_continuous" if convex_but_for_levels and n_steps > 1 else "ipopt"
    if chosen == "qp":
        return QPSolver(operator, shape, config.qp)
    if chosen == "semi_continuous":
        return SemiContinuousSolver(operator, shape, config.semi_continuous, config.qp)
    return IpoptSolver(operator, shape, config.ipopt)
