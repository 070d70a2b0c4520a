"""The convex problem as a sparse quadratic programme."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from controllers.checks import ControllerConfigError
from controllers.optimisation.problem import ProblemShape
from controllers.optimisation.programme import QPData
from controllers.optimisation.solution import Solver, SolverAnswer, StatementSolver
from controllers.optimisation.solvers.qp_backends import Piqp, QPConfig, SolverResult
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator


class QPSolver(StatementSolver):
    """By PIQP, or by `programme_solver` in its place; the problem must be convex."""

    name = "piqp"

    def __init__(
        self,
        operator: BuildingOperator,
        shape: ProblemShape,
        config: QPConfig,
        fallback: Callable[[], Solver] | None = None,
        programme_solver: Callable[[QPData], SolverResult] | None = None,
    ) -> None:
        super().__init__(operator, shape, fallback)
        self.config, self._solve = config, programme_solver or Piqp(config)
        if not self.model.convex or self.model.structure.chosen:
            raise ControllerConfigError(
                "solver qp: actuators exclude one another, or the gain depends on the predicted temperature, so the "
                "problem is not convex; use a model of feedback: false, solver: milp, or solver: ipopt"
            )

    def _answers(self, p: Array, guess: Array | None) -> Iterator[SolverAnswer]:
        programme = self.model.local(p)
        found = self._solve(programme)
        claimed = programme.objective(found.x) if found.solved else None
        why = "" if found.solved else f"piqp: ended with {found.status}"
        multipliers = programme.unit * found.multipliers
        yield SolverAnswer(found.x, claimed, f"piqp:{found.status}", found.iterations, why, multipliers=multipliers)
