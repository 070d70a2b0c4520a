"""Random MPC problems, and their optimum found another way where they are linear programmes."""

from __future__ import annotations

import numpy as np
import numpy_problem
from scipy.optimize import linprog, minimize

from controllers.optimisation.problem import EquipmentLayout, MPCProblem, Weights
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
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
    """One zone with one actuator."""
    return MPCProblem(
        forced_state_K=rng.uniform(0, 5, (1, 1, order)),
        features=rng.normal([10, 5, 100, 0], [3, 5, 100, 0.7], (1, n, 4)),
        T_free_C=rng.uniform(12, 16, (1, n)),
        lower_C=np.where(np.arange(n) % 5 < 3, 21.0, 15.0)[None],
        upper_C=np.full((1, n), 24.0),
        price_per_kWh=rng.uniform(0.1, 0.4, (1, n)),
        power_fixed_W=rng.uniform(1000, 2000, (1, n)),
        power_per_u_W=rng.uniform(2000, 3000, (1, n)),
        step_s=3600.0,
        machinery=EquipmentLayout.one(lowest_level=lowest),
        weights=Weights(5.0, curvature),
    )


def unit_responses(problem: MPCProblem, operator: BuildingOperator) -> tuple[Array, Array]:
    """Zone temperature without heat (N,), and what each u adds to it in columns (N, N); one zone and actuator."""
    at_rest = numpy_problem.forced_K(problem, operator, np.zeros((1, N)))[0]
    effect = np.stack([numpy_problem.forced_K(problem, operator, row[None])[0] - at_rest for row in np.eye(N)], axis=1)
    return problem.T_free_C[0] + at_rest, effect


def linear_programme_optimum(problem: MPCProblem, operator: BuildingOperator) -> float:
    """The same problem condensed and solved by HiGHS: the effect of each u is a column of unit responses."""
    T_rest, effect = unit_responses(problem, operator)
    cost = np.concatenate([numpy_problem.energy_cost(problem, np.ones((1, N))), np.full(N, problem.comfort_price[0])])
    A = np.block([[-effect, -np.eye(N)], [effect, -np.eye(N)]])
    b = np.concatenate([T_rest - problem.lower_C[0], problem.upper_C[0] - T_rest])
    bounds = [(0, 1)] * N + [(0, None)] * N
    return float(linprog(cost, A_ub=A, b_ub=b, bounds=bounds, method="highs").fun)


def multi_start_optimum(
    problem: MPCProblem, operator: BuildingOperator, rng: np.random.Generator, starts: int
) -> float:
    """The same problem by sequential quadratic programming (SLSQP) over levels and slack, from random levels; the best.

    Where the gain sees the plan there is more than one local optimum, so this is a bound from above.
    """
    n, highest = problem.n_steps, float(problem.machinery.u_max[0])

    def zone_C(u: Array) -> Array:
        return problem.T_free_C + numpy_problem.forced_K(problem, operator, u[None])

    def room_K(x: Array) -> Array:
        T = zone_C(x[:n])[0]
        return np.concatenate([T - problem.lower_C[0], problem.upper_C[0] - T]) + np.tile(x[n:], 2)

    def cost(x: Array) -> float:
        energy, comfort = numpy_problem.energy_cost(problem, x[None, :n]).sum(), problem.comfort_price[0] * x[n:].sum()
        return float(energy + comfort + problem.weights.curvature * (x[:n] ** 2).sum())

    best = np.inf
    for _ in range(starts):
        u = rng.uniform(0, 1, n)
        x0 = np.concatenate([u, numpy_problem.slack_K(problem, zone_C(u))[0]])
        bounds = [(0, highest)] * n + [(0, None)] * n
        constraint = {"type": "ineq", "fun": room_K}
        found = minimize(cost, x0, method="SLSQP", bounds=bounds, constraints=[constraint], options={"maxiter": 300})
        best = min(best, float(numpy_problem.cost(problem, operator, np.clip(found.x[None, :n], 0, highest))))
    return best


def random_building(
    rng: np.random.Generator,
    zones: int,
    signs: tuple[int, ...],
    order: int = 2,
    *,
    reach: float = 1.0,
    own_poles: bool = False,
    heat: HeatInput = IDENTITY,
) -> BuildingOperator:
    """Zones with actuators of these signs, each at home in one zone; it reaches others with probability `reach`."""
    rows = []
    home = tuple(a % zones for a in range(len(signs)))
    for z in range(zones):
        row: list[OperatorParameters | None] = []
        for a, sign in enumerate(signs):
            poles = np.linspace(0.3, 0.97, order) * (rng.uniform(0.9, 1.0) if own_poles else 1.0)
            gains = sign * rng.uniform(0.1, 0.5, order) * (1.0 if z == home[a] else 0.2)
            pair = linear_operator(poles, gains, step_s=3600.0, sign=sign, heat_input=heat)
            row.append(pair if z == home[a] or rng.uniform() < reach else None)
        rows.append(tuple(row))
    names = tuple(f"zone {z}" for z in range(zones)), tuple(f"actuator {a}" for a in range(len(signs)))
    return BuildingOperator(*names, tuple(rows), home)


def machinery_of(operator: BuildingOperator, machine_of: tuple[int, ...], **options) -> EquipmentLayout:
    """Machines for the actuators of a building, by default in blocks and without limit of capacity."""
    ones = np.ones(len(operator.actuators))
    names = tuple(f"machine {m}" for m in range(max(machine_of) + 1))
    defaults = {"u_max": ones, "lowest_level": ones, "u_min": 0 * ones, "share": 0 * ones}
    return EquipmentLayout(operator.actuators, names, machine_of=np.array(machine_of), **(defaults | options))


def random_building_problem(
    rng: np.random.Generator, operator: BuildingOperator, machinery: EquipmentLayout, n: int = N, **options
) -> MPCProblem:
    """Zones that are too cold at first and too warm later."""
    (Z, A, r), M = operator.shape, len(machinery.machines)
    sign = operator.signs[:, None]
    warm = np.where(np.arange(n) < n // 2, rng.uniform(12, 18, (Z, n)), rng.uniform(23, 28, (Z, n)))
    numbers = {
        "forced_state_K": rng.uniform(0, 1, (Z, A, r)) * sign * (operator.gains != 0),
        "features": rng.normal([10, 5, 100, 0], [3, 5, 100, 0.7], (Z, n, 4)),
        "T_free_C": warm,
        "lower_C": np.where(np.arange(n) % 5 < 3, 21.0, 15.0) * np.ones((Z, 1)),
        "upper_C": np.full((Z, n), 24.0),
        "price_per_kWh": rng.uniform(0.1, 0.4, (M, n)),
        "power_fixed_W": rng.uniform(500, 1000, (M, n)),
        "power_per_u_W": rng.uniform(1000, 2000, (A, n)),
        "weights": Weights(rng.uniform(2.0, 6.0, Z), 1e-6),
    }
    return MPCProblem(**(numbers | {"step_s": 3600.0, "machinery": machinery} | options))
