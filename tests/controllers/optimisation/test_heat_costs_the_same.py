"""Heat now costs what heat later costs: a plan at one price and in one weather neither preheats nor puts off."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from mpc_problems import random_operator
from scipy.spatial import ConvexHull

from controllers.mpc.config import MPCConfig
from controllers.mpc.planner import build_solver, plan_shape
from controllers.optimisation.plan_model import Evaluator
from controllers.optimisation.problem import EquipmentLayout, MPCProblem, ProblemShape, Weights, every_step
from controllers.optimisation.solution import Solution
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.building import BuildingOperator, single
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters

N, STEP_S, BOUND_C, T_OUT_C, COLDER_K, BAND_K = 48, 1800.0, 21.0, 3.0, 0.3, 0.02


@dataclass(frozen=True)
class Machine:
    """Power `fixed` + `per_u` u + `bend` u² W from level `lowest` on, where it gives the heat of `heat`."""

    fixed: float
    per_u: float
    bend: float
    lowest: float
    heat: MachineLoad | None

    @property
    def heat_input(self) -> HeatInput:
        return IDENTITY if self.heat is None else HeatInput(heat=self.heat)

    def power_W(self, u: Array) -> Array:
        return self.fixed + self.per_u * u + self.bend * u**2

    def problem(self, operator: BuildingOperator, hold: float, n: int = N) -> MPCProblem:
        """One zone that level `hold` keeps at its lower bound, a little colder at first."""
        pair = operator.of_actuator(0)
        features = np.tile([BOUND_C, T_OUT_C, 0.0, 0.0], (1, n, 1))
        rest_K = pair.gains / (1.0 - pair.poles) * float(pair.drive(np.array([hold]), features[0, :1])[0])
        return MPCProblem(
            forced_state_K=(1.0 - COLDER_K / rest_K.sum()) * rest_K[None, None],
            features=features,
            T_free_C=np.full((1, n), BOUND_C - rest_K.sum()),
            lower_C=np.full((1, n), BOUND_C),
            upper_C=np.full((1, n), BOUND_C + 5.0),
            price_per_kWh=np.full((1, n), 0.3),
            power_fixed_W=np.full((1, n), self.fixed),
            power_per_u_W=np.full((1, n), self.per_u),
            step_s=STEP_S,
            machinery=EquipmentLayout.one(lowest_level=self.lowest),
            weights=Weights(20.0, 1e-6),
            power_per_u2_W=np.full((1, n), self.bend) if self.bend else None,
        )

    def operator(self, rng: np.random.Generator) -> BuildingOperator:
        """A zone of two time constants whose gain depends on the weather."""
        poles, gains = np.array([rng.uniform(0.3, 0.6), rng.uniform(0.95, 0.99)]), rng.uniform(0.2, 0.5, 2)
        pair: OperatorParameters = random_operator(rng, 2)
        return single(replace(pair, poles=poles, gains=gains, step_s=STEP_S, heat_input=self.heat_input))


def machine(rng: np.random.Generator, actuation: str, *, metered: bool) -> Machine:
    """What may be identified of a machine, by how it is run."""
    lowest = {"duty": 1.0, "modulating": float(rng.uniform(0.2, 0.8)), "any level": 1.0}[actuation]
    load = (1000.0 * rng.uniform(0.0, 3.0), 0.0, 9000.0, 0.0)
    heat = MachineLoad(load, (-10.0, 20.0), lowest) if metered else None
    fixed, bend = (float(rng.choice([0.0, rng.uniform(100.0, 1500.0)])) for _ in range(2))
    if actuation == "duty":
        bend = 0.0  # at one level the curve does not show
    return Machine(fixed, rng.uniform(1000.0, 3000.0), bend, lowest, heat)


def plan(found: Machine, rng: np.random.Generator, solver: str) -> tuple[Solution, Array]:
    """A plan as a controller makes it, and the zone temperature at the end of each step."""
    operator = found.operator(rng)
    config = MPCConfig(step_s=STEP_S, horizon_h=N * STEP_S / 3600.0, solver=solver)
    shape = plan_shape(config, operator, EquipmentLayout.one(lowest_level=found.lowest))
    problem = found.problem(operator, rng.uniform(0.1, 0.85))
    solution = build_solver(config, operator, shape).solve(problem)
    assert solution.ok, solution.problem
    by_steps = Evaluator(operator, shape.by_steps)
    brought = by_steps.evaluate(by_steps.numbers(problem), solution.u)
    return solution, problem.T_free_C[0] + brought.forced_K[0]


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["ipopt", "qp"])
@pytest.mark.parametrize("metered", [False, True], ids=["levels", "measured heat"])
@pytest.mark.parametrize("actuation", ["duty", "modulating", "any level"])
def test_a_plan_stays_at_the_bound_that_a_level_can_hold(actuation, metered, solver):
    """Before, the first hour was priced as a level that is held and later ones as blocks at full level."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        found = machine(rng, actuation, metered=metered)
        solution, T_zone_C = plan(found, rng, solver)
        reached = int(np.argmax(T_zone_C > BOUND_C - BAND_K))
        assert reached < N // 4, found
        np.testing.assert_allclose(T_zone_C[reached:], BOUND_C, atol=BAND_K, err_msg=str(found))
        assert solution.u[0, reached:].min() > 0.0, found


@pytest.mark.parametrize("metered", [False, True], ids=["levels", "measured heat"])
def test_no_mix_of_what_a_machine_can_do_gives_the_same_heat_for_less_power(metered):
    """Levels are priced at the convex envelope of off and all levels from the lowest on, where heat costs least."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        drawn = machine(rng, "modulating", metered=metered)
        bend = float(rng.uniform(500.0, 1500.0))
        found = replace(drawn, bend=bend, fixed=rng.uniform(0.0, 1.0) * bend * drawn.lowest**2)
        operator = found.operator(rng)
        u, can = np.linspace(0.0, 1.0, 101)[1:], np.linspace(found.lowest, 1.0, 401)
        evaluator = Evaluator(
            operator, ProblemShape(every_step(u.size), EquipmentLayout.one(lowest_level=found.lowest))
        )
        problem = found.problem(operator, 0.5, u.size)
        planned = evaluator.evaluate(evaluator.numbers(problem), u[None])
        able = np.concatenate([[[0.0, 0.0]], np.stack([found.heat_input(can, T_OUT_C), found.power_W(can)], axis=1)])
        corners = able[np.sort(ConvexHull(able).vertices)]
        # Of the hull the lower side: from off over the levels to full, whose line to off is the upper side.
        envelope_W = np.interp(found.heat_input(u, T_OUT_C), *corners.T)
        np.testing.assert_allclose(planned.power_W[0], envelope_W, rtol=1e-4, err_msg=str(found))
