"""Blocks within a limit of power: a cap holds in every step, and on-time carried over lifts no peak."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.actuation.actuator import Actuation, ActuationConfig, ActuationState
from controllers.actuation.actuators import Actuators, PowerLimit
from thermoforce_mpc.data import Layout, Names

STEP_S = 900.0
FULL_W = 4000.0
OFF, ON = ActuationState(), ActuationState(on=True, held_s=3600.0)


def actuators(machine_of: tuple[int, ...] = (0,), **options) -> Actuators:
    n = len(machine_of)
    names = Names(
        tuple(f"room {a}" for a in range(n)),
        tuple(f"valve {a}" for a in range(n)),
        tuple(f"machine {m}" for m in range(max(machine_of) + 1)),
    )
    layout = Layout(names, (1,) * n, tuple(range(n)), machine_of, (0.0,) * n, (0.5,) * n, (float("nan"),) * n)
    options = {"block_s": 300.0, "min_on_s": 600.0, "min_off_s": 600.0, **options}
    return Actuators(layout, [Actuation(ActuationConfig(**options))] * n)


def levels(acted) -> np.ndarray:
    """Mean levels (A,)."""
    return np.array([sum(block.u[0] * block.duration_s for block in blocks) / STEP_S for blocks in acted.blocks])


def limit(planned, cap_W: float = np.inf, peak_W: float = np.inf) -> PowerLimit:
    """Each actuator takes `FULL_W` at level 1."""
    return PowerLimit(cap_W, peak_W, np.array(planned, dtype=float), lambda u: FULL_W * float(np.sum(u)))


@given(
    st.lists(st.floats(0, 1), min_size=1, max_size=30),
    st.floats(0.05, 1.3),
    st.sampled_from([300.0, 600.0, 900.0, 1200.0, 2700.0]),
)
def test_no_step_is_above_the_cap_and_minimum_times_hold(shares, cap, min_on_s):
    machine, states, runs = actuators(min_on_s=min_on_s), (OFF,), []
    for share in shares:
        planned = [share * min(cap, 1.0)]
        acted = machine.realise(planned, STEP_S, states, limit(planned, cap_W=cap * FULL_W))
        assert levels(acted)[0] <= cap + 2e-5
        assert acted.over == ""
        states = acted.states
        runs += [block.u[0] > 0.0 for block in acted.blocks[0] for _ in range(round(block.duration_s / 300.0))]
    lengths = [(on, len(list(same))) for on, same in itertools.groupby(runs)]
    assert all(length * 300.0 >= (min_on_s if on else 600.0) for on, length in lengths[1:-1])


def test_a_run_of_the_minimum_time_is_shared_by_two_steps_and_the_mean_is_kept():
    machine, states, given_to = actuators(), (OFF,), []
    for _ in range(12):
        acted = machine.realise([0.3], STEP_S, states, limit([0.3], cap_W=0.4 * FULL_W))
        states = acted.states
        given_to.append(levels(acted)[0])
    assert max(given_to) == pytest.approx(1 / 3), "300 s on: 600 s would be above the cap"
    assert np.mean(given_to) == pytest.approx(0.3, abs=0.05)


def test_more_than_the_plan_is_given_where_the_cap_leaves_it_and_no_more():
    owed = ActuationState(on=True, held_s=3600.0, owed_s=600.0)
    for cap, expected in ((np.inf, 1.0), (1.0, 1.0), (0.9, 2 / 3), (0.5, 1 / 3), (0.3, 0.0)):
        acted = actuators().realise([0.3], STEP_S, (owed,), limit([0.3], cap_W=cap * FULL_W))
        assert levels(acted)[0] == pytest.approx(expected)


def test_a_plan_that_pays_for_more_than_the_cap_gets_it_and_says_so():
    acted = actuators().realise([0.9], STEP_S, (ON,), limit([0.9], cap_W=0.5 * FULL_W))
    assert levels(acted)[0] == pytest.approx(2 / 3), "whole blocks within what is planned"
    assert acted.over == "this step takes 2.67 kW, above the cap of 2 kW: comfort is worth its price"


def test_a_minimum_time_that_has_begun_is_kept_and_named():
    begun = ActuationState(on=True, held_s=300.0)
    acted = actuators().realise([0.2], STEP_S, (begun,), limit([0.2], cap_W=0.25 * FULL_W))
    assert levels(acted)[0] == pytest.approx(1 / 3)
    assert acted.over == "this step takes 1.33 kW where 1.00 kW are planned at most: minimum on time of valve 0"


def test_of_several_machines_those_come_first_to_which_most_is_owed():
    states = tuple(ActuationState(on=True, held_s=3600.0, owed_s=owed_s) for owed_s in (0.0, 500.0, 300.0))
    acted = actuators((0, 1, 2)).realise([0.35] * 3, STEP_S, states, limit([0.35] * 3, cap_W=1.7 * FULL_W))
    np.testing.assert_allclose(levels(acted), [1 / 3, 1.0, 1 / 3])


def test_held_levels_make_room_for_a_machine_that_must_stay_on():
    machines = actuators((0, 1), mode="modulating", lowest_level=0.4)
    begun = ActuationState(on=True, held_s=300.0)
    acted = machines.realise([0.6, 0.0], STEP_S, (ON, begun), limit([0.6, 0.0], cap_W=0.7 * FULL_W))
    np.testing.assert_allclose(levels(acted), [0.7 - 0.4 / 3, 0.4 / 3])
    assert acted.over == ""


def test_any_level_is_held_up_to_the_cap_where_another_takes_more():
    machines = actuators((0, 1), mode="modulating", lowest_level=0.0)
    exempt = limit([0.5, 0.2], cap_W=FULL_W).without({1})
    acted = machines.realise([0.5, 0.9], STEP_S, (OFF, OFF), exempt)
    np.testing.assert_allclose(levels(acted), [0.1, 0.9], atol=1e-5)


def test_what_does_not_follow_the_plan_is_not_held_to_the_cap():
    capped = limit([0.1, 0.1], cap_W=0.5 * FULL_W)
    acted = actuators((0, 1)).realise([1.0, None], STEP_S, (ON, ON), capped.without({0, 1}))
    assert [block.u for block in acted.together()] == [(1.0, None)]


def test_valves_of_one_machine_take_no_more_together_than_the_cap_leaves():
    states = tuple(ActuationState(on=True, held_s=3600.0, owed_s=owed_s) for owed_s in (250.0, 200.0, 100.0))
    planned, valves = [0.5, 0.4, 0.4], actuators((0, 0, 0))
    free = levels(valves.realise(planned, STEP_S, states))
    capped = valves.realise(planned, STEP_S, states, limit(planned, cap_W=1.4 * FULL_W))
    assert free.sum() > 1.6
    assert levels(capped).sum() <= 1.4
    assert capped.over == ""


def test_the_water_of_a_machine_opens_valves_within_the_cap():
    valves = actuators((0, 0), mode="supply", lowest_level=0.3, min_on_s=300.0, min_off_s=300.0)
    free = levels(valves.realise([0.4, 0.21], STEP_S, (ON, ON)))
    capped = levels(valves.realise([0.4, 0.21], STEP_S, (ON, ON), limit([0.4, 0.21], cap_W=0.65 * FULL_W)))
    np.testing.assert_allclose(free, [0.4, 0.8 / 3])
    np.testing.assert_allclose(capped, [0.4, 0.4 / 3])


@pytest.mark.parametrize(("peak", "expected"), [(0.45, 1 / 3), (0.55, 2 / 3), (0.9, 1.0)])
def test_carried_over_on_time_fills_a_peak_to_the_nearest_block(peak, expected):
    owed = ActuationState(on=True, held_s=3600.0, owed_s=600.0)
    acted = actuators().realise([0.4], STEP_S, (owed,), limit([0.4], peak_W=peak * FULL_W))
    assert levels(acted)[0] == pytest.approx(expected)
