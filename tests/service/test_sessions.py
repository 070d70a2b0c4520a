"""Tests are kept and dropped, also when two requests come at the same moment."""

from __future__ import annotations

import threading
import time
import weakref

import pytest
from waiting import LONG_S

from thermoforce_mpc.service.sessions import Sessions, UnknownTestid


def test_a_test_that_was_stopped_is_let_go(monkeypatch):
    """At once, or where a request to it is still being answered, after that one."""

    class Plant:
        pass

    sessions = Sessions(Plant, most=3, idle_s=900.0)
    idle, busy = sessions.select(), sessions.select()
    with sessions.using(idle) as session:
        gone = weakref.ref(session)
    del session
    sessions.stop(idle)
    assert gone() is None
    with sessions.using(busy) as session:
        gone = weakref.ref(session)
        sessions.stop(busy)
        assert gone() is not None
    del session
    assert gone() is None


def test_a_test_is_not_dropped_between_being_found_and_being_used(monkeypatch):
    """One request finds a test that is nearly idle; before it has the test, another request drops idle ones."""
    found, go_on = threading.Event(), threading.Event()
    lock, clock, served = threading.Lock(), [0.0], []

    class PausingLock:
        """Holds the thread called 'slow' up where it first gives the lock back."""

        def __enter__(self):
            lock.acquire()

        def __exit__(self, *_):
            lock.release()
            if threading.current_thread().name == "slow" and not found.is_set():
                found.set()
                go_on.wait(LONG_S)

    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with monkeypatch.context() as patched:
        patched.setattr(threading, "Lock", PausingLock)
        sessions = Sessions(object, most=3, idle_s=900.0)
    testid = sessions.select()

    def use():
        with sessions.using(testid) as session:
            served.append(session)

    slow = threading.Thread(target=use, name="slow")
    clock[0] = 899.0
    slow.start()
    assert found.wait(LONG_S)
    clock[0] = 901.0
    sessions.select()  # drops what is idle
    go_on.set()
    slow.join()
    assert len(served) == 1
    with sessions.using(testid) as session:
        assert session is served[0], "what the request did to the test it was given is not lost"
    clock[0] += 901.0
    with pytest.raises(UnknownTestid), sessions.using(testid):
        pass
