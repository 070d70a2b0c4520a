"""Sequential quadratic programming on the statement, where the gain sees the plan.

Every iterate is a rollout: all that could make levels infeasible is soft, so the objective of the levels themselves is
the merit. A step is the programme with the second derivatives of the Lagrangian, in which a proximal term keeps levels
near those of the iterate where the local model promises more than the rollout gives (Nocedal and Wright 2006, ch. 18).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from pydantic import Field

from controllers.checks import ControllerConfigError
from controllers.optimisation.problem import ProblemShape
from controllers.optimisation.solution import Solver, SolverAnswer, StatementSolver
from controllers.optimisation.solvers.qp import Piqp, QPConfig
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.scenario.settings import StrictModel

# Share of the promised gain that a step must bring, and lengths that are tried. The usual ones of line searches
# (Nocedal and Wright 2006, 3.1).
_ENOUGH, _LENGTHS = 1e-2, (1.0, 0.5, 0.2)
# Proximal terms, as a share of the largest slope: the first one, and the one from which there is no progress.
_LEAST, _MOST = 1e-3, 1e6


class SQPConfig(StrictModel):
    """Options of sequential quadratic programming."""

    # Each takes milliseconds, so that all of them stay far below the deadline of a step.
    max_iterations: int = Field(60, ge=1, description="quadratic programmes before a solve counts as failed")
    # As exact as costs are compared (`_LEAVES` of `optimisation.solution`).
    tolerance: float = Field(1e-7, gt=0, description="relative gain of a step below which it is the optimum")


class SQPSolver(StatementSolver):
    """By quadratic programmes, each about the rollout of the last one's levels; the problem must hold no choices."""

    name = "sqp"

    def __init__(
        self,
        operator: BuildingOperator,
        shape: ProblemShape,
        config: SQPConfig,
        qp: QPConfig | None = None,
        fallback: Callable[[], Solver] | None = None,
    ) -> None:
        super().__init__(operator, shape, fallback)
        self._config, self._qp = config, qp or QPConfig()
        if self.model.structure.chosen:
            raise ControllerConfigError("solver sqp: choices between off and on need solver: milp or ipopt")
        self._near = np.zeros(self.model.n_variables)
        self._near[self.model.levels_at] = self._near[self.model.own_at] = 1.0

    def _answers(self, p: Array, guess: Array | None) -> Iterator[SolverAnswer]:
        model, solver = self.model, Piqp(self._qp)
        own = np.clip(0.0, *model.bounds(p))[model.own_at]
        begun = model.evaluate(p, model.cold() if guess is None else guess, own)
        x, multipliers, near = begun.variables, None, 0.0
        cost = model.evaluate(p, model.levels(x), own).cost
        for iteration in range(1, self._config.max_iterations + 1):
            programme = model.local(p, x, multipliers)
            answer = solver(programme.near(near * self._near))
            promised = programme.constant - programme.objective(answer.x)
            if answer.solved and promised <= self._config.tolerance * (1.0 + abs(cost)):
                found_at = programme.unit * answer.multipliers
                yield SolverAnswer(x, cost, "sqp:converged", iteration, multipliers=found_at)
                return
            found = self._shorter(p, x, answer.x, cost - _ENOUGH * promised) if answer.solved else None
            if found is None:
                near = max(_LEAST, 10.0 * near)
                if near > _MOST:
                    why = "sqp: no step brings what the local model promises"
                    yield SolverAnswer(x, None, "sqp:stalled", iteration, why)
                    return
                continue
            x, cost, length = found
            multipliers = programme.unit * answer.multipliers
            near = 0.1 * near if length == 1.0 and near > _LEAST else (near if length < 1.0 else 0.0)
        yield SolverAnswer(
            x, None, "sqp:iterations", self._config.max_iterations, "sqp: no optimum within its iterations"
        )

    def _shorter(self, p: Array, x: Array, step: Array, at_most: float) -> tuple[Array, float, float] | None:
        """The rollout, its cost and the length of the longest step that costs at most `at_most`; None without one."""
        model = self.model
        for length in _LENGTHS:
            moved = x + length * step
            u, own = model.levels(moved), model.own(p, moved)
            found = model.evaluate(p, u, own)
            if found.cost <= at_most and not found.broken:
                return found.variables, found.cost, length
        return None
