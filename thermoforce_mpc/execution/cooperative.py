"""Computations that request work instead of doing it, so that whoever runs several can do their work together.

A computation is a generator: it yields a list of `Request`s and is sent one `RequestOutcome` for each; what it returns
is its result. `run` runs one computation, `gather` several side by side. (In httpx one authentication flow serves the
synchronous and the asynchronous client in the same way.)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Request:
    """A call that is requested, as work of `owner`, within `seconds` of wall time (None: any).

    Without arguments; where there are `items`, with the list of them for one answer each: requests with items of one
    owner may be answered by one call with the items of all.
    """

    owner: object
    call: Callable[..., Any]
    items: Sequence[Any] | None = None
    seconds: float | None = None


@dataclass(frozen=True, eq=False)
class RequestOutcome:
    """What became of a request: its `value`, or the `error` that ended it; it cost `seconds`."""

    value: Any = None
    error: Exception | None = None
    seconds: float = 0.0


Computation = Generator[list[Request], Sequence[RequestOutcome], Result]
Bounded = Callable[[object, Callable[[], Any], float | None], Any]
"""Makes a call on an object (first argument) within a time, s; raises where there was no answer in time."""


Handler = Callable[[list[Request]], Sequence[RequestOutcome]]
"""Gives one outcome for each request, in their order."""


def perform(request: Request) -> Computation[Any]:
    """Carry out one request: what it gives; raises the error that ended it."""
    (outcome,) = yield [request]
    if outcome.error is not None:
        raise outcome.error
    return outcome.value


def gather(
    computations: Sequence[Computation[Result]], last: Callable[[Request], bool] = lambda request: False
) -> Computation[list[Result]]:
    """The results of computations that run side by side: in each round, all that they request goes out as one list.

    A computation that requests for something `last` waits until all others that go on do so too.
    Raises what the first of them to fail raises.
    """
    results: dict[int, Result] = {}
    outcomes: dict[int, Sequence[RequestOutcome] | None] = dict.fromkeys(range(len(computations)))
    waiting: dict[int, list[Request]] = {}
    while outcomes:
        requests = waiting
        for i, received in outcomes.items():
            try:
                requests[i] = computations[i].send(received)  # type: ignore[arg-type]  # None begins a generator
            except StopIteration as end:
                results[i] = end.value
        if not requests:
            break
        waiting = {i: several for i, several in requests.items() if any(map(last, several))}
        if len(waiting) == len(requests):
            waiting = {}
        requests = {i: requests[i] for i in sorted(requests) if i not in waiting}
        answers = yield [request for several in requests.values() for request in several]
        outcomes, at = {}, 0
        for i, several in requests.items():
            outcomes[i] = answers[at : at + len(several)]
            at += len(several)
    return [results[i] for i in range(len(computations))]


def timed(computation: Computation[Result]) -> Computation[tuple[Result, float]]:
    """The result of a computation and its cost, s: of its own code and of what it requested, without waiting."""
    seconds, outcomes = 0.0, None
    while True:
        began = time.perf_counter()
        try:
            requests = computation.send(outcomes)  # type: ignore[arg-type]
        except StopIteration as end:
            return end.value, seconds + time.perf_counter() - began
        seconds += time.perf_counter() - began
        outcomes = yield requests
        seconds += sum(outcome.seconds for outcome in outcomes)


def altered(computation: Computation[Result], alter: Callable[[Request], Request]) -> Computation[Result]:
    """The computation, with each of its requests replaced by what `alter` makes of it."""
    outcomes = None
    while True:
        try:
            requests = computation.send(outcomes)  # type: ignore[arg-type]
        except StopIteration as end:
            result: Result = end.value
            return result
        outcomes = yield [alter(request) for request in requests]


def within(seconds: float, computation: Computation[Result]) -> Computation[Result]:
    """The computation, all its requests to be answered within `seconds` of its begin on the wall clock."""
    until_s = time.monotonic() + seconds

    def bounded(request: Request) -> Request:
        remaining_s = until_s - time.monotonic()
        return replace(request, seconds=remaining_s if request.seconds is None else min(remaining_s, request.seconds))

    return (yield from altered(computation, bounded))


def run(computation: Computation[Result], answer: Handler | None = None) -> Result:
    """Run a computation to its end; raises what it raises. By default each call is made without limit of time."""
    answer, outcomes = answer or DirectHandler(), None
    while True:
        try:
            requests = computation.send(outcomes)  # type: ignore[arg-type]
        except StopIteration as end:
            result: Result = end.value
            return result
        outcomes = answer(requests)


@dataclass(frozen=True)
class DirectHandler:
    """Makes the calls one after another, one for all items of an owner, by `bounded` with a limit of time.

    Where a call for several requests fails, each is answered by a call of its own, so that one with bad items spoils no
    other. The requests of one list share their time, unless they are of `strangers` to one another.
    """

    bounded: Bounded | None = None
    strangers: bool = False

    def __call__(self, requests: list[Request]) -> list[RequestOutcome]:
        """Outcomes in the order of `requests`."""
        began = time.monotonic()
        groups: dict[int, list[int]] = {}
        for i, request in enumerate(requests):
            groups.setdefault(-1 - i if request.items is None else id(request.owner), []).append(i)
        by_index: dict[int, RequestOutcome] = {}
        for group in groups.values():
            spent = 0.0 if self.strangers else time.monotonic() - began
            outcomes = self._group([requests[i] for i in group], spent)
            by_index.update(zip(group, outcomes, strict=True))
        return [by_index[i] for i in range(len(requests))]

    def _group(self, requests: list[Request], spent: float) -> list[RequestOutcome]:
        whole = self._outcome(_joined(requests), spent)
        if len(requests) == 1:
            return [whole]
        if whole.error is not None or len(whole.value) != sum(len(request.items or ()) for request in requests):
            return [self._outcome(request, spent) for request in requests]
        out, at, each = [], 0, whole.seconds / max(len(whole.value), 1)
        for request in requests:
            n = len(request.items or ())
            out.append(RequestOutcome(whole.value[at : at + n], seconds=n * each))
            at += n
        return out

    def _outcome(self, request: Request, spent: float) -> RequestOutcome:
        began = time.perf_counter()
        call = request.call if request.items is None else lambda: request.call(request.items)
        remaining_s = None if request.seconds is None else request.seconds - spent
        try:
            value = call() if self.bounded is None else self.bounded(request.owner, call, remaining_s)
        except Exception as error:  # whatever it is, the computation decides
            return RequestOutcome(error=error, seconds=time.perf_counter() - began)
        return RequestOutcome(value, seconds=time.perf_counter() - began)


def _joined(requests: list[Request]) -> Request:
    if len(requests) == 1:
        return requests[0]
    times = [request.seconds for request in requests if request.seconds is not None]
    longest = max(times) if len(times) == len(requests) else None
    return replace(requests[0], items=[item for request in requests for item in request.items or ()], seconds=longest)
