"""Solver protocol and selection of the solver for a problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from controllers.checks import ControllerConfigError
from controllers.ipopt import IpoptSolver
from controllers.machinery import Machinery
from controllers.milp import MilpSolver
from controllers.mpc_config import MPCConfig
from controllers.problem import MPCProblem, ProblemShape, Solution, blocked_moves
from controllers.qp import QPSolver
from controllers.search import CandidateSearch
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator


class Solver(Protocol):
    """Solver of `MPCProblem`s of one operator and horizon."""

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance; a failure is returned as a `Solution` with `ok` False.

        `guess` (A, N): warm start, used by iterative solvers. The result does not depend on instances solved before.
        """
        ...


@dataclass(frozen=True, eq=False)
class Solve:
    """A solve that is asked for: called, it is made."""

    solver: Solver
    problem: MPCProblem
    guess: Array | None

    def __call__(self) -> Solution:
        """Solve it."""
        return self.solver.solve(self.problem, self.guess)


def build_solver(config: MPCConfig, operator: BuildingOperator, machinery: Machinery) -> Solver:
    """The solver named in `config`, or for `auto` the fastest one that fits the problem, over the horizon of `config`.

    Raises:
        ControllerConfigError: the solver named does not fit the problem.
    """
    n_steps, step_s = config.n_steps(operator.step_s), operator.step_s
    if config.solver == "search":
        if machinery.signed.size:
            raise ControllerConfigError(
                "controller.options.solver: search does not plan heating and cooling together; use auto or qp"
            )
        return CandidateSearch(operator, n_steps, config.search)
    shape = ProblemShape(
        blocked_moves(n_steps, step_s, config.move_blocking.free_h, config.move_blocking.hold_h),
        machinery,
        peak=config.objective.peak_price_per_kW > 0,
        capped=config.objective.power_cap_kW is not None,
        held_steps=config.milp.held_steps(step_s),
    )
    chosen = config.solver
    if chosen == "auto":
        chosen = "ipopt" if operator.of_actuator(0).feedback_active else "milp"
        chosen = "qp" if shape.convex(operator) else chosen
    if chosen == "qp":
        return QPSolver(operator, shape, config.qp)
    if chosen == "milp":
        return MilpSolver(operator, shape, config.milp, config.qp)
    return IpoptSolver(operator, shape, config.ipopt)
