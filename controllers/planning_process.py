"""A process that plans for some of the buildings of a portfolio.

States are large, and come back with the next observations as they went out. So they are handed out packed, and the
process keeps the last one of each building: where that is the one given, its name is sent in its place.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import uuid
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace

from controllers.many import Known, Planned, Together, Wanted
from controllers.packed_state import PackedState
from thermoforce_mpc.execution.local import Remembering, one_thread_each

Plans = list[tuple[str, Planned]]


@dataclass(frozen=True)
class _Named:
    """In place of a state, its name."""

    name: str


class PlanningProcess:
    """A process that plans for some buildings, started when it is first asked and again after its end."""

    def __init__(self, known: Known, grace_s: float) -> None:
        self._begin = (known, grace_s)
        self._context = Remembering()
        self._pool: ProcessPoolExecutor | None = None
        # Names of the states that the process keeps, by building.
        self._keeps: dict[str, str] = {}

    def asked(self, wanted: list[Wanted]) -> Future[bytes]:
        """The plans of buildings, to come, packed for `plans`; raises `BrokenProcessPool` from its result."""
        try:
            return self._submitted(wanted)
        except BrokenProcessPool:  # it died since its last plans
            self.end()
            return self._submitted(wanted)

    def _submitted(self, wanted: list[Wanted]) -> Future[bytes]:
        pool = self._started()
        given = [(name, observation, self._named(name, state)) for name, observation, state in wanted]
        return pool.submit(_plans_of, pickle.dumps(given, pickle.HIGHEST_PROTOCOL))

    def _named(self, name: str, state: object) -> object:
        """The name of a state that the process keeps, the state itself where it does not."""
        kept = isinstance(state, PackedState) and self._keeps.get(name) == state.name
        # Whatever comes of this plan, the process may then keep another one.
        self._keeps.pop(name, None)
        return _Named(state.name) if isinstance(state, PackedState) and kept else state

    def plans(self, packed: bytes) -> Plans:
        """The plans that the process answered with."""
        plans: Plans = pickle.loads(packed)
        self._keeps |= {name: one.state.name for name, one in plans if isinstance(one.state, PackedState)}
        return plans

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            # Spawned: a fork would copy the locks of compiled code in whatever state they are.
            self._context = Remembering()
            self._pool = ProcessPoolExecutor(1, self._context, _begin, self._begin)
            with one_thread_each():
                self._pool.submit(os.getpid)  # starts the process
        return self._pool

    def end(self) -> None:
        """End the process at once, even while it starts: it holds nothing that outlives it.

        What it was asked for ends with `BrokenProcessPool`.
        """
        if self._pool is not None:
            for process in self._context.started:
                process.kill()
            self._pool.shutdown()
        self._pool = None
        self._keeps.clear()


_together: Together | None = None
# In the process: the last state of each building, and its name.
_kept: dict[str, tuple[str, object]] = {}


def _begin(known: Known, grace_s: float) -> None:
    """In the process: an interrupt is for the parent, whose end is that of the process."""
    global _together
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _together = Together(known, grace_s)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _plans_of(given: bytes) -> bytes:
    assert _together is not None
    return pickle.dumps([*_packed(_together.plans(_unpacked(pickle.loads(given))))], pickle.HIGHEST_PROTOCOL)


def _unpacked(given: Iterable[Wanted]) -> Iterator[Wanted]:
    """What is wanted, with the states that stand behind names."""
    for name, observation, state in given:
        if isinstance(state, _Named):
            kept_name, state_itself = _kept[name]
            assert kept_name == state.name
            yield name, observation, state_itself
        else:
            yield name, observation, state


def _packed(plans: Iterable[tuple[str, Planned]]) -> Iterator[tuple[str, Planned]]:
    """Plans with their states packed and kept."""
    for name, planned in plans:
        if planned.state is None:
            _kept.pop(name, None)
            yield name, planned
            continue
        packed = PackedState(uuid.uuid4().hex, pickle.dumps(planned.state, pickle.HIGHEST_PROTOCOL))
        _kept[name] = packed.name, planned.state
        yield name, replace(planned, plan=replace(planned.plan, state=packed), state=packed)
