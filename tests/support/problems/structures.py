"""A random instance of every structure that the statement of a plan knows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from mpc_problems import machinery_of, random_building, random_building_problem, random_operator

from controllers.optimisation.problem import Cooling, Exchange, MPCProblem, PowerCap, ProblemShape, every_step
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters

HEAT = MachineLoad((1100.0, 30.0, 9000.0, 100.0), (-15.0, 20.0))


@dataclass(frozen=True)
class Case:
    """What an instance has. By default one zone whose actuator runs in blocks, with value of heat at the end.

    `machinery`: options of `EquipmentLayout`. `heat`: actuators whose heat is measured. `signed`: one that cools below
    0. `blocked`: lengths of moves. `capacity`: whether it differs from step to step.
    """

    zones: int = 1
    signs: tuple[int, ...] = (1,)
    machine_of: tuple[int, ...] = (0,)
    order: int = 2
    building: dict[str, Any] = field(default_factory=dict)
    machinery: dict[str, Any] = field(default_factory=dict)
    heat: tuple[int, ...] = ()
    signed: int | None = None
    feedback: bool = False
    peak: bool = False
    capped: bool = False
    bend: bool = False
    capacity: bool = False
    negative_price: bool = False
    chosen_steps: int | None = None
    blocked: tuple[int, ...] = ()
    convex: bool = True
    exchange: bool = False


TWO: dict[str, Any] = {"zones": 2, "signs": (1, 1), "machine_of": (0, 0)}
SEVERAL: dict[str, Any] = {"zones": 3, "signs": (1, 1, 1, -1), "machine_of": (0, 0, 1, 2)}
SHARES = {"share": (0.7, 0.6, 0.0, 0.5)}
STEPPED: dict[str, Any] = {"machinery": {"lowest_level": [0.3]}, "heat": (0,)}
EXCLUSIVE = {"exclusive": ((0, 1),)}
CASES = {
    "one zone": Case(order=3),
    "one zone, modes beyond the horizon": Case(order=3, blocked=(1, 1)),
    "one zone whose heat is measured": Case(heat=(0,)),
    "blocked": Case(blocked=(1, 1, 1, 2, 3)),
    "one below full level": Case(machinery={"u_max": [0.8]}),
    "several": Case(**SEVERAL),
    "several with poles of their own": Case(**SEVERAL, building={"own_poles": True}),
    "several with few cross effects": Case(**SEVERAL, order=3, building={"reach": 0.4}),
    "shared machine": Case(**TWO),
    "shared machine at negative prices": Case(**TWO, negative_price=True),
    "shared with capacity": Case(**TWO, machinery={"share": [0.9, 0.8]}),
    "shared with capacity by step": Case(**TWO, machinery={"share": [0.9, 0.8]}, capacity=True, blocked=(1, 1, 2, 2)),
    "two machines that are shared": Case(
        3, (1, 1, 1, -1), (0, 1, 0, 1), machinery={"share": [0.3, 0.6, 0.2, 0.5], "cycles_below": (0.6, 0.9)}
    ),
    "cycles, split": Case(**TWO, machinery={"share": [0.3, 0.4], "cycles_below": (0.5,)}),
    "cycles, not split": Case(**TWO, machinery={"share": [0.2, 0.3], "cycles_below": (0.7,)}),
    "cycles for some": Case(
        3, (1, 1, 1), (0, 0, 0), machinery={"share": [0.15, 0.3, 0.4], "cycles_below": (0.35,)}, blocked=(1, 1, 2, 2)
    ),
    "capacity below its share": Case(machinery={"share": [1.3]}, capacity=True),
    "signed": Case(signed=0),
    "signed beside others": Case(2, (1, 1, -1), (0, 0, 1), machinery={"share": [0.6, 0.8, 0.0]}, signed=1, peak=True),
    "peak": Case(peak=True),
    "cap": Case(**SEVERAL, capped=True),
    "own generation": Case(**SEVERAL, exchange=True),
    "own generation, a peak and blocked moves": Case(**TWO, exchange=True, peak=True, blocked=(1, 1, 2, 2)),
    "power over u² beside own generation": Case(**TWO, bend=True, exchange=True, convex=False),
    "power over u²": Case(**TWO, bend=True, negative_price=True),
    "power over u² under a cap": Case(**TWO, bend=True, capped=True, convex=False),
    "power over u² in the peak": Case(bend=True, peak=True, convex=False),
    "stepped": Case(**STEPPED),
    "stepped, blocked": Case(**STEPPED, blocked=(1, 1, 2, 2, 2)),
    "stepped below full level": Case(machinery={"lowest_level": [0.3], "u_max": [0.8]}, heat=(0,)),
    "stepped within a capacity": Case(machinery={"lowest_level": [0.3], "share": [1.3]}, heat=(0,), capacity=True),
    "stepped, power over u²": Case(machinery={"lowest_level": [0.8]}, bend=True),
    "stepped, power over u², of measured heat": Case(**STEPPED, bend=True, blocked=(1, 1, 2, 2, 2)),
    "stepped at negative prices": Case(**STEPPED, negative_price=True),
    "stepped at negative prices, power over u²": Case(
        machinery={"lowest_level": [0.7]}, heat=(0,), bend=True, negative_price=True, blocked=(1, 1, 2, 2, 2)
    ),
    "stepped beside others": Case(**SEVERAL, machinery={"lowest_level": [1.0, 1.0, 0.4, 0.7]}, heat=(2,), bend=True),
    "stepped under a cap": Case(**STEPPED, capped=True),
    "two stepped under a cap, power over u²": Case(
        2, (1, 1), (0, 1), machinery={"lowest_level": [0.3, 0.7]}, heat=(0,), capped=True, bend=True, convex=False
    ),
    "stepped in the peak": Case(machinery={"lowest_level": [0.7]}, peak=True, bend=True, convex=False),
    "exclusive": Case(2, (1, -1), (0, 1), machinery=EXCLUSIVE),
    "exclusive at first": Case(2, (1, -1), (0, 1), machinery=EXCLUSIVE, chosen_steps=2, blocked=(1, 1, 2, 2)),
    "exclusive and signed": Case(2, (1, 1), (0, 1), machinery=EXCLUSIVE, signed=0, chosen_steps=2),
    "one stepped and one in blocks exclude one another": Case(
        2, (1, 1), (0, 1), machinery={"lowest_level": [0.3, 1.0]} | EXCLUSIVE, heat=(0,), chosen_steps=2
    ),
    "feedback": Case(feedback=True, convex=False),
    "feedback with a priced peak": Case(feedback=True, peak=True, blocked=(1, 1, 2, 2), convex=False),
    "feedback, stepped": Case(**STEPPED, feedback=True, blocked=(1, 1, 2, 2), convex=False),
    "everything convex": Case(
        **SEVERAL, machinery=SHARES | {"cycles_below": (0.9, 0.0, 0.0), "lowest_level": [1.0, 1.0, 1.0, 0.4]}, signed=2,
        peak=True, capped=True, capacity=True, blocked=(1, 1, 1, 2, 3),
    ),
    "everything": Case(
        **SEVERAL, machinery=SHARES | {"cycles_below": (0.9, 0.0, 0.0), "exclusive": ((2, 3),), "lowest_level":
        [1.0, 1.0, 1.0, 0.4]}, signed=2, peak=True, capped=True, bend=True, capacity=True, chosen_steps=3,
        blocked=(1, 2, 1, 2), convex=False,
    ),
}  # fmt: skip


def instance(case: Case, rng: np.random.Generator) -> tuple[BuildingOperator, MPCProblem, ProblemShape]:
    """Operator, problem and shape, with a gain that depends on the weather."""
    moves = np.repeat(np.arange(len(case.blocked)), case.blocked) if case.blocked else every_step(9)
    n, M, A = moves.size, max(case.machine_of) + 1, len(case.signs)
    base = random_building(rng, case.zones, case.signs, case.order, **case.building)
    networks = [random_operator(rng, 1) for _ in range(A)]

    def changed(a: int, pair: OperatorParameters) -> OperatorParameters:
        heat = HeatInput(u_min=-0.6) if a == case.signed else IDENTITY
        if a in case.heat:
            lowest = case.machinery.get("lowest_level", [1.0] * A)[a]
            heat = HeatInput(heat=replace(HEAT, lowest_level=lowest))
        names = ("hidden_weight", "hidden_bias", "output_weight", "feature_mean", "feature_scale")
        network = {name: getattr(networks[a], name) for name in names}
        if case.feedback:
            network["hidden_weight"] = network["hidden_weight"] / 2
            network["feature_mean"] = np.array([20.0, 5.0, 100.0, 0.0])
        return replace(pair, **network, heat_input=heat, feedback=case.feedback)

    operator = base.map_actuators(changed)
    machinery = machinery_of(operator, case.machine_of, **({"u_min": operator.u_min} | case.machinery))
    # A little too cold and then a little too warm, so that energy and comfort are worth about the same.
    cold, warm = (rng.uniform(*between, (case.zones, n)) for between in ((17, 20), (20, 24)))
    options: dict[str, Any] = {"T_free_C": np.where(np.arange(n) < n // 2, cold, warm)}
    if case.signed is not None:
        options["cooling"] = Cooling(rng.uniform(0.1, 0.4, (A, n)), rng.uniform(500, 1500, (A, n)))
    if case.capped:
        options["power_cap"] = PowerCap(rng.uniform(0.8, 1.2, n) * 1000.0 * A, 0.5)
    if case.exchange:
        options["exchange"] = Exchange(rng.uniform(-2.0, 1.0, n) * 500.0 * A, rng.uniform(0.0, 0.3, n))
    if case.bend:
        options["power_per_u2_W"] = rng.uniform(300, 1500, (A, n))
    if case.capacity:
        options["capacity"] = rng.uniform(0.5, 0.9, (M, n))
    problem = random_building_problem(rng, operator, machinery, n, peak_so_far_W=600.0 * A, **options)
    if case.negative_price:
        problem = replace(problem, price_per_kWh=problem.price_per_kWh - 0.25)
    if case.feedback:
        features = problem.features.copy()
        features[..., 0] = problem.T_free_C
        problem = replace(problem, features=features)
    problem = replace(problem, weights=replace(problem.weights, peak=2e-4 if case.peak else 0.0))
    shape = ProblemShape(moves, machinery, case.peak, case.capped, case.chosen_steps, case.bend, exchange=case.exchange)
    return operator, problem, shape


def random_levels(rng: np.random.Generator, problem: MPCProblem, shape: ProblemShape) -> Array:
    """Levels (A, N) that a plan may hold: within capacities and exclusion, the same over a move."""
    m, n = problem.machinery, shape.n_steps
    u = rng.uniform(m.u_min[:, None], m.u_max[:, None], (len(m.actuators), n))
    u = np.select([rng.uniform(size=u.shape) < 0.2, rng.uniform(size=u.shape) < 0.2], [0.0, m.u_max[:, None]], u)
    u = u[:, shape.first_steps][:, shape.move_of_step]
    capacity = np.ones((len(m.machines), n)) if problem.capacity is None else problem.capacity
    least = np.minimum.reduceat(capacity, shape.first_steps, axis=1)[:, shape.move_of_step]
    load = m.fed_by @ (m.share[:, None] * np.maximum(u, 0.0))
    fits = np.minimum(least / np.maximum(load, 1e-9), 1.0)[m.machine_of]
    u = np.where(u > 0.0, u * fits, u)
    first = shape.move_of_step < shape.n_chosen_moves
    for group in m.exclusive:
        rows = list(group)
        acts = rng.choice(rows, shape.n_moves)[shape.move_of_step]
        u[rows] = np.where(first & (np.array(rows)[:, None] != acts), 0.0, u[rows])
        shares = np.abs(u[rows]) / np.where(u[rows] > 0, m.u_max[rows, None], -m.u_min[rows, None] + (u[rows] == 0))
        u[rows] = np.where(first, u[rows], u[rows] / np.maximum(shares.sum(axis=0), 1.0))
    return u
