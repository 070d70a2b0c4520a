"""Computations that ask: side by side they are answered together, and what fails for one fails for no other."""

from __future__ import annotations

import time

import pytest

from thermoforce_mpc.execution.cooperative import DirectHandler, Request, gather, perform, run, timed, within

DOUBLED = object()


def doubled(calls: list[list[float]], value: float):
    """A computation that asks for the double of a value, twice."""

    def call(items):
        calls.append(list(items))
        if min(items) < 0:
            raise ValueError(f"{min(items)} is negative")
        return [2 * item for item in items]

    (once,) = yield from perform(Request(DOUBLED, call, [value]))
    (twice,) = yield from perform(Request(DOUBLED, call, [once]))
    return twice


def caught(computation):
    try:
        return (yield from computation)
    except ValueError as error:
        return str(error)


def test_computations_side_by_side_share_each_call_and_keep_their_order():
    calls: list[list[float]] = []
    assert run(gather([doubled(calls, value) for value in (1, 2, 3)])) == [4, 8, 12]
    assert calls == [[1, 2, 3], [2, 4, 6]]


def test_those_that_ask_less_often_do_not_hold_up_the_others():
    def at_once(value):
        yield from ()
        return value

    calls: list[list[float]] = []
    assert run(gather([at_once(7), doubled(calls, 1), at_once(8)])) == [7, 4, 8]


def test_where_a_shared_call_fails_each_is_asked_alone():
    calls: list[list[float]] = []
    found = run(gather([caught(doubled(calls, value)) for value in (1, -2, 3)]))
    assert found == [4, "-2 is negative", 12]
    assert calls[1:4] == [[1], [-2], [3]]


def test_a_call_that_gives_too_few_answers_is_not_believed():
    def call(items):
        return items[:1]

    def one(value):
        (found,) = yield from perform(Request(DOUBLED, call, [value]))
        return found

    assert run(gather([one(1), one(2)])) == [1, 2]


@pytest.fixture
def clock(monkeypatch):
    """Seconds passed on the clocks of this process, which go on only where a test says so."""
    passed_s = [100.0]
    for name in ("monotonic", "perf_counter"):
        monkeypatch.setattr(time, name, lambda: passed_s[0])
    return passed_s


def test_the_cost_of_a_computation_is_its_own(clock):
    def slow(items):
        clock[0] += 0.5 * len(items)
        return items

    def one(n):
        clock[0] += 0.25 * n
        return (yield from perform(Request(DOUBLED, slow, [0] * n)))

    (_, short), (_, long) = run(gather([timed(one(1)), timed(one(4))]))
    assert (short, long) == (0.75, 3.0)


def test_time_is_counted_from_the_begin_of_a_computation(clock):
    left = []

    def bounded(owner, call, seconds):
        left.append(seconds)
        clock[0] += 0.25
        return call()

    run(within(1.0, doubled([], 1.0)), DirectHandler(bounded))
    assert left == [1.0, 0.75]
    with pytest.raises(ValueError, match="negative"):
        run(within(1.0, doubled([], -1.0)), DirectHandler(bounded))
