"""The convex case of the MPC problem as a sparse quadratic programme: the fastest solver.

Every solution is checked by a rollout of the modes of every pair before it is accepted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from controllers.checks import ControllerConfigError
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.qp_backends import Clarabel, Piqp, QPBackend, QPConfig, QPData, SolverResult
from controllers.optimisation.solution import Solution, accept_suboptimal, checked_solution, failed
from controllers.optimisation.sparse_qp import Drive, SparseQP
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator


class QPSolver:
    """Solves `MPCProblem`s of one operator and shape.

    Args:
        operator: the operator of the building.
        shape: what all its problems have in common.
        config: options.
        backends: solvers in the place of PIQP and Clarabel, by name.

    Raises:
        ControllerConfigError: the problem is not convex (levels between off and `u_max` have their own efficiency, or
            actuators exclude one another), or the operator is not of these actuators.
    """

    def __init__(
        self,
        operator: BuildingOperator,
        shape: ProblemShape,
        config: QPConfig,
        backends: Mapping[QPBackend, Callable[[QPData], SolverResult]] | None = None,
    ) -> None:
        if not shape.convex(operator):
            raise ControllerConfigError(
                "solver qp: power or heat is not proportional to u in this actuation, actuators exclude one another, "
                "or the gain depends on the predicted temperature, so the problem is not convex; use actuation mode "
                "duty with a model of feedback: false, solver: milp, or solver: ipopt"
            )
        self.operator, self.shape, self.config = operator, shape, config
        self._sparse_qp = SparseQP(operator, shape)
        self._backends: dict[QPBackend, Callable[[QPData], SolverResult]]
        self._backends = {"piqp": Piqp(config), "clarabel": Clarabel(config), **(backends or {})}

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance. On failure `ok` is False and `problem` has each solver's reason.

        `guess` starts no solver; where none reached its optimum, their last levels must not cost more than it does.
        """
        if not problem.finite():
            return failed("not started", 0, "the problem holds numbers that are not finite")
        problem = self._sparse_qp.as_solved(problem)
        drive = self._sparse_qp.drive(problem)
        qp_data = self._sparse_qp.numbers(problem, drive)
        failures: list[str] = []
        solution, iterate = failed("not started", 0, "no solver"), None
        for backend in self.config.backends:
            solution = self._attempt(backend, qp_data, problem, drive, guess)
            if solution.ok and solution.optimal:
                return solution
            iterate = iterate or (solution if solution.ok else None)
            failures.append(f"{backend}: {solution.problem}")
        if iterate is not None:
            return iterate
        return failed(solution.status, solution.iterations, "; ".join(failures))

    def _attempt(
        self, backend: QPBackend, qp_data: QPData, problem: MPCProblem, drive: Drive, guess: Array | None
    ) -> Solution:
        try:
            answer = self._backends[backend](qp_data)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # also a panic of a compiled solver, which is no Exception: the next is tried
            return failed(f"{backend}:raised", 0, f"raised {type(error).__name__}: {error}")
        status = f"{backend}:{answer.status}"

        def modes_of(u: Array) -> Array:
            return self._sparse_qp.modes(problem, drive, u)

        if not answer.solved:
            ended = failed(status, answer.iterations, f"ended with {answer.status}")
            if answer.x.size != qp_data.linear.size or not np.isfinite(answer.x).all():
                return ended
            return accept_suboptimal(problem, modes_of, self._sparse_qp.levels(answer.x), guess, ended)
        u, claimed = self._sparse_qp.levels(answer.x), qp_data.objective(answer.x)
        return checked_solution(problem, modes_of, u, claimed, status, answer.iterations)
