"""Choices between off and on by mixed-integer programming: HiGHS (Huangfu and Hall 2018).

Not convex are actuators of which one may act at a time. Which of them acts is decided exactly in the first hours; later
they share a step in time. Only the first step is applied, and every plan decides its first hours anew.

The curvature term is left out of the choice. The solver starts from the rounded relaxation and stops at its time limit
with the best plan so far; how far that may be from the optimum of the programme solved is `Solution.gap`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import sparse

from controllers.checks import ControllerConfigError
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, checked_variables, failed, not_finite
from controllers.optimisation.solvers.qp_backends import Piqp, QPConfig, QPData
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.scenario.settings import StrictModel

if TYPE_CHECKING:
    import highspy


class MilpConfig(StrictModel):
    """Options of the mixed-integer programme."""

    hours: float = Field(1.0, gt=0, description="first part of the horizon in which choices are decided, h")
    gap: float = Field(1e-3, ge=0, description="relative gap to the bound at which the solver stops")
    max_seconds: float = Field(2.0, gt=0, description="time after which the best plan so far is taken, s")

    def chosen_steps(self, step_s: float) -> int:
        """Number of steps of `step_s` seconds in which choices are decided, at least one."""
        return max(1, round(self.hours * HOUR_S / step_s))


@dataclass(frozen=True)
class ChoiceResult:
    """Result of the mixed-integer solver; `x` is empty without a plan; `bound`: lower bound of the linear objective.

    `optimal`: whether the solver reached its gap before its time limit.
    """

    x: Array
    status: str
    nodes: int
    bound: float
    optimal: bool = True


class Highs:
    """HiGHS on the programme without its quadratic term."""

    def __init__(self, config: MilpConfig) -> None:
        self._config = config

    def __call__(self, q: QPData, choices: NDArray[np.intp], start: Array | None = None) -> ChoiceResult:
        """Solve one programme in which the columns `choices` are whole, from `start` (all columns) if given."""
        import highspy

        solver = silent_highs()
        for name, value in {
            "threads": 1,
            "time_limit": self._config.max_seconds,
            "mip_rel_gap": self._config.gap,
        }.items():
            solver.setOptionValue(name, value)
        matrix = sparse.vstack([q.A, q.G], format="csc")
        lp = highspy.HighsLp()
        lp.num_row_, lp.num_col_ = matrix.shape
        lp.col_cost_, lp.col_lower_, lp.col_upper_ = q.linear, q.x_low, q.x_high
        lp.row_lower_, lp.row_upper_ = np.concatenate([q.b, q.low]), np.concatenate([q.b, q.high])
        lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
        lp.a_matrix_.num_row_, lp.a_matrix_.num_col_ = matrix.shape
        lp.a_matrix_.start_, lp.a_matrix_.index_, lp.a_matrix_.value_ = matrix.indptr, matrix.indices, matrix.data
        integrality = np.zeros(q.linear.size, dtype=np.intp)
        integrality[choices] = 1
        kinds: Any = [highspy.HighsVarType.kContinuous, highspy.HighsVarType.kInteger]
        lp.integrality_ = [kinds[is_whole] for is_whole in integrality.tolist()]
        solver.passModel(lp)
        if start is not None:
            warm_start = highspy.HighsSolution()
            warm_start.col_value = start
            solver.setSolution(warm_start)
        solver.run()
        status, info = solver.getModelStatus(), solver.getInfo()
        word = solver.modelStatusToString(status)
        stopped = {highspy.HighsModelStatus.kOptimal, highspy.HighsModelStatus.kTimeLimit}
        if status not in stopped or info.primal_solution_status != highspy.SolutionStatus.kSolutionStatusFeasible:
            return ChoiceResult(np.empty(0), word, int(info.mip_node_count), -np.inf)
        x = np.array(solver.getSolution().col_value, dtype=np.float64)
        optimal = status == highspy.HighsModelStatus.kOptimal
        return ChoiceResult(x, word, int(info.mip_node_count), float(info.mip_dual_bound), optimal)


def silent_highs() -> highspy.Highs:
    """A HiGHS that prints nothing: the first of a process says its version while it is made, before options are set."""
    import highspy

    class Silent(highspy.Highs):
        def enableCallbacks(self) -> None:  # what its constructor does first
            self.setOptionValue("output_flag", False)
            super().enableCallbacks()

    solver = Silent()
    solver.setOptionValue("output_flag", False)
    return solver


class MilpSolver:
    """Solves `MPCProblem`s of one operator and shape; `shape.chosen_steps` says for how long choices are decided.

    Args:
        operator: the operator of the building.
        shape: what all its problems have in common.
        config: options of HiGHS.
        qp: options of the relaxation that HiGHS starts from.
        choose: solver of the choices in the place of `Highs`.

    Raises:
        ControllerConfigError: the problem is not convex but for its choices, a term of the user is quadratic, or the
            operator is not of these actuators.
    """

    def __init__(
        self,
        operator: BuildingOperator,
        shape: ProblemShape,
        config: MilpConfig,
        qp: QPConfig | None = None,
        choose: Callable[[QPData, NDArray[np.intp], Array | None], ChoiceResult] | None = None,
    ) -> None:
        self.model, self.operator = PlanModel(operator, shape), operator
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

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance; `guess` is not used. On failure `ok` is False and `problem` has the reason."""
        model, p = self.model, self.model.numbers(problem)
        if unfinished := not_finite(p):
            return unfinished
        programme = model.local(p)
        try:
            answer = self._choose(programme, model.choices, self._start(programme))
        except Exception as error:  # a failed solve is a value
            return failed("highs:raised", 0, f"highs: raised {type(error).__name__}: {error}")
        status = f"highs:{answer.status}"
        if not answer.x.size:
            return failed(status, answer.nodes, f"highs: ended with {answer.status} and no plan")
        claimed = programme.objective(answer.x)
        solution = checked_variables(model, problem, p, answer.x, claimed, status, answer.nodes)
        if not solution.ok:
            return replace(solution, problem=f"highs: {solution.problem}")
        linear = programme.constant + programme.unit * float(programme.linear @ answer.x)
        bound = programme.constant + programme.unit * answer.bound
        gap = max(linear - bound, 0.0) / max(abs(linear), 1e-9)
        why = "" if answer.optimal else f"highs: time limit, at most {gap:.1%} above the optimum"
        status = f"{status}, gap {gap:.2g}"
        return replace(solution, gap=gap, status=status, problem=why, optimal=answer.optimal)

    def _start(self, programme: QPData) -> Array | None:
        """The relaxation's levels with their choices rounded: what HiGHS improves on; None where it fails."""
        choices = self.model.choices
        relaxed = self._relax(programme) if choices.size else None
        if relaxed is None or not relaxed.solved:
            return None
        start = relaxed.x
        start[choices] = self.model.rounded(start)
        return start
