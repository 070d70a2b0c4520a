"""Turns of a command in a step: whatever was set before, they keep its limits and longest times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter

from controllers.actuation.commands import CommandedLoop, CommandState
from thermoforce_mpc.commands.kinds import AnyCommand
from thermoforce_mpc.commands.loop import LearnedCommand, LoopMap

N = 6


def loop_of(kind, effects, step_s=3600.0, **keys):
    command = TypeAdapter(AnyCommand).validate_python({"kind": kind, "column": "x", **keys})
    values = np.linspace(1.0, 3.0, 3) if kind == "sg_ready" else np.array([-5.0, 50.0])
    ends, none = np.array([0.0, 1.0]), np.zeros(2)
    loop = LoopMap(0.0, values, np.array(effects), 0.0, 0.0, ends, ends, none, none, 0.0, 1.0, 14.0)
    usual = np.full(N, 2.0)
    low, high = command.limits(np.full(N, 20.0), np.full(N, 22.0), usual)
    learned = LearnedCommand(command, loop, 2.0, 3600.0, usual, 0.0)
    return CommandedLoop(learned, 0, low, high, usual, np.zeros(N), step_s)


def chosen(loop, state, wanted=0.0):
    """Commands of the steps from `state` on as (value, s), joined."""
    joined = [[state.value, state.held_s]]
    for k in range(N):
        turns, state = loop.choose(k, np.full(N - k, wanted), 21.0, np.full(N - k, 21.0), wanted, state)
        assert sum(seconds for _, seconds in turns) == loop.step_s
        for value, seconds in turns:
            if value == joined[-1][0]:
                joined[-1][1] += seconds
            else:
                joined.append([value, seconds])
    return joined


@pytest.mark.parametrize("held_s", [0.0, 6000.0, 3 * 3600.0, 10 * 3600.0])
def test_what_was_blocked_too_long_is_blocked_no_longer(held_s):
    """By the utility, or before a restart: nothing that no plan did keeps it blocked."""
    (_, before), *later = chosen(loop_of("sg_ready", [0.0, 0.5, 1.0]), CommandState(1.0, held_s))
    assert before <= max(held_s, 7200.0)
    assert later


@pytest.mark.parametrize("keys", [{"blocked_at_most_min": 30}, {"blocked_at_most_min": 45, "hold_min": 180}])
@pytest.mark.parametrize("value", [1.0, 2.0])
def test_it_is_blocked_no_longer_than_it_may_be_within_a_step_too(keys, value):
    found = chosen(loop_of("sg_ready", [0.0, 0.5, 1.0], **keys), CommandState(value, 0.0))
    blocked_s = [seconds for value, seconds in found if value == 1.0]
    assert blocked_s
    assert max(blocked_s) <= 60.0 * keys["blocked_at_most_min"]


@pytest.mark.parametrize("keys", [{}, {"change_per_h": 0.5, "hold_min": 240}])
@pytest.mark.parametrize("value", [30.0, -9.0, 0.0])
@pytest.mark.parametrize("wanted", [0.0, 0.5, 1.0])
def test_what_may_not_be_set_is_left_at_once(keys, value, wanted):
    """Somebody turned it by hand beyond `minimum` and `maximum`."""
    loop = loop_of("setpoint", [0.0, 1.0], minimum=18.0, maximum=24.0, **keys)
    assert all(18.0 <= one <= 24.0 for one, _ in chosen(loop, CommandState(value, 600.0), wanted)[1:])
    turns, _ = loop.choose(0, np.full(N, wanted), 21.0, np.full(N, 21.0), wanted, CommandState(value, 600.0))
    assert all(18.0 <= one <= 24.0 for one, _ in turns)


@pytest.mark.parametrize(("age_s", "value", "held_s"), [(0.0, 3.0, 600.0), (1800.0, 3.0, 2400.0), (9e4, 2.0, 3600.0)])
def test_what_was_read_at_the_start_is_not_what_is_set_days_later(age_s, value, held_s):
    """After a step of the building's own control, what it usually sets."""
    loop = loop_of("sg_ready", [0.0, 0.5, 1.0])
    begun = replace(loop, learned=replace(loop.learned, last=3.0, held_s=600.0), age_s=age_s).begin()
    assert (begun.value, begun.held_s) == (value, held_s)
