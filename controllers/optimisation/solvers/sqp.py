"""Sequential quadratic programming on the statement, where the gain sees the plan.

Every iterate is a rollout: all that could make levels infeasible is soft, so the objective of the levels themselves is
the merit. A step is the programme with the second derivatives of the Lagrangian, in which a proximal term keeps levels
near those of the iterate where the local model promises more than the rollout gives (Nocedal and Wright 2006, ch. 18).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field
from scipy import sparse

from controllers.checks import ControllerConfigError
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, checked_solution, failed, not_finite
from controllers.optimisation.solvers.qp_backends import Piqp, QPConfig, QPData
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.scenario.settings import StrictModel

# Share of the promised gain that a step must bring, and lengths that are tried.
_ENOUGH, _LENGTHS = 1e-2, (1.0, 0.5, 0.2)
# Proximal terms, as a share of the largest slope: the first one, and the one from which there is no progress.
_LEAST, _MOST = 1e-3, 1e6


class SQPConfig(StrictModel):
    """Options of sequential quadratic programming."""

    max_iterations: int = Field(60, ge=1, description="quadratic programmes before a solve counts as failed")
    tolerance: float = Field(1e-7, gt=0, description="relative gain of a step below which it is the optimum")


class SQPSolver:
    """Solves `MPCProblem`s of one operator and shape.

    Raises:
        ControllerConfigError: the problem holds choices, or the operator is not of these actuators.
    """

    def __init__(
        self, operator: BuildingOperator, shape: ProblemShape, config: SQPConfig, qp: QPConfig | None = None
    ) -> None:
        self.model, self.operator, self._config = PlanModel(operator, shape), operator, config
        self._qp = qp or QPConfig()
        if self.model.structure.chosen:
            raise ControllerConfigError("solver sqp: choices between off and on need solver: milp or ipopt")
        places = np.concatenate([self.model.levels_at.ravel(), self.model.own_at]).astype(np.intp)
        pattern = np.zeros(self.model.n_variables)
        pattern[places] = 1.0
        self._near = sparse.diags(pattern, format="csc")

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance from `guess` (A, N). On failure `ok` is False and `problem` has the reason."""
        model, p = self.model, self.model.numbers(problem)
        if unfinished := not_finite(p):
            return unfinished
        own = np.clip(0.0, model.x_low, model.x_high)[model.own_at]
        u, solver = model.cold() if guess is None else guess, Piqp(self._qp)
        x = model.start(problem, p, u, own)
        cost, multipliers, near = model.evaluate(problem, p, model.levels(x), own).cost, None, 0.0
        for iteration in range(1, self._config.max_iterations + 1):
            programme = model.local(p, x, multipliers)
            answer = solver(self._kept_near(programme, near))
            promised = -programme.unit * float(
                programme.linear @ answer.x + 0.5 * answer.x @ (programme.quadratic @ answer.x)
            )
            if answer.solved and promised <= self._config.tolerance * (1.0 + abs(cost)):
                u = model.levels(x)
                return checked_solution(model, problem, p, u, cost, "sqp:converged", iteration, model.own(x))
            found = self._shorter(problem, p, x, answer.x, cost - _ENOUGH * promised) if answer.solved else None
            if found is None:
                near = max(_LEAST, 10.0 * near)
                if near > _MOST:
                    return failed("sqp:stalled", iteration, "sqp: no step brings what the local model promises")
                continue
            x, cost, length = found
            multipliers = programme.unit * answer.multipliers
            near = 0.1 * near if length == 1.0 and near > _LEAST else (near if length < 1.0 else 0.0)
        return failed("sqp:iterations", self._config.max_iterations, "sqp: no optimum within its iterations")

    def _shorter(
        self, problem: MPCProblem, p: Array, x: Array, step: Array, at_most: float
    ) -> tuple[Array, float, float] | None:
        """The rollout, its cost and the length of the longest step that costs at most `at_most`; None without one."""
        model = self.model
        for length in _LENGTHS:
            moved = x + length * step
            u, own = model.levels(moved), model.own(moved)
            found = model.evaluate(problem, p, u, own)
            if found.cost <= at_most and not found.broken:
                return model.start(problem, p, u, own), found.cost, length
        return None

    def _kept_near(self, programme: QPData, near: float) -> QPData:
        """The programme with the proximal term."""
        return replace(programme, quadratic=sparse.csc_matrix(programme.quadratic + near * self._near))
