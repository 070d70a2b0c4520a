"""Random MPC problems, and their optimum found another way where they are linear programmes."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog, minimize

from controllers.problem import MPCProblem, Weights
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.parameters import OperatorParameters, linear_operator

N = 12


def random_operator(rng: np.random.Generator, order: int) -> OperatorParameters:
    base = linear_operator(np.linspace(0.3, 0.97, order), rng.uniform(0.1, 0.5, order), step_s=3600.0)
    return OperatorParameters(
        **{
            **{name: getattr(base, name) for name in base.__dataclass_fields__},
            "hidden_weight": rng.normal(size=(32, 4)),
            "hidden_bias": rng.normal(size=32),
            "output_weight": rng.normal(size=32) / 6,
            "feature_mean": np.array([10.0, 5.0, 100.0, 0.0]),
            "feature_scale": np.array([3.0, 5.0, 100.0, 0.7]),
        }
    )


def random_problem(
    rng: np.random.Generator, order: int, lowest: float = 1.0, curvature: float = 0.0, n: int = N
) -> MPCProblem:
    return MPCProblem(
        forced_state_K=rng.uniform(0, 5, order),
        features=rng.normal([10, 5, 100, 0], [3, 5, 100, 0.7], (n, 4)),
        T_free_C=rng.uniform(12, 16, n),
        lower_C=np.where(np.arange(n) % 5 < 3, 21.0, 15.0),
        upper_C=np.full(n, 24.0),
        price_per_kWh=rng.uniform(0.1, 0.4, n),
        power_fixed_W=rng.uniform(1000, 2000, n),
        power_per_u_W=rng.uniform(2000, 3000, n),
        step_s=3600.0,
        u_max=1.0,
        lowest_level=lowest,
        weights=Weights(5.0, curvature),
        terminal_price_per_K=np.zeros(order),
    )


def linear_programme_optimum(problem: MPCProblem, operator: OperatorParameters) -> float:
    """The same problem condensed and solved by HiGHS: the effect of each u is a column of unit responses."""
    at_rest = problem.forced_K(operator, np.zeros(N))
    effect = np.stack([problem.forced_K(operator, row) - at_rest for row in np.eye(N)], axis=1)
    T_rest = problem.T_free_C + at_rest
    cost = np.concatenate([problem.price_per_W * problem.power_W(np.ones(N)), np.full(N, problem.comfort_price)])
    A = np.block([[-effect, -np.eye(N)], [effect, -np.eye(N)]])
    b = np.concatenate([T_rest - problem.lower_C, problem.upper_C - T_rest])
    bounds = [(0, 1)] * N + [(0, None)] * N
    return float(linprog(cost, A_ub=A, b_ub=b, bounds=bounds, method="highs").fun)


def multi_start_optimum(
    problem: MPCProblem, operator: OperatorParameters, rng: np.random.Generator, starts: int
) -> float:
    """The same problem by sequential quadratic programming (SLSQP) over levels and slack, from random levels; the best.

    Where the gain sees the plan there is more than one local optimum, so this is a bound from above.
    """
    n = problem.n_steps

    def room_K(x: Array) -> Array:
        T = problem.T_free_C + problem.forced_K(operator, x[:n])
        return np.concatenate([T - problem.lower_C, problem.upper_C - T]) + np.tile(x[n:], 2)

    def cost(x: Array) -> float:
        energy = problem.price_per_W @ problem.power_W(x[:n])
        return float(energy + problem.comfort_price * x[n:].sum() + problem.weights.curvature * (x[:n] ** 2).sum())

    best = np.inf
    for _ in range(starts):
        u = rng.uniform(0, 1, n)
        x0 = np.concatenate([u, problem.slack_K(problem.T_free_C + problem.forced_K(operator, u))])
        bounds = [(0, problem.u_max)] * n + [(0, None)] * n
        constraint = {"type": "ineq", "fun": room_K}
        found = minimize(cost, x0, method="SLSQP", bounds=bounds, constraints=[constraint], options={"maxiter": 300})
        best = min(best, float(problem.cost(operator, np.clip(found.x[:n], 0, problem.u_max))))
    return best
