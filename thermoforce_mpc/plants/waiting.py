"""Waiting for the process of a plant: every answer has a time limit, and one that takes long is said in the log.

A long stretch is asked for in pieces of `PIECE_S` of the building's time, so that one limit tells a process that hangs,
or gets ever slower, from a warm-up that is long.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar

from thermoforce_mpc.errors import PlantError

_LOG = logging.getLogger(__name__)

# Longest time for a piece, s: a simulation that is slower than the building itself does not come to an end.
PATIENCE_S = 900.0
PIECE_S = 900.0
# A process that starts has this long at least, s.
START_S = 60.0
# A wait is said after this time, or half of the limit if that is sooner, and again whenever it has doubled, s.
_SAID_AFTER_S = 60.0
# What a killed process leaves unread is waited for this long, s.
_END_S = 5.0

T = TypeVar("T")


def wait_for(receive: Callable[[], T], kill: Callable[[], None], what: str, limit_s: float) -> T:
    """Return the result of `receive`, which blocks in a thread; `kill` ends what it waits for, then it must return.

    `what` names it in messages, such as "the FMU's step from day 3.51". `kill` is also called where the wait is
    interrupted (Ctrl-C).

    Raises:
        PlantError: it took more than `limit_s`; or what `receive` raises.
    """
    answer: Future[T] = Future()
    reader = threading.Thread(target=_receive, args=(answer, receive), daemon=True)
    began = time.monotonic()
    reader.start()
    try:
        _wait(answer, began, what, limit_s)
    except BaseException:
        kill()
        reader.join(_END_S)
        raise
    return answer.result()


def _receive(answer: Future[T], receive: Callable[[], T]) -> None:
    try:
        answer.set_result(receive())
    except BaseException as error:  # raised again where it is waited for
        answer.set_exception(error)


def _wait(answer: Future[T], began: float, what: str, limit_s: float) -> None:
    """Wait for `answer`, and say so; raises `PlantError` at the limit."""
    say_s = min(limit_s / 2.0, _SAID_AFTER_S)
    while not wait([answer], max(began + min(say_s, limit_s) - time.monotonic(), 0.0)).done:
        if time.monotonic() - began >= limit_s:
            raise PlantError(f"{what} took more than {limit_s:g} s and was ended (plant.patience_min allows more)")
        _LOG.warning("%s takes %.3g s already; it is ended after %g s", what, time.monotonic() - began, limit_s)
        say_s *= 2.0
