"""What a plan says of discomfort that it accepts, and the temperature to which it sends a building's own loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model
from two_houses import TwoHouses, two_model, two_observation

from controllers import MPCConfig, ThermoForceMPC
from controllers.mpc.formulation import Instance
from controllers.mpc.solved import end_of_move_C, reason_of
from controllers.optimisation.problem import Cooling, EquipmentLayout
from thermoforce_mpc.data import DAY_S, HOUR_S, Observation
from thermoforce_mpc.data.plan import NOT_ECONOMICAL

SPENT, OFF = "cannot be avoided at full power", "cannot be avoided with nothing on"
LATE = "cannot be avoided in time any more"
HOURS = 24


def why(u, *, below=True, at=3, machinery: EquipmentLayout | None = None, zone: int | None = None,
        capacity: float | None = None, missing_K=0.5, margin_K=0.0, free_steps=HOURS) -> str:  # fmt: skip
    """What is said of `missing_K` beyond a bound at the end of step `at` of a plan with levels `u`.

    `zone`: that of two; `capacity`: of a machine that they share; `margin_K` are kept inside the bounds and missed too.
    """
    model = simple_model() if zone is None else two_model(shared=capacity is not None)
    mpc = ThermoForceMPC(model, MPCConfig(step_s=None, horizon_h=float(HOURS)), free_response=OutdoorResponse())
    seen = observation() if zone is None else two_observation(HOURS)
    if capacity is not None:
        plant = TwoHouses(shared=True)
        plant.reset(10 * DAY_S, 0.0)
        seen = Observation(plant.past(HOUR_S), plant.forecast(DAY_S, HOUR_S))
    context = mpc.predictor.context(seen)
    problem = mpc.instance(context, seen.history)
    if capacity is not None:
        problem = replace(problem, capacity=np.full((1, HOURS), capacity))
    if machinery is not None:
        nothing = np.zeros((1, HOURS))
        problem = replace(problem, machinery=machinery, cooling=Cooling(nothing, nothing))
    T, slack = np.full((len(u), HOURS), 22.0), np.zeros((len(u), HOURS))
    slack[zone or 0, at] = missing_K + margin_K
    comfort_C = np.stack([np.full(T.shape, 20.0), np.full(T.shape, 24.0)])
    problem = replace(problem, lower_C=comfort_C[0] + margin_K, upper_C=comfort_C[1] - margin_K)
    T[zone or 0, at] = 20.0 - missing_K if below else 24.0 + missing_K
    return reason_of(problem, mpc.planning_operator, np.array(u), T, slack, context.free, comfort_C, free_steps)


def observation(T_start_C: float = 21.0) -> Observation:
    house = SimpleHouse(T_start_C)
    house.reset(10 * DAY_S, 0.0)
    return Observation(house.past(HOUR_S), house.forecast(DAY_S, HOUR_S))


def levels(*first: float, rest: float = 0.0) -> list[list[float]]:
    return [[*first, *[rest] * (HOURS - len(first))]]


def test_what_full_level_cannot_avoid_is_no_matter_of_money():
    assert f"0.50 K below the comfort band {SPENT} in 4 h" in why(levels(1.0, 1.0, 0.99, 1.0))
    assert NOT_ECONOMICAL in why(levels(1.0, 1.0, 0.9, 1.0), missing_K=0.05), "a step of it was to spare"
    assert LATE in why(levels(1.0, 1.0, 0.9, 1.0)), "which would not have brought half of it"
    assert NOT_ECONOMICAL in why(levels(0.0, 1.0, 1.0, 1.0)), "it could have begun earlier"
    assert SPENT in why(levels(0.5, 0.5, 0.5, 0.5), machinery=EquipmentLayout.one(0.5)), (
        "full level is what actuation gives"
    )
    assert SPENT in why(levels(1.0), at=0)


def test_what_is_missing_of_a_margin_or_is_planned_again_before_it_comes_is_no_discomfort():
    spare = levels(0.0)
    assert "0.30 K below the comfort band cannot be avoided econ" in why(spare, missing_K=0.3, margin_K=0.1)
    missed = "lower bound with its margin, 20.10 °C, is missed by 0.10 K in 4 h"
    assert missed in why(spare, missing_K=0.0, margin_K=0.1)
    assert "upper bound with its margin" in why(spare, missing_K=0.0, margin_K=0.1, below=False)
    assert "is missed by 0.30 K in 14 h" in why(spare, missing_K=0.3, at=13, free_steps=12)


def test_a_heated_zone_that_is_too_warm_can_only_be_heated_less():
    assert f"0.50 K above the comfort band {OFF}" in why(levels(0.0), below=False)
    assert NOT_ECONOMICAL in why(levels(0.0, 0.6), below=False, missing_K=0.2)
    assert OFF in why(levels(0.0, 0.0, 0.0, 0.0, rest=1.0), below=False), "what comes later is no cause"


def test_levels_of_both_signs_are_full_at_either_end():
    both = EquipmentLayout.one(u_min=-0.6)
    assert SPENT in why(levels(-0.6, -0.6, -0.6, -0.6), below=False, machinery=both)
    assert NOT_ECONOMICAL in why(levels(-0.6, -0.3, -0.6, -0.6), below=False, machinery=both, missing_K=0.1)


def test_a_zone_is_judged_by_its_own_actuator():
    both = levels(1.0, 1.0, 1.0, 1.0) + levels(0.2)
    assert f"{SPENT} in bath in 4 h" in why(both, zone=0)
    assert f"{NOT_ECONOMICAL} in hall in 4 h" in why(both, zone=1)


def test_a_machine_at_its_capacity_has_no_more_for_any_of_its_rooms():
    """Each takes half of it at full level."""
    both = levels(0.5, 0.5, 0.5, 0.5) + levels(0.7, 0.7, 0.7, 0.7)
    assert f"{SPENT} in bath" in why(both, zone=0, capacity=0.6)
    assert NOT_ECONOMICAL in why(both, zone=0, capacity=0.7)
    assert NOT_ECONOMICAL in why(both, zone=0, below=False, capacity=0.6), "it could be heated less"


def test_a_plan_that_starts_too_cold_says_that_its_machine_does_what_it_can():
    mpc = ThermoForceMPC(simple_model(), MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    plan = mpc.plan(observation(17.0))
    assert SPENT in plan.why
    assert NOT_ECONOMICAL not in plan.why


@pytest.mark.parametrize(
    ("u", "expected_C"),
    [
        ([0.9, 0.5, 0.4, 0.9], 20.0),
        ([0.4, 0.9, 0.9, 0.9], 19.0),
        ([0.9, 0.9, 0.9, 0.9], 22.0),
        ([-0.6, -0.3, -0.2, 0.0], 20.0),
        ([-0.2, -0.6, -0.6, 0.0], 19.0),
        ([0.9, -0.6, 0.9, 0.9], 19.0),
        ([0.0, 0.9, 0.9, 0.9], 19.0),
    ],
    ids=["until it is done", "a little", "all along", "cooled", "a little cooled", "turned", "idle"],
)
def test_loops_are_sent_to_the_end_of_the_steps_that_work(u, expected_C):
    assert end_of_move_C(np.array(u), np.array([19.0, 20.0, 21.0, 22.0]), -0.6) == expected_C


@pytest.mark.parametrize(("level", "bounds"), [(0.3, (0.3, 1.0)), (-0.3, (-1.0, -0.3)), (2.0, (1.0, 1.0))])
def test_an_instance_that_asks_for_a_level_keeps_it_in_its_first_steps(level, bounds):
    controller = ThermoForceMPC(simple_model(), MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    seen = observation()
    problem = controller.instance(controller.predictor.context(seen), seen.history)
    signed = np.full((1, HOURS), -1.0) if level < 0.0 else None
    found = Instance(replace(problem, least_u=signed), None, np.inf, "").asking(0, level, 2).problem
    low, high = found.level_bounds
    assert (low[0, :2].tolist(), high[0, :2].tolist()) == ([bounds[0]] * 2, [bounds[1]] * 2)
    assert (low[0, 2:] == (0.0 if signed is None else -1.0)).all()
    assert (high[0, 2:] == 1.0).all()
