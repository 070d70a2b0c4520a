"""The convex problem as a sparse quadratic programme.

PIQP (Schwan et al. 2023), which solves sparse quadratic programmes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydantic import Field

from controllers.checks import ControllerConfigError
from controllers.optimisation.problem import ProblemShape
from controllers.optimisation.programme import FAR, QPData
from controllers.optimisation.solution import Solver, SolverAnswer, StatementSolver
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.scenario.settings import StrictModel


class QPConfig(StrictModel):
    """Options of PIQP."""

    # As exact as costs are compared (`_LEAVES` of `optimisation.solution`).
    tolerance: float = Field(1e-7, gt=0, description="absolute and relative tolerance")
    # 25 are usual with twenty rooms (`python -m benchmarks.speed --rows twenty`, 2026-11-28).
    max_iterations: int = Field(100, ge=1, description="iterations before a solve counts as failed")


@dataclass(frozen=True)
class SolverResult:
    """Result of a solver of programmes; `solved`: `x` is its optimum. `bound`: lower bound of the linear objective."""

    solved: bool
    x: Array
    status: str
    iterations: int
    multipliers: Array = field(default_factory=lambda: np.zeros(0))
    bound: float = -np.inf


class Piqp:
    """PIQP, set up once and updated with the numbers of each instance of the same pattern."""

    def __init__(self, config: QPConfig) -> None:
        self._config = config
        self._solver: Any = None
        self._patterns: tuple[Array, ...] = ()

    def __call__(self, q: QPData) -> SolverResult:
        """Solve one programme. `multipliers` of the equations, then of G.

        Bounds that are far are taken as none where the optimum keeps them all the same: PIQP calls a programme with
        bounds of 1e9 beside numbers of about 1 infeasible, or ends far from its optimum.
        """
        low, high = (
            np.where(np.abs(bound) >= FAR, far, bound) for bound, far in ((q.x_low, -np.inf), (q.x_high, np.inf))
        )
        if np.array_equal(low, q.x_low) and np.array_equal(high, q.x_high):
            return self._solved(q)
        found = self._solved(replace(q, x_low=low, x_high=high))
        if found.solved and (found.x >= q.x_low).all() and (found.x <= q.x_high).all():
            return found
        return self._solved(q)

    def _solved(self, q: QPData) -> SolverResult:
        import piqp

        # A solver that has failed is not used again, nor one of another pattern: its update takes the numbers of any
        # matrix with as many elements, or fewer, as those of its own pattern.
        patterns = tuple(index for matrix in (q.quadratic, q.A, q.G) for index in (matrix.indptr, matrix.indices))
        same = len(patterns) == len(self._patterns) and all(map(np.array_equal, patterns, self._patterns))
        solver, self._solver = self._solver if same else None, None
        if solver is None:
            solver, self._patterns = self._set_up(q), tuple(index.copy() for index in patterns)
        else:
            solver.update(
                P=q.quadratic, c=q.linear, A=q.A, b=q.b, G=q.G, h_l=q.low, h_u=q.high, x_l=q.x_low, x_u=q.x_high
            )
        status = solver.solve()
        result = solver.result
        solved = status == piqp.PIQP_SOLVED
        if solved:
            self._solver = solver
        multipliers = np.concatenate([result.y, result.z_u - result.z_l])
        x = np.array(result.x, dtype=np.float64)
        return SolverResult(solved, x, str(status.name), int(result.info.iter), multipliers)

    def _set_up(self, q: QPData) -> Any:
        import piqp

        solver = piqp.SparseSolver()
        settings = solver.settings
        settings.kkt_solver = piqp.KKTSolver.sparse_ldlt  # the fastest of its five on this structure
        # K, shares and prices relative to the largest are already well scaled.
        settings.preconditioner_iter = 0
        # Longer steps towards the bounds than the default 0.99 save an iteration.
        settings.tau = 0.999
        # Residuals of the difference equation accumulate over the rows, so they need a tighter tolerance.
        settings.reg_lower_limit = 1e-8
        settings.reg_finetune_lower_limit = 1e-10
        settings.eps_abs = settings.eps_rel = self._config.tolerance
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = self._config.tolerance
        settings.max_iter = self._config.max_iterations
        solver.setup(q.quadratic, q.linear, q.A, q.b, q.G, q.low, q.high, q.x_low, q.x_high)
        return solver


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
