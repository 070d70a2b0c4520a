"""Choices between off and on by mixed-integer programming: HiGHS (Huangfu and Hall 2018).

Not convex are actuators of which one may act at a time. Which of them acts is decided exactly in the first hours; later
they share a step in time. Only the first step is applied, and every plan decides its first hours anew.

The curvature term is left out of the choice. The solver starts from the rounded relaxation and stops at its time limit
with the best plan so far; how far that may be from the optimum of the programme solved is `Solution.gap`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import sparse

from controllers.checks import ControllerConfigError
from controllers.optimisation.problem import ProblemShape
from controllers.optimisation.solution import Answer, StatementSolver
from controllers.optimisation.solvers.qp_backends import Piqp, QPConfig, QPData, SolverResult
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.scenario.settings import StrictModel


class MilpConfig(StrictModel):
    """Options of the mixed-integer programme."""

    hours: float = Field(1.0, gt=0, description="first part of the horizon in which choices are decided, h")
    gap: float = Field(1e-3, ge=0, description="relative gap to the bound at which the solver stops")
    max_seconds: float = Field(2.0, gt=0, description="time after which the best plan so far is taken, s")

    def chosen_steps(self, step_s: float) -> int:
        """Number of steps of `step_s` seconds in which choices are decided, at least one."""
        return max(1, round(self.hours * HOUR_S / step_s))


class Highs:
    """HiGHS, by CasADi's interface, on the programme without its quadratic term."""

    def __init__(self, config: MilpConfig) -> None:
        limits = {"time_limit": config.max_seconds, "mip_rel_gap": config.gap}
        self._options = {"output_flag": False, "threads": 1, **limits}

    def __call__(self, q: QPData, choices: NDArray[np.intp], start: Array | None = None) -> SolverResult:
        """Solve one programme in which the columns `choices` are whole, from `start` (all columns) if given.

        `x` is empty without a plan; at the time limit it is one that is not `solved`.
        """
        rows, n = ca.DM(sparse.vstack([q.A, q.G], format="csc")), q.linear.size
        options = {"discrete": np.isin(np.arange(n), choices).tolist(), "error_on_fail": False, "highs": self._options}
        solver = ca.conic("choices", "highs", {"h": ca.Sparsity(n, n), "a": rows.sparsity()}, options)
        low, high = np.concatenate([q.b, q.low]), np.concatenate([q.b, q.high])
        begin = {} if start is None else {"x0": start}
        found = solver(g=q.linear, a=rows, lba=low, uba=high, lbx=q.x_low, ubx=q.x_high, **begin)
        said = solver.stats()
        feasible = said["primal_solution_status"] == "Feasible"
        x = np.array(found["x"]).ravel() if feasible else np.empty(0)
        word, bound = str(said["return_status"]), float(said["mip_dual_bound"])
        return SolverResult(word == "Optimal", x, word, int(said["simplex_iteration_count"]), bound=bound)


class MilpSolver(StatementSolver):
    """By HiGHS, or by `choose` in its place; `shape.chosen_steps` says for how long choices are decided.

    The problem must be convex but for its choices, and terms of the user linear. `qp`: options of the relaxation that
    HiGHS starts from.
    """

    name = "highs"

    def __init__(
        self,
        operator: BuildingOperator,
        shape: ProblemShape,
        config: MilpConfig,
        qp: QPConfig | None = None,
        choose: Callable[[QPData, NDArray[np.intp], Array | None], SolverResult] | None = None,
    ) -> None:
        super().__init__(operator, shape)
        if not self.model.convex:
            raise ControllerConfigError(
                "solver milp: the gain depends on the predicted temperature, or another term is not linear; use "
                "solver: ipopt, or a model of feedback: false"
            )
        s, quadratic = self.model.structure, self.model.functions.local.sparsity_out(2).nnz()
        # Of u², with u = v − cold, and of how far levels are above the lowest.
        if s.terms and quadratic > s.N * (s.A + 3 * len(s.signed) + len(s.stepped)):
            raise ControllerConfigError(
                "solver milp: a term of the user is quadratic, which HiGHS leaves out; use solver: ipopt"
            )
        self._choose, self._relax = choose or Highs(config), Piqp(qp or QPConfig())

    def _answers(self, p: Array, guess: Array | None) -> Iterator[Answer]:
        programme = self.model.local(p)
        found = self._choose(programme, self.model.choices, self._start(programme))
        status = f"highs:{found.status}"
        if not found.x.size:
            yield Answer(found.x, None, status, found.iterations, f"highs: ended with {found.status} and no plan")
            return
        claimed, linear = programme.objective(found.x), programme.objective(found.x, with_quadratic=False)
        gap = max(linear - programme.constant - programme.unit * found.bound, 0.0) / max(abs(linear), 1e-9)
        why = "" if found.solved else f"highs: time limit, at most {gap:.1%} above the optimum"
        yield Answer(found.x, claimed, f"{status}, gap {gap:.2g}", found.iterations, why, gap)

    def _start(self, programme: QPData) -> Array | None:
        """The relaxation's levels with their choices rounded: what HiGHS improves on; None where it fails."""
        choices = self.model.choices
        relaxed = self._relax(programme) if choices.size else None
        if relaxed is None or not relaxed.solved:
            return None
        start = relaxed.x
        start[choices] = self.model.rounded(start)
        return start
