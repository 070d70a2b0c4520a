"""Calls with a deadline: an answer, an error or none in time, and what was left behind."""

from __future__ import annotations

import threading

import pytest

from controllers.bounded import BoundedCalls, Crashed, Overdue

SOON_S = 0.05


def hanging(until: threading.Event):
    return lambda: until.wait(30.0)


@pytest.fixture
def released():
    event = threading.Event()
    yield event
    event.set()


def test_it_gives_the_answer_or_the_error_of_the_call():
    calls = BoundedCalls(2)
    with calls.within(5.0):
        assert calls("solver", lambda: 7) == 7
        with pytest.raises(KeyError, match="status"):
            calls("solver", lambda: {}["status"])
    assert calls("solver", lambda: 8) == 8, "no deadline outside"


@pytest.mark.parametrize("error", [SystemExit(3), KeyboardInterrupt(), BaseException("panicked at src/lib.rs")])
def test_what_would_end_the_process_is_an_error_like_others(error):
    def ends():
        raise error

    with pytest.raises(Crashed, match=type(error).__name__):
        BoundedCalls(2)("forecaster", ends)


def test_a_call_that_hangs_is_left_behind_and_its_owner_is_not_called_again_before_it_returned(released):
    calls = BoundedCalls(3)
    with calls.within(SOON_S), pytest.raises(Overdue, match=r"no answer within 0\.0"):
        calls("one", hanging(released))
    with calls.within(5.0):
        with pytest.raises(Overdue, match="has not returned"):
            calls("one", lambda: 1)
        assert calls("another", lambda: 2) == 2
        released.set()
        for _ in range(100):
            try:
                assert calls("one", lambda: 3) == 3
                return
            except Overdue:
                threading.Event().wait(SOON_S)
    pytest.fail("its owner was not called again")


def test_only_so_many_are_left_behind(released):
    calls = BoundedCalls(2)
    for owner in ("one", "two"):
        with calls.within(SOON_S), pytest.raises(Overdue, match="no answer"):
            calls(owner, hanging(released))
    with pytest.raises(Overdue, match="2 calls have not returned"):
        calls("three", lambda: 1)


def test_calls_inside_share_their_time(released):
    calls = BoundedCalls(2)
    with calls.within(SOON_S):
        with pytest.raises(Overdue, match="no answer"):
            calls("one", hanging(released))
        with pytest.raises(Overdue, match="no time is left"):
            calls("two", lambda: 1)
