"""Run tasks in the order of their needs, each result stored once, whatever happens to the workers.

What an engine is, and what its workers do, stands first.
"""

from __future__ import annotations

import pickle
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from graphlib import TopologicalSorter
from typing import Any, Protocol

from thermoforce_mpc.errors import ThermoForceError

_SHARE_EVERY_S = 0.5


@dataclass(frozen=True)
class WorkerAnswer:
    """What a worker sends back: the pickled `value`, or the `reason` of a failure (see `Outcome`)."""

    value: bytes = b""
    reason: str = ""
    seconds: float = 0.0
    error: type[ThermoForceError] | None = None
    details: str = ""


@dataclass(frozen=True)
class Begun:
    """A worker has begun the task of `key`."""

    key: str


@dataclass(frozen=True)
class Told:
    """A task has told that a `share` of it, 0 to 1, is done."""

    key: str
    share: float


@dataclass(frozen=True)
class Ended:
    """A worker has answered."""

    key: str
    answer: WorkerAnswer


@dataclass(frozen=True)
class Lost:
    """The worker of a task died, at each of `attempts` attempts."""

    key: str
    why: str
    attempts: int = 1


Event = Begun | Told | Ended | Lost


class Engine(Protocol):
    """Runs `answer_to(payload)` on workers. Thread safety is not asked for."""

    @property
    def width(self) -> int:
        """How many tasks it computes at once, as of now."""

    @property
    def room(self) -> int:
        """How many more tasks to submit now; positive where nothing is under way."""

    def submit(self, key: str, title: str, payload: bytes) -> None:
        """Run `payload`; events name it by `key`."""

    def wait(self) -> Event:
        """The next event; blocks."""

    def cancel(self) -> None:
        """End what is under way; no event of it comes any more."""


def payload_of(function: Callable[..., Any], inputs: Any, results: tuple[Any, ...]) -> bytes:
    """Pickle a call; raises what `pickle` does."""
    return pickle.dumps((function, inputs, results), protocol=pickle.HIGHEST_PROTOCOL)


def answer_to(payload: bytes, report: Callable[[float], None]) -> WorkerAnswer:
    """Make the call of `payload_of` in this process; every error becomes an answer."""
    began = time.perf_counter()
    told_s = time.monotonic()

    def tell_now(share: float) -> None:
        nonlocal told_s
        if time.monotonic() - told_s >= _SHARE_EVERY_S:
            told_s = time.monotonic()
            report(float(share))

    token = _teller.set(tell_now)
    try:
        function, inputs, results = pickle.loads(payload)
        value = pickle.dumps(function(inputs, *results), protocol=pickle.HIGHEST_PROTOCOL)
        return WorkerAnswer(value, seconds=time.perf_counter() - began)
    except ThermoForceError as error:
        # The nearest class that the caller has too: a plugin's own may be known here only.
        kind = next(kind for kind in type(error).__mro__ if kind.__module__ == ThermoForceError.__module__)
        return WorkerAnswer(reason=str(error) or kind.__name__, seconds=time.perf_counter() - began, error=kind)
    except Exception as error:
        reason, details = f"{type(error).__name__}: {error}", traceback.format_exc()
        return WorkerAnswer(reason=reason, seconds=time.perf_counter() - began, details=details)
    finally:
        _teller.reset(token)


def tell(share: float) -> None:
    """Tell from inside a task that a `share` of it, 0 to 1, is done; elsewhere nothing happens, nor twice in 0.5 s."""
    _teller.get()(share)


_teller: ContextVar[Callable[[float], None]] = ContextVar("teller", default=lambda share: None)


@dataclass(frozen=True)
class Task:
    """One pure computation, `function(inputs, *results_of_needs)`.

    `function` is found by name in another process, and writes no files, so that running it twice does no harm. `key` is
    the address of the result, by `content_key` or the caller's own hash of all inputs.
    """

    key: str
    title: str
    function: Callable[..., Any]
    inputs: Any
    needs: tuple[Task, ...] = ()


@dataclass(frozen=True)
class TaskOutcome:
    """The end of a task: its `value`, or the `reason` why there is none (empty on success).

    `seconds`: computing time. `attempts`: how often it was begun; 0 where its result was stored or a need failed.
    """

    task: Task
    value: Any = None
    reason: str = ""
    seconds: float = 0.0
    attempts: int = 0
    poisoned: bool = False  # its worker died at every attempt
    error: type[ThermoForceError] | None = None  # kind of what the function raised
    details: str = ""  # traceback of an unexpected error


class Results(Protocol):
    """Where results are kept; called in the process that executes, so that workers share no disk."""

    def get(self, task: Task) -> Any:
        """The value of a task; raises `KeyError` where there is none."""

    def put(self, task: Task, value: Any) -> None:
        """Keep the value of a task, whole or not at all."""


class _Plan:
    """The order of what is to be done, and the values that some of it needs, kept as long as they are needed."""

    def __init__(self, todo: Sequence[Task], results: Results | None) -> None:
        self.tasks: dict[str, Task] = {}
        self._values: dict[str, Any] = {}
        self._failed: dict[str, str] = {}
        self._users: Counter[str] = Counter()
        self._order: TopologicalSorter[str] = TopologicalSorter()
        for task in todo:
            self._add(task, results)
        self._order.prepare()

    def _add(self, task: Task, results: Results | None) -> None:
        if task.key in self.tasks:
            return
        self.tasks[task.key] = task
        for need in task.needs:
            self._users[need.key] += 1
            if need.key not in self.tasks and need.key not in self._values:
                try:
                    self._values[need.key] = _kept(results, need)
                except KeyError:
                    self._add(need, results)
        self._order.add(task.key, *(need.key for need in task.needs if need.key in self.tasks))

    @property
    def open(self) -> bool:
        return self._order.is_active()

    def take_ready(self) -> list[Task]:
        """Tasks with all needs done, not taken before; first those for which most others wait."""
        return [self.tasks[key] for key in sorted(self._order.get_ready(), key=lambda key: -self._users[key])]

    def missing(self, task: Task) -> str:
        """Why a need of `task` has no result; empty if all have."""
        return next((self._failed[need.key] for need in task.needs if need.key in self._failed), "")

    def results_of_needs(self, task: Task) -> tuple[Any, ...]:
        return tuple(self._values[need.key] for need in task.needs)

    def end(self, outcome: TaskOutcome) -> None:
        task = outcome.task
        if outcome.reason:
            self._failed[task.key] = f"'{task.title}', which it needs, failed: {outcome.reason}"
        elif self._users[task.key]:
            self._values[task.key] = outcome.value
        for need in task.needs:
            self._users[need.key] -= 1
            if not self._users[need.key]:
                self._values.pop(need.key, None)
        self._order.done(task.key)


def _kept(results: Results | None, task: Task) -> Any:
    if results is None:
        raise KeyError(task.key)
    return results.get(task)


# A worker may die of something else than its task: the task is begun again, then without company.
MOST_ATTEMPTS = 3


class Watcher(Protocol):
    """Receives progress."""

    def planned(self, n: int) -> None:
        """`n` tasks will be run: those without a result, and what they need."""

    def begun(self, task: Task) -> None:
        """A worker has begun `task`."""

    def told(self, task: Task, share: float) -> None:
        """A `share` of `task`, 0 to 1, is done."""

    def ended(self, outcome: TaskOutcome) -> None:
        """A task has ended: with a value, or with the reason why there is none."""


def execute(
    tasks: Iterable[Task],
    engine: Engine,
    results: Results | None = None,
    watcher: Watcher | None = None,
    *,
    most_attempts: int = MOST_ATTEMPTS,
) -> Generator[TaskOutcome]:
    """Run tasks and what they need, each key once; yields the outcomes of all that as they come.

    Tasks whose values `results` has come first; others are kept there before they are yielded. A task that raises has
    failed, and those that need it fail with it. Where a worker dies, its task is begun again, after the others and
    alone, and is poisoned after `most_attempts`. At an exception, an interrupt or the end of the iteration, what is
    under way is cancelled.

    Raises:
        StorageError: a result could not be kept.
        EngineError: the engine is gone, or has a worker that does not fit.
    """
    requested = {task.key: task for task in tasks}
    todo: list[Task] = []
    for task in requested.values():
        try:
            yield TaskOutcome(task, _kept(results, task))
        except KeyError:
            todo.append(task)
    plan = _Plan(todo, results)
    if watcher:
        watcher.planned(len(plan.tasks))
    ready: deque[Task] = deque()
    suspects: deque[Task] = deque()
    alone: set[str] = set()
    attempts: Counter[str] = Counter()
    since: dict[str, float] = {}

    def submit(task: Task) -> TaskOutcome | None:
        """Begin a task; the outcome of one that cannot be begun."""
        if reason := plan.missing(task):
            return TaskOutcome(task, reason=reason)
        try:
            payload = payload_of(task.function, task.inputs, plan.results_of_needs(task))
        except Exception as error:  # pickle raises errors of many kinds
            return TaskOutcome(task, reason=f"cannot be sent to a worker: {type(error).__name__}: {error}")
        since[task.key] = time.monotonic()
        engine.submit(task.key, task.title, payload)
        return None

    def come(event: Ended | Lost) -> TaskOutcome | None:
        """The outcome of an event; None for a task that is to be begun again."""
        task, seconds = plan.tasks[event.key], time.monotonic() - since.pop(event.key)
        if isinstance(event, Ended):
            attempts[task.key] += 1
            return _outcome(task, event.answer, attempts[task.key])
        attempts[task.key] += event.attempts
        n = attempts[task.key]
        if n < most_attempts or (most_attempts > 1 and task.key not in alone):
            suspects.append(task)
            return None
        times = f"at each of {n} attempts " if n > 1 else ""
        reason = f"its worker died {times}({event.why})" + ("; the task is left out as poisoned" if n > 1 else "")
        return TaskOutcome(task, None, reason, seconds, n, poisoned=True)

    try:
        while plan.open:
            ready.extend(plan.take_ready())
            outcome: TaskOutcome | None = None
            if ready and engine.room > 0:
                outcome = submit(ready.popleft())
            elif suspects and not since:
                alone.add(suspects[0].key)
                outcome = submit(suspects.popleft())
            else:
                event = engine.wait()
                if event.key not in since:  # told late
                    continue
                if isinstance(event, Ended | Lost):
                    outcome = come(event)
                elif watcher and isinstance(event, Begun):
                    watcher.begun(plan.tasks[event.key])
                elif watcher and isinstance(event, Told):
                    watcher.told(plan.tasks[event.key], event.share)
            if outcome is not None:
                if results and not outcome.reason:
                    results.put(outcome.task, outcome.value)
                plan.end(outcome)
                if watcher:
                    watcher.ended(outcome)
                yield outcome
    finally:
        if since:
            engine.cancel()


def _outcome(task: Task, answer: WorkerAnswer, attempts: int) -> TaskOutcome:
    value, reason = None, answer.reason
    if not reason:
        try:
            value = pickle.loads(answer.value)
        except Exception as error:  # made of something that this process does not have
            reason = f"its result cannot be read: {type(error).__name__}: {error}"
    return TaskOutcome(task, value, reason, answer.seconds, attempts, error=answer.error, details=answer.details)
