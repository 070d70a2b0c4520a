"""The statement as a nonlinear programme, solved by Ipopt (Wächter and Biegler 2006): the reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import Field

from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, accept_suboptimal, checked_variables, failed, not_finite
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.scenario.settings import StrictModel

# Statuses with which Ipopt reports an optimum, to its tolerance or to a looser one; any other is a failed solve.
_OPTIMAL, _ACCEPTED = "Solve_Succeeded", {"Solve_Succeeded", "Solved_To_Acceptable_Level"}
# Of a second try.
_CAREFUL = {"mehrotra_algorithm": "no"}


class IpoptConfig(StrictModel):
    """Options of Ipopt."""

    max_iterations: int = Field(200, ge=1, description="iterations before a solve counts as failed")
    tolerance: float = Field(1e-8, gt=0, description="Ipopt's overall tolerance")
    max_seconds: float = Field(20.0, gt=0, description="wall time before a solve counts as failed, s")


class IpoptSolver:
    """Solves `MPCProblem`s of one operator and shape with Ipopt.

    Choices between off and on are relaxed, rounded, and solved again as they are then: good, but not the best of all.

    Raises:
        ControllerConfigError: the operator is not of these actuators.
    """

    def __init__(self, operator: BuildingOperator, shape: ProblemShape, config: IpoptConfig) -> None:
        self.model, self.operator = PlanModel(operator, shape), operator
        self._options = {
            "print_level": 0,
            "sb": "yes",
            "max_iter": config.max_iterations,
            "tol": config.tolerance,
            "max_wall_time": config.max_seconds,
            # Predictor and corrector without a line search: fewer iterations where the problem is convex.
            "mehrotra_algorithm": "yes" if self.model.convex else "no",
            "mu_strategy": "adaptive",
            "min_refinement_steps": 0,
        }
        self.model.functions.ipopt(self._options)  # built once

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance from `guess` (A, N). On failure `ok` is False and `problem` has the reason.

        Where that fails, the solver starts cold, with a line search.
        """
        p = self.model.numbers(problem)
        if unfinished := not_finite(p):
            return unfinished
        cold = self.model.cold()
        solution = self._solve_from(problem, p, cold if guess is None else guess, guess, self._options)
        if solution.ok and solution.optimal:
            return solution
        again = self._solve_from(problem, p, cold, guess, self._options | _CAREFUL)
        return again if not solution.ok or (again.ok and again.optimal) else solution

    def _solve_from(
        self, problem: MPCProblem, p: Array, start: Array, previous: Array | None, options: Mapping[str, Any]
    ) -> Solution:
        """Solve from one guess (A, N); `previous`: the plan of the step before, which an iterate must not exceed."""
        model, (low, high) = self.model, self.model.bounds(p)
        x, claimed, status, iterations = self._ipopt(p, model.start(problem, p, start), low, high, options)
        if model.choices.size and status in _ACCEPTED:
            low[model.choices] = high[model.choices] = model.rounded(x)
            x, claimed, status, more = self._ipopt(p, np.clip(x, low, high), low, high, options)
            iterations += more
        said = f"ipopt:{status}"
        if status not in _ACCEPTED:
            ended = failed(said, iterations, f"Ipopt ended with {status}")
            return accept_suboptimal(model, problem, p, x, previous, ended)
        solution = checked_variables(model, problem, p, x, claimed, said, iterations)
        return solution if status == _OPTIMAL else replace(solution, optimal=False, problem=f"Ipopt: {status}")

    def _ipopt(
        self, p: Array, x: Array, low: Array, high: Array, options: Mapping[str, Any]
    ) -> tuple[Array, float, str, int]:
        """Variables, objective, status and iterations of one call."""
        n_rows, n_equal = self.model.functions.rows.size1_out(1), self.model.variables.n_equal
        upper = np.full(n_rows, np.inf)
        upper[:n_equal] = 0.0
        solver = self.model.functions.ipopt(options)
        with self.model.functions.busy:  # status and iterations are those of the call before
            found = solver(x0=x, p=p, lbx=low, ubx=high, lbg=np.zeros(n_rows), ubg=upper)
            stats = solver.stats()
        x = np.asarray(found["x"], dtype=np.float64).ravel()
        return x, float(found["f"]), str(stats["return_status"]), int(stats["iter_count"])
