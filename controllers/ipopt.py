"""The MPC problem as a parametric NLP over the exported CasADi operator, built once and solved by Ipopt (reference)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from pydantic import Field

from controllers.problem import PEAK_UNIT_W, MPCProblem, ProblemShape, Solution, checked_solution
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.casadi_export import step_function
from thermoforce_mpc.model.operator.features import N_FEATURES
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.scenario.settings import StrictModel

# Statuses with which Ipopt reports an optimum; any other is a failed solve.
_ACCEPTED = {"Solve_Succeeded", "Solved_To_Acceptable_Level"}


class IpoptConfig(StrictModel):
    """Options of Ipopt."""

    max_iterations: int = Field(200, ge=1, description="iterations before a solve counts as failed")
    tolerance: float = Field(1e-8, gt=0, description="Ipopt's overall tolerance")
    max_seconds: float = Field(20.0, gt=0, description="wall time before a solve counts as failed, s")


class IpoptSolver:
    """Solves `MPCProblem`s of one operator and shape with Ipopt."""

    def __init__(self, operator: OperatorParameters, shape: ProblemShape, config: IpoptConfig) -> None:
        """Build the NLP once."""
        self.operator, self.shape = operator, shape
        n, r, m = shape.n_steps, operator.order, shape.n_moves
        # Power is linear in u without a kink inside the range; the dynamics are linear if also heat is and the gain
        # does not depend on the decisions. Only then are the derivatives constant.
        linear = shape.lowest_level >= shape.u_max
        heat = operator.heat_input.heat
        linear_dynamics = not operator.feedback_active and (heat is None or heat.lowest_level >= shape.u_max)
        step = step_function(operator)
        v, F, slack, peak = ca.SX.sym("v", m), ca.SX.sym("F", r, n), ca.SX.sym("slack", n), ca.SX.sym("peak")
        F_now, features = ca.SX.sym("F_now", r), ca.SX.sym("features", n, N_FEATURES)
        T_free, lower, upper = ca.SX.sym("T_free", n), ca.SX.sym("lower", n), ca.SX.sym("upper", n)
        price_W, fixed, per_u = ca.SX.sym("price_W", n), ca.SX.sym("fixed", n), ca.SX.sym("per_u", n)
        weights, terminal, reached = ca.SX.sym("weights", 3), ca.SX.sym("terminal", r), ca.SX.sym("reached")

        u = ca.vertcat(*[v[j] for j in shape.move_of_step.tolist()])
        dynamics = []
        for k in range(n):
            before = F_now if k == 0 else F[:, k - 1]
            dynamics.append(F[:, k] - step(before, u[k], features[k, :].T))
        T = T_free + ca.sum1(F).T
        on_share = u / shape.lowest_level if linear else ca.fmin(u / shape.lowest_level, 1.0)
        power = fixed * on_share + per_u * u
        objective = ca.dot(price_W, power) + weights[0] * ca.sum1(slack) + weights[1] * ca.dot(u, u)
        objective -= ca.dot(terminal, F[:, n - 1])
        decisions = [v, ca.vec(F), slack]
        constraints = [*dynamics, T + slack - lower, upper - T + slack]
        if shape.peak:
            objective += weights[2] * peak
            decisions.append(peak)
            constraints.append((reached + peak - power) / PEAK_UNIT_W)
        parameters = ca.veccat(
            F_now, features, T_free, lower, upper, price_W, fixed, per_u, weights, terminal, reached
        )  # fmt: skip
        options: dict[str, Any] = {
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": config.max_iterations,
                "tol": config.tolerance,
                "max_wall_time": config.max_seconds,
                "jac_c_constant": "yes" if linear_dynamics else "no",
                "jac_d_constant": "yes" if linear or not shape.peak else "no",
                "hessian_constant": "yes" if linear and linear_dynamics else "no",
            },
        }
        nlp = {"x": ca.veccat(*decisions), "p": parameters, "f": objective, "g": ca.veccat(*constraints)}
        self._solver = ca.nlpsol("thermoforce_mpc", "ipopt", nlp, options)
        free, extra = np.full(n * r, np.inf), 1 if shape.peak else 0
        self._lbx = np.concatenate([np.zeros(m), -free, np.zeros(n + extra)])
        self._ubx = np.concatenate([np.full(m, shape.u_max), free, np.full(n + extra, np.inf)])
        self._lbg = np.zeros(n * r + (2 + extra) * n)
        self._ubg = np.concatenate([np.zeros(n * r), np.full((2 + extra) * n, np.inf)])
        # A kink makes the power concave in u, so local optima are possible. Its convex envelope on [0, u_max] is the
        # straight line; that problem has one optimum, which is used as a second initial guess.
        on_off = replace(operator, heat_input=operator.heat_input.at_lowest_level(1.0))
        straight = replace(shape, lowest_level=shape.u_max)
        self._relaxed = None if linear else IpoptSolver(on_off, straight, config)

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance from `guess` (N,). On failure `ok` is False and `problem` has the reason."""
        guesses = [np.full(problem.n_steps, 0.3 * problem.u_max) if guess is None else guess]
        if self._relaxed:
            relaxed = self._relaxed.solve(straightened(problem), guess)
            guesses += [relaxed.u] if relaxed.ok else []
        solutions = [self._solve_from(problem, guess) for guess in guesses]
        good = [solution for solution in solutions if solution.ok]
        if not good:
            return solutions[0]
        return min(good, key=lambda solution: float(problem.cost(self.operator, solution.u)))

    def _solve_from(self, problem: MPCProblem, u_guess: Array) -> Solution:
        p = problem
        if not p.finite():
            return Solution(False, np.empty(0), "not started", 0, "the problem holds numbers that are not finite")
        parameters = np.concatenate(
            [
                p.forced_state_K,
                p.features.ravel(order="F"),
                p.T_free_C,
                p.lower_C,
                p.upper_C,
                p.price_per_W,
                p.power_fixed_W,
                p.power_per_u_W,
                [p.comfort_price, p.weights.curvature, p.weights.peak],
                p.terminal_price_per_K,
                [p.peak_so_far_W],
            ]
        )
        result = self._solver(
            x0=self._complete(p, u_guess), p=parameters, lbx=self._lbx, ubx=self._ubx, lbg=self._lbg, ubg=self._ubg
        )
        stats = self._solver.stats()
        status, iterations = str(stats["return_status"]), int(stats["iter_count"])
        if status not in _ACCEPTED:
            return Solution(False, np.empty(0), status, iterations, f"Ipopt ended with {status}")
        moves = np.asarray(result["x"], dtype=np.float64).ravel()[: self.shape.n_moves]
        u = moves[self.shape.move_of_step]
        return checked_solution(p, partial(p.modes_K, self.operator), u, float(result["f"]), status, iterations)

    def _complete(self, problem: MPCProblem, u: Array) -> Array:
        """Initial guess for all variables, consistent with the first level of `u` (N,) in each move."""
        moves = u[self.shape.first_steps]
        u = moves[self.shape.move_of_step]
        F = problem.modes_K(self.operator, u)
        slack = problem.slack_K(problem.T_free_C + F.sum(axis=-1))
        peak = [max(float(problem.power_W(u).max()) - problem.peak_so_far_W, 0.0)] if self.shape.peak else []
        return np.concatenate([moves, F.ravel(), slack, peak])


def straightened(problem: MPCProblem) -> MPCProblem:
    """The problem with the power replaced by its convex envelope in u, the straight line from 0 to `u_max`."""
    full = problem.power_W(np.full(problem.n_steps, problem.u_max))
    return replace(
        problem,
        power_fixed_W=np.zeros(problem.n_steps),
        power_per_u_W=full / problem.u_max,
        lowest_level=problem.u_max,
    )
