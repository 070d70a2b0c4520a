"""Computations that ask for work instead of doing it, so that whoever runs several of them can do their work together.

A computation is a generator: it yields a list of `Ask`s and is sent one `Outcome` for each; what it returns is its
result. `answered` runs one computation, `together` several side by side. (In httpx one authentication flow serves the
synchronous and the asynchronous client in the same way.)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Ask:
    """A call asked for.

    Attributes:
        owner: the object whose work it is.
        call: what to call: without arguments, or, where there are `items`, with the list of them for one answer each.
        items: asks with items of the same owner may be answered by one call with the items of all.
        seconds: longest wall time, s; None: any.
    """

    owner: object
    call: Callable[..., Any]
    items: Sequence[Any] | None = None
    seconds: float | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of an ask: its `value`, or the `error` that ended it; it cost `seconds`."""

    value: Any = None
    error: Exception | None = None
    seconds: float = 0.0


Asking = Generator[list[Ask], Sequence[Outcome], Result]
Bounded = Callable[[object, Callable[[], Any], float | None], Any]
"""Makes a call on an object (first argument) within a time, s; raises where there was no answer in time."""


class Answerer(Protocol):
    """Gives one outcome for each ask."""

    def __call__(self, asks: list[Ask]) -> Sequence[Outcome]:
        """Outcomes in the order of `asks`."""
        ...


def asked(ask: Ask) -> Asking[Any]:
    """What one ask gives; raises the error that ended it."""
    (outcome,) = yield [ask]
    if outcome.error is not None:
        raise outcome.error
    return outcome.value


def together(
    computations: Sequence[Asking[Result]], last: Callable[[Ask], bool] = lambda ask: False
) -> Asking[list[Result]]:
    """The results of computations that run side by side: in each round, what all of them ask goes out as one list.

    A computation that asks for something `last` waits until all others that go on do so too.
    Raises what the first of them to fail raises.
    """
    results: dict[int, Result] = {}
    outcomes: dict[int, Sequence[Outcome] | None] = dict.fromkeys(range(len(computations)))
    waiting: dict[int, list[Ask]] = {}
    while outcomes:
        asks = waiting
        for i, given in outcomes.items():
            try:
                asks[i] = computations[i].send(given)  # type: ignore[arg-type]  # None begins a generator
            except StopIteration as end:
                results[i] = end.value
        if not asks:
            break
        waiting = {i: several for i, several in asks.items() if any(map(last, several))}
        if len(waiting) == len(asks):
            waiting = {}
        asks = {i: asks[i] for i in sorted(asks) if i not in waiting}
        found = yield [ask for several in asks.values() for ask in several]
        outcomes, at = {}, 0
        for i, several in asks.items():
            outcomes[i] = found[at : at + len(several)]
            at += len(several)
    return [results[i] for i in range(len(computations))]


def timed(computation: Asking[Result]) -> Asking[tuple[Result, float]]:
    """The result of a computation and its cost, s: of its own code and of what it asked for, without waiting."""
    seconds, outcomes = 0.0, None
    while True:
        began = time.perf_counter()
        try:
            asks = computation.send(outcomes)  # type: ignore[arg-type]
        except StopIteration as end:
            return end.value, seconds + time.perf_counter() - began
        seconds += time.perf_counter() - began
        outcomes = yield asks
        seconds += sum(outcome.seconds for outcome in outcomes)


def altered(computation: Asking[Result], alter: Callable[[Ask], Ask]) -> Asking[Result]:
    """The computation, with each of its asks replaced by what `alter` makes of it."""
    outcomes = None
    while True:
        try:
            asks = computation.send(outcomes)  # type: ignore[arg-type]
        except StopIteration as end:
            result: Result = end.value
            return result
        outcomes = yield [alter(ask) for ask in asks]


def within(seconds: float, computation: Asking[Result]) -> Asking[Result]:
    """The computation, all its asks to be answered within `seconds` of its begin on the wall clock."""
    until_s = time.monotonic() + seconds

    def bounded(ask: Ask) -> Ask:
        left = until_s - time.monotonic()
        return replace(ask, seconds=left if ask.seconds is None else min(left, ask.seconds))

    return (yield from altered(computation, bounded))


def answered(computation: Asking[Result], answer: Answerer | None = None) -> Result:
    """Run a computation to its end; raises what it raises. By default each call is made without limit of time."""
    answer, outcomes = answer or Answering(), None
    while True:
        try:
            asks = computation.send(outcomes)  # type: ignore[arg-type]
        except StopIteration as end:
            result: Result = end.value
            return result
        outcomes = answer(asks)


@dataclass(frozen=True)
class Answering:
    """Makes the calls one after another, one for all items of an owner.

    Where a call for several asks fails, each ask is answered by a call of its own, so that one with bad items spoils no
    other. The asks of one list share their time, unless they are of `strangers`.

    Args:
        bounded: makes calls with a limit of time; None: they have none.
        strangers: asks are of computations that have nothing to do with one another: each has its time for itself.
    """

    bounded: Bounded | None = None
    strangers: bool = False

    def __call__(self, asks: list[Ask]) -> list[Outcome]:
        """Outcomes in the order of `asks`."""
        began = time.monotonic()
        groups: dict[int, list[int]] = {}
        for i, ask in enumerate(asks):
            groups.setdefault(-1 - i if ask.items is None else id(ask.owner), []).append(i)
        found: dict[int, Outcome] = {}
        for group in groups.values():
            spent = 0.0 if self.strangers else time.monotonic() - began
            outcomes = self._group([asks[i] for i in group], spent)
            found.update(zip(group, outcomes, strict=True))
        return [found[i] for i in range(len(asks))]

    def _group(self, asks: list[Ask], spent: float) -> list[Outcome]:
        """Outcomes of asks that one call can answer."""
        whole = self._made(_joined(asks), spent)
        if len(asks) == 1:
            return [whole]
        if whole.error is not None or len(whole.value) != sum(len(ask.items or ()) for ask in asks):
            return [self._made(ask, spent) for ask in asks]
        out, at, each = [], 0, whole.seconds / max(len(whole.value), 1)
        for ask in asks:
            n = len(ask.items or ())
            out.append(Outcome(whole.value[at : at + n], seconds=n * each))
            at += n
        return out

    def _made(self, ask: Ask, spent: float) -> Outcome:
        began = time.perf_counter()
        call = ask.call if ask.items is None else lambda: ask.call(ask.items)
        left = None if ask.seconds is None else ask.seconds - spent
        try:
            value = call() if self.bounded is None else self.bounded(ask.owner, call, left)
        except Exception as error:  # whatever it is, the one who asked decides
            return Outcome(error=error, seconds=time.perf_counter() - began)
        return Outcome(value, seconds=time.perf_counter() - began)


def _joined(asks: list[Ask]) -> Ask:
    """One ask for the items of all, with the longest of their times."""
    if len(asks) == 1:
        return asks[0]
    times = [ask.seconds for ask in asks if ask.seconds is not None]
    longest = max(times) if len(times) == len(asks) else None
    return replace(asks[0], items=[item for ask in asks for item in ask.items or ()], seconds=longest)
