"""The convex problem as a sparse quadratic programme."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from controllers.checks import ControllerConfigError
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, accept_suboptimal, checked_variables, failed, not_finite
from controllers.optimisation.solvers.qp_backends import Clarabel, Piqp, QPBackend, QPConfig, QPData, SolverResult
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
        ControllerConfigError: the problem is not convex, or the operator is not of these actuators.
    """

    def __init__(
        self,
        operator: BuildingOperator,
        shape: ProblemShape,
        config: QPConfig,
        backends: Mapping[QPBackend, Callable[[QPData], SolverResult]] | None = None,
    ) -> None:
        self.model, self.operator, self.config = PlanModel(operator, shape), operator, config
        if not self.model.convex or self.model.structure.chosen:
            raise ControllerConfigError(
                "solver qp: actuators exclude one another, or the gain depends on the predicted temperature, so the "
                "problem is not convex; use a model of feedback: false, solver: milp, or solver: ipopt"
            )
        self._backends: dict[QPBackend, Callable[[QPData], SolverResult]]
        self._backends = {"piqp": Piqp(config), "clarabel": Clarabel(config), **(backends or {})}

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance. On failure `ok` is False and `problem` has each solver's reason.

        `guess` starts no solver; where none reached its optimum, their last levels must not cost more than it does.
        """
        p = self.model.numbers(problem)
        if unfinished := not_finite(p):
            return unfinished
        programme = self.model.local(p)
        failures: list[str] = []
        solution, iterate = failed("not started", 0, "no solver"), None
        for backend in self.config.backends:
            solution = self._attempt(backend, programme, problem, p, guess)
            if solution.ok and solution.optimal:
                return solution
            iterate = iterate or (solution if solution.ok else None)
            failures.append(f"{backend}: {solution.problem}")
        return iterate or failed(solution.status, solution.iterations, "; ".join(failures))

    def _attempt(
        self, backend: QPBackend, programme: QPData, problem: MPCProblem, p: Array, guess: Array | None
    ) -> Solution:
        try:
            answer = self._backends[backend](programme)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # also a panic of a compiled solver, which is no Exception: the next is tried
            return failed(f"{backend}:raised", 0, f"raised {type(error).__name__}: {error}")
        status = f"{backend}:{answer.status}"
        if answer.solved:
            claimed = programme.objective(answer.x)
            return checked_variables(self.model, problem, p, answer.x, claimed, status, answer.iterations)
        ended = failed(status, answer.iterations, f"ended with {answer.status}")
        return accept_suboptimal(self.model, problem, p, answer.x, guess, ended)
