"""The order and the count of tasks, whatever an engine does: here one that runs them at once, and loses some."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Mapping

import executed_tasks as functions
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.cases import run_all
from thermoforce_mpc.execution import Task, execute
from thermoforce_mpc.execution.execute import MOST_ATTEMPTS, Begun, Ended, Event, Lost, Told, answer_to


class Losing:
    """Runs a task when asked for the next event, or loses it as often as `deaths` of its title says."""

    def __init__(self, width: int, deaths: Mapping[str, int], seed: int, together: int = 1) -> None:
        self.width, self._deaths, self._together = width, Counter(deaths), together
        self._random = random.Random(seed)
        self._running: dict[str, tuple[str, bytes]] = {}
        self._told: list[Event] = []
        self.begun: list[tuple[str, int]] = []

    @property
    def room(self) -> int:
        return self.width - len(self._running)

    def submit(self, key: str, title: str, payload: bytes) -> None:
        assert self.room > 0
        assert key not in self._running
        self._running[key] = title, payload
        self.begun.append((title, len(self._running)))
        self._told += [Begun(key), Told(key, 0.5)]

    def wait(self) -> Event:
        if self._told:
            return self._told.pop(self._random.randrange(len(self._told)))
        key = self._random.choice(sorted(self._running))
        title, payload = self._running.pop(key)
        if self._deaths[title] > 0:
            self._deaths[title] -= self._together
            return Lost(key, "out of memory", self._together)
        return Ended(key, answer_to(payload, lambda share: None))

    def cancel(self) -> None:
        self._running.clear()


@st.composite
def graphs(draw):
    """Needs of each task, which are earlier ones."""
    n = draw(st.integers(1, 12))
    return [draw(st.sets(st.integers(0, i - 1), max_size=3)) if i else set() for i in range(n)]


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(graphs(), st.integers(1, 4), st.integers(0, 99), st.data())
def test_every_task_ends_once_after_its_needs(needs, width, seed, data):
    deaths = {str(i): data.draw(st.sampled_from([0, 0, 0, 1, 2, 9])) for i in range(len(needs))}
    failing = data.draw(st.sets(st.sampled_from(range(len(needs))), max_size=2))
    tasks: list[Task] = []
    for i, of in enumerate(needs):
        function = functions.refuse if i in failing else functions.total
        tasks.append(Task(f"k{i}", str(i), function, {"n": i, "log": "/dev/null"}, tuple(tasks[j] for j in sorted(of))))
    engine = Losing(width, deaths, seed)
    outcomes = list(execute(tasks, engine))
    assert sorted(o.task.key for o in outcomes) == sorted(task.key for task in tasks)
    place = {o.task.key: n for n, o in enumerate(outcomes)}
    found = {o.task.key: o for o in outcomes}
    poisoned = {i for i in range(len(needs)) if deaths[str(i)] >= MOST_ATTEMPTS}
    for i, task in enumerate(tasks):
        outcome = found[task.key]
        assert all(place[need.key] < place[task.key] for need in task.needs)
        needs_failed = any(found[need.key].reason for need in task.needs)
        if needs_failed:
            assert outcome.reason
            assert outcome.attempts == 0
        elif i in poisoned:
            assert outcome.poisoned
            assert outcome.attempts == MOST_ATTEMPTS
        elif i in failing:
            assert outcome.reason == "no draws of heat in these data"
            assert outcome.attempts == 1 + deaths[str(i)]
        else:
            assert outcome.value == i + sum(found[need.key].value for need in task.needs)
            assert outcome.attempts == 1 + deaths[str(i)]
    again = {title for title, n in Counter(title for title, _ in engine.begun).items() if n > 1}
    for title in again:
        beside = [n for begun, n in engine.begun if begun == title]
        assert beside[1:] == [1] * (len(beside) - 1), "again without company"


def test_a_bystander_of_many_deaths_is_run_alone_before_it_is_blamed():
    """An engine that counts the deaths of a worker against all its tasks, as Dask does."""
    tasks = [Task(name, name, functions.total, {"n": 1, "log": "/dev/null"}) for name in ("culprit", "bystander")]
    engine = Losing(2, {"culprit": 99, "bystander": 4}, 1, together=4)
    found = {o.task.key: o for o in execute(tasks, engine)}
    assert found["culprit"].poisoned
    assert found["bystander"].value == 1


def test_where_a_death_is_the_outcome_nothing_is_begun_again():
    engine = Losing(1, {"a": 1}, 1)
    (outcome,) = execute([Task("a", "a", functions.total, {"n": 1, "log": "/dev/null"})], engine, most_attempts=1)
    assert outcome.poisoned
    assert outcome.reason == "its worker died (out of memory)"
    assert len(engine.begun) == 1


def test_values_come_in_the_order_of_the_cases():
    told = []
    cases = [{"n": n, "log": "/dev/null"} for n in range(9)]
    values = run_all(functions.total, cases, Losing(3, {}, 4), lambda n, value: told.append((n, value)))
    assert values == list(range(9))
    assert [n for n, _ in told] == list(range(1, 10))
    assert sorted(value for _, value in told) == values


def test_cases_that_were_kept_are_not_run_again(tmp_path):
    cases = [{"n": n, "log": "/dev/null"} for n in range(3)]
    first, again = Losing(3, {}, 4), Losing(3, {}, 4)
    assert run_all(functions.total, cases[:2], first, keep=tmp_path) == [0, 1]
    assert run_all(functions.total, cases, again, keep=tmp_path) == [0, 1, 2]
    assert (len(first.begun), len(again.begun)) == (2, 1)
