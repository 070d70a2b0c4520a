"""Calls with a deadline: an answer, an error or none in time, and what was left behind."""

from __future__ import annotations

import contextlib
import threading

import pytest
from waiting import LONG_S, wait_for

from controllers.safety.deadline import BoundedCalls, Crashed, Overdue
from thermoforce_mpc.execution.cooperative import DirectHandler, Request

SOON_S = 0.05


def hanging(until: threading.Event):
    return lambda: until.wait(LONG_S)


@pytest.fixture
def released():
    event = threading.Event()
    yield event
    event.set()


def test_it_gives_the_answer_or_the_error_of_the_call():
    calls = BoundedCalls(2)
    assert calls("solver", lambda: 7, LONG_S) == 7
    with pytest.raises(KeyError, match="status"):
        calls("solver", lambda: {}["status"], LONG_S)
    assert calls("solver", lambda: 8) == 8, "no deadline where none is given"


@pytest.mark.parametrize("error", [SystemExit(3), KeyboardInterrupt(), BaseException("panicked at src/lib.rs")])
def test_what_would_end_the_process_is_an_error_like_others(error):
    def ends():
        raise error

    with pytest.raises(Crashed, match=type(error).__name__):
        BoundedCalls(2)("forecaster", ends)


def test_a_call_that_hangs_is_left_behind_and_its_owner_is_not_called_again_before_it_returned(released):
    calls = BoundedCalls(3)
    with pytest.raises(Overdue, match=r"no answer within 0\.0"):
        calls("one", hanging(released), SOON_S)
    with pytest.raises(Overdue, match="has not returned"):
        calls("one", lambda: 1, LONG_S)
    assert calls("another", lambda: 2, LONG_S) == 2
    released.set()

    def called_again() -> bool:
        with contextlib.suppress(Overdue):
            return calls("one", lambda: 3, LONG_S) == 3
        return False

    wait_for("its owner is called again", called_again)


def test_only_so_many_are_left_behind(released):
    calls = BoundedCalls(2)
    for owner in ("one", "two"):
        with pytest.raises(Overdue, match="no answer"):
            calls(owner, hanging(released), SOON_S)
    with pytest.raises(Overdue, match="2 calls have not returned"):
        calls("three", lambda: 1)


def test_asks_of_one_list_share_their_time_and_those_of_strangers_do_not(released):
    asks = [Request("one", hanging(released), seconds=SOON_S), Request("two", lambda: 1, seconds=SOON_S)]
    late, starved = DirectHandler(BoundedCalls(2))(asks)
    assert "no answer" in str(late.error)
    assert "no time is left" in str(starved.error)
    late, other = DirectHandler(BoundedCalls(2), strangers=True)(asks)
    assert "no answer" in str(late.error)
    assert other.value == 1
