"""A process that plans for some of the buildings of a portfolio.

States are large, and come back with the next observations as they went out. So they are handed out packed, and the
process keeps the last one of each building: where that is the one given, its name is sent in its place.
"""

from __future__ import annotations

import gc
import io
import mmap
import multiprocessing
import os
import pickle
import shutil
import signal
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from typing import IO, NamedTuple

from controllers.checks import PackedState
from controllers.many.batch import BatchPlanner, Buildings, Planned, PlanRequest
from thermoforce_mpc.execution.local import OneProcess


class SharedFile(NamedTuple):
    """What was written: in the file `path`, or, where there was no room for it, `data`."""

    path: str
    data: bytes = b""


def write_shared(write: Callable[[IO[bytes]], None], folder: str) -> SharedFile:
    """What `write` writes to a file it is given; `write` is called again where `folder` has no room."""
    try:
        handle, path = tempfile.mkstemp(dir=folder)
        try:
            with open(handle, "wb") as file:
                write(file)
        except BaseException:
            os.unlink(path)
            raise
        return SharedFile(path)
    except OSError:
        memory = io.BytesIO()
        write(memory)
        return SharedFile("", memory.getvalue())


def read_shared(shared_file: SharedFile) -> memoryview:
    """The content; its file is gone then. Raises `FileNotFoundError` where it was already."""
    if not shared_file.path:
        return memoryview(shared_file.data)
    with open(shared_file.path, "rb") as file:
        view = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    os.unlink(shared_file.path)
    return view


Plans = list[tuple[str, Planned]]
Answer = tuple[SharedFile, int]
"""A parcel of states, then of plans with the names of these states, which begin at the number."""


@dataclass(frozen=True)
class _StateName:
    """In place of a state, its name; where it goes out, also where it begins and ends in the parcel."""

    name: str
    begin: int = 0
    end: int = 0


class PlanningProcess:
    """A process that plans for some buildings, started when it is first asked and again after its end."""

    def __init__(self, buildings: Buildings, grace_s: float) -> None:
        self._buildings, self._grace_s = buildings, grace_s
        self._process: OneProcess | None = None
        self._folder = ""
        # Names of the states that the process keeps, by building.
        self._kept_names: dict[str, str] = {}

    def submit(self, requests: list[PlanRequest]) -> Future[Answer]:
        """The plans of buildings, to come, packed for `plans`; raises `BrokenProcessPool` from its result."""
        try:
            return self._submit(requests)
        except BrokenProcessPool:  # it died since its last plans
            self.end()
            return self._submit(requests)

    def _submit(self, requests: list[PlanRequest]) -> Future[Answer]:
        process = self._running()
        named_requests = [(name, observation, self._name_of_kept(name, state)) for name, observation, state in requests]
        return process.submit(
            _plans_of,
            write_shared(lambda file: pickle.dump(named_requests, file, pickle.HIGHEST_PROTOCOL), self._folder),
        )

    def _name_of_kept(self, name: str, state: object) -> object:
        kept_name = self._kept_names.pop(
            name, None
        )  # whatever comes of this plan, the process may then keep another one
        return _StateName(state.name) if isinstance(state, PackedState) and state.name == kept_name else state

    def plans(self, answer: Answer) -> Plans:
        """The plans that the process answered with; raises `BrokenProcessPool` where they went with a process."""
        shared_file, begin = answer
        try:
            content = read_shared(shared_file)
        except FileNotFoundError as error:
            raise BrokenProcessPool("the process that made the plans has ended") from error
        plans: Plans = []
        for name, planned in pickle.loads(content[begin:]):
            state = planned.state
            if isinstance(state, _StateName):
                self._kept_names[name] = state.name
                state = PackedState(state.name, content[state.begin : state.end])
            plans.append((name, replace(planned, plan=replace(planned.plan, state=state), state=state)))
        return plans

    def _running(self) -> OneProcess:
        if self._process is None:
            self._folder = tempfile.mkdtemp(prefix="tf-mpc-plans-")
            self._process = OneProcess(_begin, self._buildings, self._grace_s, self._folder)
        return self._process

    def never_began(self) -> str:
        """Why another process would end like the last one, before it could plan; "" where it would not."""
        return self._process.never_began() if self._process is not None else ""

    def end(self) -> None:
        """End the process at once, even while it starts: it holds nothing that outlives it.

        What it was asked for ends with `BrokenProcessPool`.
        """
        if self._process is not None:
            self._process.leave(0.0)
            shutil.rmtree(self._folder, ignore_errors=True)
        self._process = None
        self._kept_names.clear()


# In the process.
_planner: BatchPlanner | None = None
_folder = ""
# The last state of each building, and its name.
_last_states: dict[str, tuple[str, object]] = {}


def _begin(buildings: Buildings, grace_s: float, folder: str) -> None:
    """An interrupt is for the parent, whose end is that of the process."""
    global _planner, _folder
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _planner, _folder = BatchPlanner(buildings, grace_s), folder
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        shutil.rmtree(_folder, ignore_errors=True)
        os._exit(1)


def _plans_of(packed_requests: SharedFile) -> Answer:
    assert _planner is not None
    before, begin = _planner.controllers, 0
    plans = list(_planner.plans(_unpack(pickle.loads(read_shared(packed_requests)))))

    def write(file: IO[bytes]) -> None:
        nonlocal begin
        packed_plans = [(name, _pack(name, planned, file)) for name, planned in plans]
        begin = file.tell()
        pickle.dump(packed_plans, file, pickle.HIGHEST_PROTOCOL)

    shared_file = write_shared(write, _folder)
    if _planner.controllers > before:
        # Controllers stay for good: looking through them for garbage costs a twentieth of all plans.
        gc.collect()
        gc.freeze()
    return shared_file, begin


def _unpack(requests: Sequence[PlanRequest]) -> Iterator[PlanRequest]:
    for name, observation, state in requests:
        if isinstance(state, _StateName):
            kept_name, state_itself = _last_states[name]
            assert kept_name == state.name
            yield name, observation, state_itself
        else:
            yield name, observation, state


def _pack(name: str, planned: Planned, file: IO[bytes]) -> Planned:
    state = planned.state
    if state is None:
        _last_states.pop(name, None)
        return planned
    begin = file.tell()
    pickle.dump(state, file, pickle.HIGHEST_PROTOCOL)
    state_name = _StateName(uuid.uuid4().hex, begin, file.tell())
    _last_states[name] = state_name.name, state
    return replace(planned, plan=replace(planned.plan, state=None), state=state_name)
