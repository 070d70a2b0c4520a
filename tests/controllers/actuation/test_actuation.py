from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.actuation.actuator import Actuation, ActuationConfig, ActuationState
from controllers.checks import ControllerConfigError
from thermoforce_mpc.errors import ConfigError

HOUR = 3600.0


class Machine:
    """An actuation with the state it is in."""

    def __init__(self, **options) -> None:
        self.actuation, self.state = Actuation(ActuationConfig(**options)), ActuationState()

    def realise(self, u: float | None, step_s: float):
        blocks, self.state = self.actuation.realise(u, step_s, self.state)
        return blocks


def mean_level(blocks) -> float:
    return sum(b.u[0] * b.duration_s for b in blocks) / sum(b.duration_s for b in blocks)


@given(
    st.lists(st.floats(0, 1), min_size=1, max_size=40),
    st.sampled_from([300.0, 900.0]),
    st.sampled_from([900.0, HOUR]),
    st.sampled_from([{}, {"mode": "modulating", "lowest_level": 0.4}]),
)
def test_blocks_fill_the_step_and_respect_minimum_times(levels, block_s, step_s, mode):
    actuation = Machine(block_s=block_s, min_on_s=900.0, min_off_s=900.0, **mode)
    states = []
    for u in levels:
        blocks = actuation.realise(u, step_s)
        assert sum(b.duration_s for b in blocks) == pytest.approx(step_s)
        for block in blocks:
            assert block.u[0] in ((0.0, max(u, 0.4)) if mode else (0.0, 1.0))
            assert block.duration_s % block_s == 0
            states += [block.u[0] > 0.0] * round(block.duration_s / block_s)
    # Runs of one state, but for the first (the machine had been off before) and the last, which the test cuts.
    runs, length = [], 1
    for before, now in itertools.pairwise(states):
        if now == before:
            length += 1
        else:
            runs.append(length)
            length = 1
    assert all(run * block_s >= 900.0 for run in runs[1:])


@pytest.mark.parametrize(("most", "step_s"), [(1, 600.0), (2, 600.0), (1, 900.0)])
def test_no_hour_has_more_starts_than_are_allowed(most, step_s):
    def starts(**options):
        machine = Machine(block_s=300.0, min_on_s=300.0, min_off_s=300.0, **options)
        on, begun = False, []
        for k, u in enumerate([0.5] * 36):
            at = k * step_s
            for block in machine.realise(u, step_s):
                if block.u[0] and not on:
                    begun.append(at)
                on, at = bool(block.u[0]), at + block.duration_s
        return begun, machine.state

    free, _ = starts()
    assert min(later - first for first, later in zip(free, free[most:], strict=False)) < HOUR, "without a limit"
    kept, state = starts(starts_per_hour=most)
    assert min(later - first for first, later in zip(kept, kept[most:], strict=False)) >= HOUR
    assert len(kept) > 2, "it goes on starting"
    assert [36 * step_s - begun for begun in reversed(kept) if 36 * step_s - begun < HOUR] == list(state.starts_s)


def test_a_limit_of_starts_that_follows_from_minimum_times_changes_nothing():
    levels = [0.1, 0.4, 0.7, 0.2, 0.9, 0.5] * 4
    one, other = (
        Machine(block_s=300.0, min_on_s=900.0, min_off_s=600.0, **more) for more in ({}, {"starts_per_hour": 3})
    )
    assert [one.realise(u, 900.0) for u in levels] == [other.realise(u, 900.0) for u in levels]


def test_shares_too_small_to_realise_are_owed_until_they_are_large_enough():
    actuation = Machine(block_s=300.0, min_on_s=600.0, min_off_s=600.0)
    given_s = [sum(b.duration_s for b in actuation.realise(0.03, HOUR) if b.u[0]) for _ in range(40)]
    assert given_s[0] == 0.0
    assert sum(given_s) == pytest.approx(40 * 0.03 * HOUR, abs=600.0)


def test_nothing_is_owed_to_a_plan_that_wants_the_machine_off():
    actuation = Machine(block_s=900.0, min_on_s=900.0, min_off_s=900.0)
    actuation.realise(0.1, HOUR)
    assert all(mean_level(actuation.realise(0.0, HOUR)) == 0.0 for _ in range(5))


def test_a_running_machine_keeps_running_at_the_start_of_the_next_step():
    actuation = Machine(block_s=300.0)
    first, second = actuation.realise(0.5, HOUR), actuation.realise(0.5, HOUR)
    assert [b.u[0] for b in first + second] == [0.0, 1.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("u", "expected"),
    [
        (0.0, [(0.0, HOUR)]),
        (0.1, [(0.0, 2 / 3 * HOUR), (0.3, 1 / 3 * HOUR)]),
        (0.2, [(0.0, 1 / 3 * HOUR), (0.3, 2 / 3 * HOUR)]),
        (0.3, [(0.3, HOUR)]),
        (0.77, [(0.77, HOUR)]),
        (1.0, [(1.0, HOUR)]),
    ],
)
def test_modulating_holds_levels_from_the_lowest_and_makes_lower_ones_of_blocks_at_it(u, expected):
    blocks = Machine(mode="modulating", lowest_level=0.3).realise(u, HOUR)
    assert [(block.u[0], block.duration_s) for block in blocks] == expected


def test_a_held_level_and_blocks_follow_one_another_without_a_stop():
    """A machine that holds 0.8 goes on in blocks at its lowest level, and one in blocks goes up while it is on."""
    actuation = Machine(mode="modulating", lowest_level=0.4, block_s=300.0)
    steps = [actuation.realise(u, HOUR) for u in (0.8, 0.2, 0.2, 0.6)]
    assert [block.u[0] for blocks in steps for block in blocks] == [0.8, 0.4, 0.0, 0.0, 0.4, 0.6]


def test_with_a_lowest_level_of_zero_any_level_is_held():
    machine = Machine(mode="modulating", lowest_level=0.0)
    for u in (0.0, 0.02, 0.5, 1.0):
        assert [(block.u[0], block.duration_s) for block in machine.realise(u, 300.0)] == [(u, 300.0)]
    assert (machine.actuation.switches, machine.actuation.lowest_level) == (False, 1.0)


@pytest.mark.parametrize("mode", [{"mode": "duty"}, {"mode": "modulating", "lowest_level": 0.3}])
def test_a_step_that_holds_no_two_blocks_is_refused_where_blocks_are_made(mode):
    with pytest.raises(ControllerConfigError, match=r"cannot share a step of 300 s; .* lowest_level: 0"):
        Actuation(ActuationConfig(block_s=300.0, **mode)).check_step(300.0)
    Actuation(ActuationConfig(block_s=300.0, mode="modulating", lowest_level=0.0)).check_step(300.0)


def test_blocks_shorter_than_the_minimum_are_finished_in_the_next_step():
    actuation = Machine(block_s=300.0, min_on_s=600.0, min_off_s=600.0)
    first, second = actuation.realise(1 / 3, 900.0), actuation.realise(0.0, 900.0)
    assert [(b.u[0], b.duration_s) for b in first] == [(0.0, 600.0), (1.0, 300.0)]
    assert [(b.u[0], b.duration_s) for b in second] == [(1.0, 300.0), (0.0, 600.0)], "on for its minimum, then off"


def test_duty_at_a_partial_level_scales_the_share():
    actuation = Machine(level=0.8, block_s=300.0)
    assert mean_level(actuation.realise(0.4, HOUR)) == pytest.approx(0.4)


def test_minimum_times_that_are_not_whole_blocks_are_refused():
    with pytest.raises(ConfigError, match="min_on_s must be a multiple of block_s"):
        ActuationConfig(block_s=300.0, min_on_s=400.0)
