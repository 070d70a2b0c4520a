"""The search for commands: never dearer than where it begins, within hold, limits and steps of its commands."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from pydantic import TypeAdapter

from controllers.actuation.commands import CommandState
from controllers.mpc.commands.search import Knob, better_commands
from thermoforce_mpc.commands.kinds import AnyCommand

N, PARTS, PART_S = 24, 4, 900.0


def knob(state=None, **keys):
    keys = {"kind": "setpoint", "column": "x", "hold_min": 60} | keys
    command = TypeAdapter(AnyCommand).validate_python(keys)
    low, high = (1.0, 3.0) if keys["kind"] == "sg_ready" else (18.0, 22.0)
    return Knob(command, np.full(N, low), np.full(N, high), state or CommandState(20.0, 1e5), PARTS, PART_S)


def dear(rows):
    """Heat is dear at hours 7 to 9 and 17 to 19, and rooms that are cold in the mean are worth less."""
    hour = np.arange(N * PARTS) / PARTS
    price = 1.0 + 2.0 * (((hour >= 7) & (hour < 10)) | ((hour >= 17) & (hour < 20)))
    heat = np.clip((rows - 18.0) / 4.0, 0.0, 1.0)
    return (heat * price).sum(axis=(1, 2)) + 1e3 * np.maximum(0.5 - heat.mean(axis=2), 0.0).sum(axis=1)


def runs(row):
    return [(value, len(list(same))) for value, same in groupby(row.tolist())]


def test_it_finds_the_cheap_hours_from_a_constant_command():
    start = np.full((1, N * PARTS), 20.0)
    rows, cost = better_commands([knob()], [start], dear)
    assert cost < 0.82 * dear(start[None])[0]  # 48 is the least, 72 the start
    assert cost == pytest.approx(dear(rows[None])[0])
    assert all(n >= 4 for _, n in runs(rows[0])[:-1])
    assert set(rows[0]) <= set(np.arange(18.0, 22.5, 0.5))


def test_it_begins_with_the_best_start_and_is_the_same_again():
    starts = [np.full((1, N * PARTS), value) for value in (22.0, 20.0)]
    found = [better_commands([knob()], starts, dear) for _ in range(2)]
    assert found[0][1] <= dear(starts[1][None])[0]
    assert np.array_equal(found[0][0], found[1][0])


@pytest.mark.parametrize(
    ("keys", "row", "keeps"),
    [
        ({}, [20.0] * 8 + [21.0] * 88, True),
        ({"hold_min": 120}, [20.0] * 8 + [21.0] * 4 + [20.0] * 84, False),
        ({"change_per_h": 1.0}, [20.0] * 8 + [22.0] * 88, True),
        ({"change_per_h": 0.5}, [20.0] * 4 + [21.0] * 4 + [22.0] * 88, False),
        ({"kind": "sg_ready"}, [1.0] * 8 + [2.0] * 88, True),
        ({"kind": "sg_ready"}, [1.0] * 9 + [2.0] * 87, False),
        ({"kind": "sg_ready", "hold_min": 180}, [1.0] * 8 + [2.0] * 88, True),  # the longest time comes before the hold
        ({"kind": "sg_ready", "hold_min": 180}, [1.0] * 7 + [2.0] * 89, False),
    ],
)
def test_what_a_command_may_not_do_is_known(keys, row, keeps):
    state = CommandState(2.0, 1e5) if keys.get("kind") == "sg_ready" else CommandState(20.0, 1e5)
    assert knob(state, **keys).keeps(np.array(row)) is keeps


def test_what_was_set_a_moment_ago_is_held_on():
    one = knob(CommandState(20.0, 900.0))
    assert not one.keeps(np.full(N * PARTS, 21.0))
    rows, _ = better_commands([one], [np.full((1, N * PARTS), 20.0)], dear)
    assert (rows[0, :3] == 20.0).all()


@pytest.mark.parametrize(
    ("value", "keys"),
    [(24.0, {}), (18.5, {"minimum": 19.0}), (24.0, {"change_per_h": 0.5})],
    ids=["bounds", "own", "far"],
)
def test_what_may_not_stand_is_left_at_once_whatever_hold_and_steps_ask(value, keys):
    one = knob(CommandState(value, 900.0), **keys)
    assert one.keeps(np.full(N * PARTS, 21.0))
    if not keys:  # from then on they count again
        assert not one.keeps(np.array([21.0] * 2 + [20.0] * (N * PARTS - 2)))


def test_one_command_of_two_rooms_is_for_both():
    """Two knobs differ where their rooms do; one of both is one row."""

    def apart(rows):
        return ((rows[:, 0] - 19.0) ** 2).sum(axis=1) + ((rows[:, -1] - 21.0) ** 2).sum(axis=1)

    start = np.full((1, N * PARTS), 18.0)
    _, both = better_commands([knob()], [start], apart)
    _, each = better_commands([knob(), knob()], [np.vstack([start, start])], apart)
    assert both == pytest.approx(2.0 * N * PARTS, rel=0.1)
    assert each < 0.6 * both


def test_wider_limits_of_a_long_plan_make_it_no_dearer():
    """48 h at 15 min: what is allowed beside more is found as well, and most of what the best commands save."""
    n = 192
    hour = np.arange(n) / 4 % 24
    best = 20.0 + 1.0 * ((hour >= 3) & (hour < 6)) - 1.0 * ((hour >= 17) & (hour < 22))

    def cost(rows):
        return 50.0 + ((rows - best) ** 2).sum(axis=(1, 2)) + 0.2 * (np.diff(rows, axis=2) != 0.0).sum(axis=(1, 2))

    def found(most_K):
        low, high = np.full(n, 20.0 - most_K), np.full(n, 20.0 + most_K)
        one = replace(knob(minimum=10, maximum=30), low=low, high=high, parts=1)
        return better_commands([one], [np.full((1, n), 20.0)], cost)[1]

    narrow, wide, wider = (found(most_K) for most_K in (1.0, 4.0, 8.0))
    assert narrow < 60.0  # 51.6 is the least, 114 the start
    assert wide < 1.1 * narrow
    assert wider < 1.02 * wide


def test_what_no_command_changes_changes_no_search():
    """What else is on a meter makes a plan dearer, and a round's gain no smaller share of what was gained."""
    start = np.full((1, N * PARTS), 20.0)
    found = [better_commands([knob()], [start], lambda rows, more=more: dear(rows) + more)[0] for more in (0.0, 2e4)]
    np.testing.assert_array_equal(found[1], found[0])
