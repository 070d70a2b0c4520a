"""The MPC problem as one parametric NLP over the exported operator, built once, re-solved by Ipopt (the reference)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from pydantic import Field

from controllers.problem import MPCProblem, Solution
from thermoforce_mpc.operator.casadi_export import step_function
from thermoforce_mpc.operator.features import N_FEATURES
from thermoforce_mpc.operator.parameters import OperatorParameters
from thermoforce_mpc.operator.rollout import forced_rollout
from thermoforce_mpc.testcase import StrictModel
from thermoforce_mpc.types import Array

# Statuses with which Ipopt claims an optimum; anything else is a failed solve, whatever it left in u.
_ACCEPTED = {"Solve_Succeeded", "Solved_To_Acceptable_Level"}
# Largest violation of 0 ≤ u ≤ u_max that is Ipopt's bound relaxation rather than an error.
_BOUND_TOLERANCE = 1e-6


class IpoptConfig(StrictModel):
    """Options of the solver."""

    max_iterations: int = Field(200, ge=1, description="iterations before a solve counts as failed")
    tolerance: float = Field(1e-8, gt=0, description="Ipopt's overall tolerance")
    max_seconds: float = Field(20.0, gt=0, description="wall time before a solve counts as failed, s")


class IpoptSolver:
    """Solves `MPCProblem`s of one operator, horizon and kind; keeps the last solution as the next first guess."""

    def __init__(
        self, operator: OperatorParameters, n_steps: int, u_max: float, lowest_level: float, config: IpoptConfig
    ) -> None:
        """Build the NLP for plans in [0, `u_max`] on a machine that switches below `lowest_level`."""
        self.operator, self.n_steps = operator, n_steps
        n, r = n_steps, operator.order
        # Without a kink inside the range, power and heat are linear in u and every derivative is constant.
        linear = lowest_level >= u_max
        heat = operator.actuator.heat
        linear_dynamics = heat is None or heat.lowest_level >= u_max
        step = step_function(operator)
        u, F, slack = ca.SX.sym("u", n), ca.SX.sym("F", r, n), ca.SX.sym("slack", n)
        F_now, features = ca.SX.sym("F_now", r), ca.SX.sym("features", n, N_FEATURES)
        T_free, lower, upper = ca.SX.sym("T_free", n), ca.SX.sym("lower", n), ca.SX.sym("upper", n)
        price_W, fixed, per_u = ca.SX.sym("price_W", n), ca.SX.sym("fixed", n), ca.SX.sym("per_u", n)
        comfort, curvature = ca.SX.sym("comfort"), ca.SX.sym("curvature")

        dynamics = []
        for k in range(n):
            before = F_now if k == 0 else F[:, k - 1]
            dynamics.append(F[:, k] - step(before, u[k], features[k, :].T))
        T = T_free + ca.sum1(F).T
        on_share = u / lowest_level if linear else ca.fmin(u / lowest_level, 1.0)
        power = fixed * on_share + per_u * u
        objective = ca.dot(price_W, power) + comfort * ca.sum1(slack) + curvature * ca.dot(u, u)
        decisions = ca.veccat(u, F, slack)
        parameters = ca.veccat(F_now, features, T_free, lower, upper, price_W, fixed, per_u, comfort, curvature)
        constraints = ca.veccat(*dynamics, T + slack - lower, upper - T + slack)
        options: dict[str, Any] = {
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": config.max_iterations,
                "tol": config.tolerance,
                "max_wall_time": config.max_seconds,
                "jac_c_constant": "yes" if linear_dynamics else "no",
                "jac_d_constant": "yes",
                "hessian_constant": "yes" if linear and linear_dynamics else "no",
            },
        }
        nlp = {"x": decisions, "p": parameters, "f": objective, "g": constraints}
        self._solver = ca.nlpsol("thermoforce_mpc", "ipopt", nlp, options)
        self._lbg = np.concatenate([np.zeros(n * r), np.zeros(2 * n)])
        self._ubg = np.concatenate([np.zeros(n * r), np.full(2 * n, np.inf)])
        # A kink makes the power concave in u and local optima possible. Its convex envelope on [0, u_max] is the
        # straight line, so the linear problem, which has one optimum, gives a first guess near the best one.
        on_off = replace(operator, actuator=operator.actuator.at_lowest_level(1.0))
        self._relaxed = None if linear else IpoptSolver(on_off, n_steps, u_max, u_max, config)
        self._guess: Array | None = None

    def solve(self, problem: MPCProblem) -> Solution:
        """Solve one instance. A failure is a value: `ok` is False and `problem` says why."""
        guesses = [np.full(self.n_steps, 0.3 * problem.u_max) if self._guess is None else self._guess]
        if self._relaxed:
            relaxed = self._relaxed.solve(straightened(problem))
            guesses += [relaxed.u] if relaxed.ok else []
        solutions = [self._solve_from(problem, guess) for guess in guesses]
        good = [solution for solution in solutions if solution.ok]
        if not good:
            self._guess = None
            return solutions[0]
        best = min(good, key=lambda solution: float(problem.cost(self.operator, solution.u)))
        self._guess = np.append(best.u[1:], best.u[-1])
        return best

    def _solve_from(self, problem: MPCProblem, u_guess: Array) -> Solution:
        p = problem
        n, r = self.n_steps, self.operator.order
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
                [p.comfort_price, p.weights.curvature],
            ]
        )
        if not np.isfinite(parameters).all():
            return Solution(False, np.empty(0), "not started", 0, "the problem holds numbers that are not finite")
        result = self._solver(
            x0=self._complete(p, u_guess),
            p=parameters,
            lbx=np.concatenate([np.zeros(n), np.full(n * r, -np.inf), np.zeros(n)]),
            ubx=np.concatenate([np.full(n, p.u_max), np.full(n * r + n, np.inf)]),
            lbg=self._lbg,
            ubg=self._ubg,
        )
        stats = self._solver.stats()
        status, iterations = str(stats["return_status"]), int(stats["iter_count"])
        u = np.asarray(result["x"], dtype=np.float64).ravel()[:n]
        trouble = self._trouble(status, u, p.u_max)
        if trouble:
            return Solution(False, np.empty(0), status, iterations, trouble)
        return Solution(True, np.clip(u, 0.0, p.u_max), status, iterations)

    def _complete(self, problem: MPCProblem, u: Array) -> Array:
        """A first guess for all variables that is consistent with `u`."""
        F = forced_rollout(self.operator, problem.forced_state_K, u, problem.features)
        slack = problem.slack_K(problem.T_free_C + F.sum(axis=-1))
        return np.concatenate([u, F.ravel(), slack])

    @staticmethod
    def _trouble(status: str, u: Array, u_max: float) -> str:
        if status not in _ACCEPTED:
            return f"Ipopt ended with {status}"
        if not np.isfinite(u).all():
            return f"Ipopt reported {status} but the solution is not finite"
        if u.min() < -_BOUND_TOLERANCE or u.max() > u_max + _BOUND_TOLERANCE:
            return f"Ipopt reported {status} but u leaves its bounds (from {u.min():.4g} to {u.max():.4g})"
        return ""


def straightened(problem: MPCProblem) -> MPCProblem:
    """The problem with its power replaced by the straight line from off to `u_max`: its convex envelope in u."""
    full = problem.power_W(np.full(problem.n_steps, problem.u_max))
    return replace(
        problem,
        power_fixed_W=np.zeros(problem.n_steps),
        power_per_u_W=full / problem.u_max,
        lowest_level=problem.u_max,
    )
