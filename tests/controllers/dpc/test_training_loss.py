"""The loss that a policy is trained on is the objective of the MPC, to the statement's last term."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from mpc_problems import random_operator

from controllers.dpc import training
from controllers.dpc.policy import lead_steps
from controllers.dpc.situations import Situations
from controllers.optimisation.machines import EquipmentLayout
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import MPCProblem, ProblemShape, Weights, every_step
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.operator.torch_module import ForcedResponseOperator

STEP_S, B, FIRST, N = 3600.0, 3, 4, 10
WORTH_STEPS = 48
# Of a K·h, and of a kelvin in a step.
COMFORT_WEIGHT = 7.0
COMFORT_PRICE = COMFORT_WEIGHT * STEP_S / HOUR_S
LEADS = torch.from_numpy(lead_steps(STEP_S))


class Given:
    """A policy whose levels (B, N) are given, as shares of the highest."""

    def __init__(self, shares: Array) -> None:
        self._steps = iter(torch.from_numpy(shares.T.copy()))

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        return next(self._steps)


def situations(rng: np.random.Generator) -> Situations:
    n = FIRST + N + 24
    return Situations(
        T_free_C=rng.uniform(17, 24, (B, n)),
        lower_C=rng.uniform(19, 21, (B, n)),
        upper_C=rng.uniform(22, 24, (B, n)),
        price_per_kWh=rng.uniform(0.1, 0.4, (B, n)),
        T_out_C=rng.uniform(-5, 15, (B, n)),
        solar_W_m2=rng.uniform(0, 300, (B, n)),
        time_s=np.arange(n) * STEP_S + np.zeros((B, 1)),
    )


def problem_of(
    found: Situations, b: int, operator: OperatorParameters, power: PowerModel, F0: Array, levels: tuple[float, float],
    worth: float,
) -> MPCProblem:  # fmt: skip
    """The instance of one course, in which a kelvin at the end is worth `worth` for as long as it lasts of two days."""
    lowest, highest = levels
    rows, before = slice(FIRST, FIRST + N), slice(FIRST - 1, FIRST + N - 1)
    features = feature_matrix(
        found.T_free_C[b, before], found.T_out_C[b, rows], found.solar_W_m2[b, rows], found.time_s[b, rows]
    )
    fixed_W, per_u_W = power.parts(found.T_out_C[b, rows])
    lasts = (operator.poles[:, None] ** np.arange(WORTH_STEPS)).sum(axis=1)
    return MPCProblem(
        forced_state_K=F0[None, None],
        features=features[None],
        T_free_C=found.T_free_C[[b], rows],
        lower_C=found.lower_C[[b], rows],
        upper_C=found.upper_C[[b], rows],
        price_per_kWh=found.price_per_kWh[[b], rows],
        power_fixed_W=fixed_W[None],
        power_per_u_W=per_u_W[None],
        step_s=STEP_S,
        machinery=EquipmentLayout.one(highest, lowest),
        weights=Weights(COMFORT_WEIGHT, 0.0),
        terminal_price_per_K=(worth * lasts / (operator.gains @ lasts))[None, None],
    )


@pytest.mark.parametrize("levels", [(1.0, 1.0), (0.3, 1.0), (0.3, 0.8), (1.0, 0.5)], ids=str)
@pytest.mark.parametrize("measured", [False, True])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_loss_is_the_cost_of_the_statement_in_units_of_full_level(sign, measured, levels):
    """With the power that the machine draws: a plan counts the fixed part as dearer above its lowest level."""
    lowest, highest = levels
    power = PowerModel(MachineLoad((1000.0, -10.0, 2500.0, 20.0), (-10.0, 15.0), lowest_level=lowest))
    heat = MachineLoad((1100.0, 30.0, 9000.0, 100.0), (-15.0, 20.0), lowest_level=lowest)
    for order in (1, 2, 3):
        rng = np.random.default_rng(order)
        drawn = random_operator(rng, order)
        heat_input = HeatInput(heat=heat) if measured else IDENTITY
        operator = replace(drawn, gains=sign * drawn.gains, sign=sign, heat_input=heat_input)
        found, F0 = situations(rng), sign * rng.uniform(0, 1, (B, order))
        u = np.where(rng.uniform(size=(B, N)) < 0.3, 0.0, rng.uniform(0, highest, (B, N)))
        module = ForcedResponseOperator(operator).requires_grad_(False)
        course = training.course_of(found, operator, power, STEP_S)
        loss, ended = training.rollout(
            Given(u / highest), module, course, torch.from_numpy(F0), FIRST, N, LEADS, levels, COMFORT_PRICE, STEP_S
        )

        shape, costs = ProblemShape(every_step(N), EquipmentLayout.one(highest, lowest)), []
        model = PlanModel(single(operator), shape)
        for b in range(B):
            worth = float(course.relative[b, FIRST + N : FIRST + N + 24].mean())
            problem = problem_of(found, b, operator, power, F0[b], levels, worth)
            brought = model.evaluate(problem, model.numbers(problem), u[[b]])
            drawn_W = power.at_lowest_level(lowest)(u[b], found.T_out_C[b, FIRST : FIRST + N])
            energy_cost = problem.price_per_W[0] * drawn_W
            if lowest >= highest:
                np.testing.assert_allclose(brought.energy_cost, energy_cost)
            costs.append(brought.cost + float((energy_cost - brought.energy_cost).sum()))
            assert float(ended[b].sum()) == pytest.approx(brought.forced_K[0, -1], rel=1e-9)
        full_W = power.parts(found.T_out_C)
        full = N * (found.price_per_kWh * STEP_S / 3.6e6 * (full_W[0] + full_W[1])).mean()
        assert float(loss) == pytest.approx(np.mean(costs) / full, rel=1e-9)
