"""Run tasks in the order of their needs, each result stored once, whatever happens to the workers."""

from __future__ import annotations

import pickle
import time
from collections import Counter, deque
from collections.abc import Generator, Iterable
from typing import Protocol

from thermoforce_mpc.execution.engine import Answer, Begun, Ended, Engine, Lost, Told, payload_of
from thermoforce_mpc.execution.plan import Plan, kept
from thermoforce_mpc.execution.results import Results
from thermoforce_mpc.execution.task import Outcome, Task

# A worker may die of something else than its task: the task is begun again, then without company.
MOST_ATTEMPTS = 3


class Watcher(Protocol):
    """Receives progress."""

    def planned(self, n: int) -> None:
        """`n` tasks will be run: those without a result, and what they need."""
        ...

    def begun(self, task: Task) -> None:
        """A worker has begun `task`."""
        ...

    def told(self, task: Task, share: float) -> None:
        """A `share` of `task`, 0 to 1, is done."""
        ...

    def ended(self, outcome: Outcome) -> None:
        """A task has ended: with a value, or with the reason why there is none."""
        ...


def execute(
    tasks: Iterable[Task],
    engine: Engine,
    results: Results | None = None,
    watcher: Watcher | None = None,
    *,
    most_attempts: int = MOST_ATTEMPTS,
) -> Generator[Outcome]:
    """Run tasks and what they need, each key once; yields the outcomes of all that as they come.

    Tasks whose results are kept come first, with no attempts. A task that raises has failed and is not repeated; a task
    of which a need failed fails with it. Where a worker dies, its task is begun again, after the others and alone, and
    is poisoned after `most_attempts`; the others go on. At an exception, an interrupt or the end of the iteration, what
    is under way is cancelled and what was finished is kept.

    Args:
        tasks: what is wanted.
        engine: where it is run.
        results: where values are looked up, and kept before they are yielded.
        watcher: progress of the tasks that are run.
        most_attempts: how often a task is begun; 1 to take the death of a worker as its outcome.

    Raises:
        StorageError: a result could not be kept.
        EngineError: the engine is gone, or has a worker that does not fit.
    """
    requested = {task.key: task for task in tasks}
    todo: list[Task] = []
    for task in requested.values():
        try:
            yield Outcome(task, kept(results, task))
        except KeyError:
            todo.append(task)
    plan = Plan(todo, results)
    if watcher:
        watcher.planned(len(plan.tasks))
    ready: deque[Task] = deque()
    suspects: deque[Task] = deque()
    alone: set[str] = set()
    attempts: Counter[str] = Counter()
    since: dict[str, float] = {}

    def submit(task: Task) -> Outcome | None:
        """Begin a task; the outcome of one that cannot be begun."""
        reason = plan.missing(task)
        if reason:
            return Outcome(task, reason=reason)
        try:
            payload = payload_of(task.function, task.inputs, plan.results_of_needs(task))
        except Exception as error:  # pickle raises errors of many kinds
            return Outcome(task, reason=f"cannot be sent to a worker: {type(error).__name__}: {error}")
        since[task.key] = time.monotonic()
        engine.submit(task.key, task.title, payload)
        return None

    def come(event: Ended | Lost) -> Outcome | None:
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
        return Outcome(task, None, reason, seconds, n, poisoned=True)

    try:
        while plan.open:
            ready.extend(plan.take_ready())
            outcome: Outcome | None = None
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


def _outcome(task: Task, answer: Answer, attempts: int) -> Outcome:
    value, reason = None, answer.reason
    if not reason:
        try:
            value = pickle.loads(answer.value)
        except Exception as error:  # made of something that this process does not have
            reason = f"its result cannot be read: {type(error).__name__}: {error}"
    return Outcome(task, value, reason, answer.seconds, attempts, error=answer.error, details=answer.details)
