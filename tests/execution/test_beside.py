"""Calls beside the steps: one after another, answered by key, waited for no longer than is said."""

from __future__ import annotations

import threading
import time

import pytest

from thermoforce_mpc.execution.beside import CallsBeside, beside


def refused() -> None:
    raise ValueError("no")


def ended() -> None:
    raise SystemExit(3)


def test_an_answer_is_there_by_its_key_and_a_key_is_one_call():
    calls, made = CallsBeside(), list[int]()
    for n in (1, 2):
        calls.begin("a", lambda n=n: made.append(n))
    calls.begin("b", lambda: 7)
    assert calls.answered("b", 20.0)
    assert (calls.answer("b"), made) == (7, [1]), "in the order in which they were begun"
    assert [calls.began(key) for key in "abc"] == [True, True, False]


@pytest.mark.parametrize(
    ("call", "error", "words"), [(refused, ValueError, "no"), (ended, RuntimeError, "it ended with SystemExit")]
)
def test_what_a_call_raises_is_raised_where_its_answer_is_asked_for(call, error, words):
    calls = CallsBeside()
    calls.begin("a", call)
    calls.begin("b", lambda: 7)
    assert calls.answered("b", 20.0), "the next is made all the same"
    with pytest.raises(error, match=words):
        calls.answer("a")


def test_behind_a_call_that_hangs_nothing_is_waited_for_longer_than_that_may_take():
    calls, goes_on = CallsBeside(), threading.Event()
    calls.begin("hangs", lambda: goes_on.wait(20.0))
    calls.begin("a", lambda: 7)
    began_s = time.monotonic()
    waits = [calls.answered("a", 0.2) for _ in range(50)]
    assert not any(waits)
    assert time.monotonic() - began_s < 5.0, "fifty times a fifth of a second are ten"
    goes_on.set()
    assert calls.answered("a", 20.0)


def test_answers_of_long_ago_are_forgotten():
    calls = CallsBeside()
    for n in range(1200):
        calls.begin(str(n), int)
        assert calls.answered(str(n), 20.0)
    assert not calls.began("0")
    assert calls.began("1199")


def test_all_of_a_process_share_one():
    assert beside() is beside()
