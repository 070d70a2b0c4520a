"""Several actuators together: blocks of all from blocks of each, and on/off blocks of those that share a machine."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.actuation.actuator import Actuation, ActuationConfig, ActuationState
from controllers.actuation.actuators import Actuators, merged
from thermoforce_mpc.data import Block, Layout, Names

STEP_S = 900.0


def layout(actuators: int, machine_of: tuple[int, ...]) -> Layout:
    names = Names(
        tuple(f"room {a}" for a in range(actuators)),
        tuple(f"valve {a}" for a in range(actuators)),
        tuple(f"machine {m}" for m in range(max(machine_of) + 1)),
    )
    return Layout(
        names,
        (1,) * actuators,
        tuple(range(actuators)),
        machine_of,
        (0.0,) * actuators,
        (0.5,) * actuators,
        (float("nan"),) * actuators,
    )


def switched(actuators: int, machine_of: tuple[int, ...], **options) -> Actuators:
    options = {"block_s": 300.0, "min_on_s": 600.0, "min_off_s": 600.0, **options}
    return Actuators(layout(actuators, machine_of), [Actuation(ActuationConfig(**options))] * actuators)


def mean_levels(blocks: tuple[Block, ...]) -> np.ndarray:
    return sum(block.as_array() * block.duration_s for block in blocks) / sum(block.duration_s for block in blocks)


def test_blocks_of_all_change_wherever_those_of_one_change():
    first = (Block(0.0, 300.0), Block(1.0, 600.0))
    second = (Block(0.4, 600.0), Block(0.0, 300.0, (20.0, 24.0)))
    assert [(block.u, block.duration_s, block.command) for block in merged([first, second, (Block(None, 900.0),)])] == [
        ((0.0, 0.4, None), 300.0, (None, None, None)),
        ((1.0, 0.4, None), 300.0, (None, None, None)),
        ((1.0, 0.0, None), 300.0, (None, (20.0, 24.0), None)),
    ]


def test_ends_that_differ_by_rounding_are_one():
    thirds = (Block(1.0, 0.1 + 0.2), Block(0.0, 0.6))
    others = (Block(1.0, 0.3), Block(0.0, 0.6))
    assert [block.u for block in merged([thirds, others])] == [(1.0, 1.0), (0.0, 0.0)]


def test_actuators_of_one_machine_are_on_together_and_of_two_each_as_it_is():
    states = (ActuationState(on=False, held_s=3600.0), ActuationState(on=True, held_s=3600.0))
    apart = switched(2, (0, 1)).realise([2 / 3, 1 / 3], STEP_S, states).together()
    assert [(block.u, block.duration_s) for block in apart] == [((0.0, 1.0), 300.0), ((1.0, 0.0), 600.0)]
    one = switched(2, (0, 0)).realise([2 / 3, 1 / 3], STEP_S, states).together()
    assert [(block.u, block.duration_s) for block in one] == [
        ((1.0, 1.0), 300.0),
        ((1.0, 0.0), 300.0),
        ((0.0, 0.0), 300.0),
    ], "the machine runs: all at the start"
    standing = (ActuationState(held_s=3600.0),) * 2
    one = switched(2, (0, 0)).realise([2 / 3, 1 / 3], STEP_S, standing).together()
    assert [block.u for block in one] == [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], "it stands: all at the end"


def test_a_machine_that_one_actuator_started_keeps_running_its_minimum_for_the_other():
    actuators = switched(2, (0, 0))
    first = actuators.realise([1 / 3, 0.0], STEP_S, (ActuationState(held_s=3600.0),) * 2)
    assert [block.u for block in first.together()] == [(0.0, 0.0), (1.0, 0.0)]
    second = actuators.realise([0.0, 1 / 3], STEP_S, first.states).together()
    assert (second[0].u, second[0].duration_s) == ((0.0, 1.0), 300.0), "one run of 600 s, not two of 300 s"


def test_the_longest_share_leads_where_levels_differ():
    layout_ = layout(2, (0, 0))
    half = Actuation(ActuationConfig(block_s=300.0, level=0.5))
    full = Actuation(ActuationConfig(block_s=300.0))
    acted = Actuators(layout_, [half, full]).realise([0.5, 2 / 3], STEP_S, (ActuationState(held_s=3600.0),) * 2)
    assert mean_levels(acted.together()) == pytest.approx([0.5, 2 / 3]), "half level for all of the step"


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1), st.floats(0, 1)), min_size=2, max_size=30))
def test_a_shared_machine_keeps_its_minimum_times_and_every_actuator_its_share(demands):
    actuators, states = switched(3, (0, 0, 1)), (ActuationState(held_s=3600.0),) * 3
    on = []
    for demand in demands:
        acted = actuators.realise(demand, STEP_S, states)
        states, blocks = acted.states, acted.together()
        assert sum(block.duration_s for block in blocks) == pytest.approx(STEP_S)
        for block in blocks:
            on += [block.u[0] > 0 or block.u[1] > 0] * round(block.duration_s / 300.0)
        longest = max(sum(block.duration_s for block in one if block.u[0]) for one in acted.blocks[:2])
        assert sum(b.duration_s for b in blocks if b.u[0] or b.u[1]) == pytest.approx(longest), "on together"
    runs = [len(list(group)) for _, group in itertools.groupby(on)]
    assert all(run * 300.0 >= 600.0 for run in runs[1:-1])


@pytest.mark.parametrize("shares", [(0.1, 0.07), (0.3, 0.05), (0.5, 0.5)])
def test_shares_shorter_than_a_block_are_owed_on_a_shared_machine_too(shares):
    actuators, states = switched(2, (0, 0)), (ActuationState(held_s=3600.0),) * 2
    means = []
    for _ in range(80):
        acted = actuators.realise(shares, STEP_S, states)
        states = acted.states
        means.append(mean_levels(acted.together()))
    assert np.mean(means, axis=0) == pytest.approx(shares, abs=0.02)


def test_native_control_of_one_leaves_the_other_its_blocks():
    acted = switched(2, (0, 0)).realise([None, 2 / 3], STEP_S, (ActuationState(held_s=3600.0),) * 2)
    assert [block.u for block in acted.together()] == [(None, 0.0), (None, 1.0)]
    assert acted.states[0].native
    assert acted.states[1].on


def sharing(shares: tuple[float, ...], part_levels: bool) -> Actuators:
    """Valves of one machine, each with its share of the capacity, in blocks of 300 s."""
    config = ActuationConfig(block_s=300.0, min_on_s=600.0, min_off_s=600.0)
    of = replace(layout(len(shares), (0,) * len(shares)), shares=shares)
    return Actuators(of, [Actuation(config, part_levels=part_levels)] * len(shares))


def test_starts_an_hour_are_those_of_the_machine():
    """Each of two valves in turn: one start of the machine each half hour."""
    limited = switched(2, (0, 0), min_on_s=300.0, min_off_s=300.0, starts_per_hour=1)
    states, on, begun = (ActuationState(held_s=3600.0),) * 2, False, []
    for k in range(16):
        acted = limited.realise([0.5 * (k % 4 == 0), 0.5 * (k % 4 == 2)], STEP_S, states)
        states, at = acted.states, k * STEP_S
        for block in acted.together():
            if any(block.u) and not on:
                begun.append(at)
            on, at = any(block.u), at + block.duration_s
    assert len(begun) > 2
    assert min(np.diff(begun)) >= 3600.0


def test_a_valve_that_opens_beside_another_starts_no_machine():
    limited = switched(2, (0, 0), starts_per_hour=2)
    u = np.array([[0.0, 1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0, 0.0]])
    seen = [limited.now(None, SimpleNamespace(u=u[:, :n], step_s=STEP_S)) for n in (4, 5)]
    assert [[state.starts_s for state in states] for states in seen] == [[(2700.0,)] * 2, [()] * 2]


def running(actuators: int) -> tuple[ActuationState, ...]:
    return (ActuationState(on=True, held_s=3600.0),) * actuators


@pytest.mark.parametrize("part_levels", [True, False])
def test_valves_take_turns_where_all_at_once_would_ask_for_too_much(part_levels):
    blocks = sharing((0.5, 0.4, 0.4), part_levels).realise([1.0, 1 / 3, 2 / 3], STEP_S, running(3)).together()
    assert [(block.u, block.duration_s) for block in blocks] == [((1.0, 0.0, 1.0), 600.0), ((1.0, 1.0, 0.0), 300.0)]


def test_valves_that_the_machine_can_feed_at_once_are_on_together():
    blocks = sharing((0.5, 0.2, 0.2), True).realise([1.0, 1 / 3, 1 / 3], STEP_S, running(3)).together()
    assert [block.u for block in blocks] == [(1.0, 1.0, 1.0), (1.0, 0.0, 0.0)]


def test_where_turns_do_not_suffice_each_holds_a_part_level():
    levels = [1.0, 1.0, 0.6]
    (only,) = sharing((0.5, 0.2, 0.5), True).realise(levels, STEP_S, running(3)).together()
    assert only.u == pytest.approx(levels)
    on_off = sharing((0.5, 0.2, 0.5), False).realise(levels, STEP_S, running(3)).together()
    assert {u for block in on_off for u in block.u} == {0.0, 1.0}, "a level in between has never been seen"


def test_in_the_cold_a_machine_feeds_fewer_at_once():
    """Circuits on a heating curve take more when it is cold: beyond what there is, the water cools."""
    valves, levels = sharing((0.2, 0.1, 0.1), part_levels=True), (0.65, 0.65, 0.65)
    mild = valves.realise(levels, STEP_S, running(3)).together()
    assert {level for block in mild for level in block.u} == {0.0, 1.0}
    cold = valves.realise(levels, STEP_S, running(3), capacity=np.array([0.26])).together()
    assert [block.duration_s for block in cold] == [STEP_S], "the machine runs all the time"
    np.testing.assert_allclose(cold[0].as_array(), levels)


@given(
    levels=st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4),
    shares=st.lists(st.floats(0.05, 0.8), min_size=4, max_size=4),
    on=st.booleans(),
)
@settings(max_examples=200, deadline=None)
def test_plans_within_the_capacity_are_followed_within_it(levels, shares, on):
    """What is asked for at once exceeds the capacity only by what whole blocks and minimum times force."""
    load = float(np.dot(levels, shares))
    levels = (np.array(levels) / max(load, 1.0)).tolist()
    actuators = sharing(tuple(shares), True)
    states = (ActuationState(on=on, held_s=3600.0),) * 4
    acted = actuators.realise(levels, STEP_S, states)
    blocks = acted.together()
    assert sum(block.duration_s for block in blocks) == pytest.approx(STEP_S)
    at_once = [float(np.dot(block.as_array(), shares)) for block in blocks]
    longest = sum(block.duration_s for block in blocks if any(block.u))
    # A run of whole blocks may be half a block shorter than the load of the step at full capacity.
    assert max(at_once) <= 1.0 + 1e-9 or max(at_once) * longest <= STEP_S * min(load, 1.0) + 150.0 * max(at_once) + 1e-6
