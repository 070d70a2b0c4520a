"""Questions to many buildings at once: who does not answer is left out, with the most it may draw set aside."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from numbers import Real
from typing import TypeVar

import numpy as np

from controllers.checks import message_of
from controllers.coordination.limit import SharedPower
from controllers.coordination.member import LIMIT_TOLERANCE_KW, Answer, Member, Settled
from thermoforce_mpc.data import Array

A = TypeVar("A", Answer, Settled)
B = TypeVar("B")

# Answers that are kept, of all buildings together: what a linear programme combines in a second.
_ANSWERS = 1200
# Powers above so many times the most that a building may draw, or 1 kW, are a mistake, such as W for kW, which would
# drive the price out of what the others can solve; a cost beyond the second, currency, would drown theirs.
_TIMES_LARGEST, _MOST_COST = 100.0, 1e9


class Conversation:
    """The buildings that answer, what they answered, and what is left for them of what is shared.

    `members` by name; `silent`: why a building is left out, by name; `powers`: the last power of each, kW (N,);
    `answers`: the last answers of each; `reserved_kW` (N,); `messages`: vectors sent either way.
    """

    def __init__(self, members: Sequence[Member], shared: SharedPower, executor: Executor | None) -> None:
        self._shared = shared
        self._map: Callable[[Callable[[Member], B], Iterable[Member]], Iterable[B]] = executor.map if executor else map
        self.members = {member.name: member for member in members}
        self.silent: dict[str, str] = {}
        self.powers: dict[str, Array] = {}
        self.answers: dict[str, deque[Answer]] = {}
        self.reserved_kW = np.zeros(shared.limit_kW.size)
        self.messages = 0

    @property
    def left(self) -> SharedPower:
        """What is shared, less what is set aside."""
        return self._shared.less(self.reserved_kW)

    @property
    def mean_kW(self) -> Array:
        """Mean of the last powers (N,)."""
        powers = list(self.powers.values())
        return np.mean(powers, axis=0) if powers else np.zeros(self.reserved_kW.size)

    @property
    def excess(self) -> float:
        """Largest power above the limit, relative to it."""
        limit, total = self.left.limit_kW, len(self.powers) * self.mean_kW
        limited = np.isfinite(limit)
        return float(np.max((total - limit)[limited] / np.maximum(limit[limited], 1e-6), initial=0.0))

    @property
    def why_over(self) -> str:
        """'', or why the limit may be exceeded whatever the others do."""
        return self._shared.why_over(self.reserved_kW, len(self.silent))

    def all_answer(self, question: Callable[[Member], Answer | None]) -> None:
        """Ask all, keep what they answer, and leave out who does not."""
        for member, answer, why in self.ask(question):
            if answer is None:
                self.leave_out(member, why)
                continue
            self.powers[member.name] = answer.power_kW
            self.keep(member, answer)

    def all_at(self, price: Array, settled: Mapping[str, Settled]) -> float:
        """Least sum of cost and price · power of all, currency; −∞ if one does not answer, which costs only that.

        Of each building the least that is known, among it its plan: what it answers may not be the least.
        """
        nothing, total = np.zeros(price.size), 0.0
        for member, answer, _ in self.ask(lambda member: member.answer(price, nothing, 0.0)):
            if answer is None:
                total = -np.inf
                continue
            self.keep(member, answer)
            known: list[Answer | Settled] = [*self.answers[member.name], settled[member.name]]
            total += min(each.cost + float(price @ each.power_kW) for each in known)
        return total

    def keep(self, member: Member, answer: Answer) -> None:
        """Keep an answer in place of an old one."""
        self.answers.setdefault(member.name, deque(maxlen=max(_ANSWERS // len(self.members), 1))).append(answer)

    def leave_out(self, member: Member, why: str) -> None:
        """Leave a building to its own controller."""
        self.silent[member.name] = why
        self.reserved_kW = self.reserved_kW + member.largest_kW
        for kept in (self.members, self.powers, self.answers):
            kept.pop(member.name, None)

    def ask(self, question: Callable[[Member], A | None]) -> Iterator[tuple[Member, A | None, str]]:
        """Each building with its answer, and why that is none, or ''."""

        def asked(member: Member) -> tuple[A | None, str]:
            try:
                answer = question(member)
                return (None, "did not answer") if answer is None else self._fit(answer, member)
            except Exception as error:
                return None, f"did not answer ({message_of(error)})"

        members = list(self.members.values())
        self.messages += len(members)
        for member, (answer, why) in zip(members, list(self._map(asked, members)), strict=True):
            self.messages += answer is not None
            yield member, answer, why

    def plans(self, shares: Mapping[str, Array]) -> Iterator[tuple[Member, Settled | None, str]]:
        """Each building with its plan within its share, kW (N,), and why there is none, or ''."""
        for member, plan, why in self.ask(lambda member: member.settle(shares[member.name])):
            if plan is not None and (plan.power_kW > shares[member.name] + LIMIT_TOLERANCE_KW).any():
                yield member, None, "answered with powers above its share of the limit"
            else:
                yield member, plan, why

    def _fit(self, answer: A, member: Member) -> tuple[A | None, str]:
        """The answer in numbers of its own, or None and why it is none."""
        power, cost = answer.power_kW, answer.cost
        if not isinstance(power, np.ndarray):
            return None, f"answered with powers in a {type(power).__name__}, not an array"
        if power.shape != self.reserved_kW.shape:
            return None, f"answered with powers of shape {power.shape}, not {self.reserved_kW.shape}"
        if power.dtype.kind not in "fiu" or not isinstance(cost, Real):
            return None, f"answered with powers of type {power.dtype} and a cost in a {type(cost).__name__}"
        # A copy: the building may write its next answer into the same array; what is masked in it counts.
        power, cost = np.array(power, dtype=np.float64, subok=False), float(cost)
        if not (np.isfinite(power).all() and np.isfinite(cost)):
            return None, "answered with numbers that are not finite"
        if (power < -LIMIT_TOLERANCE_KW).any():  # the others would get what it claims to give
            return None, f"answered with a power below 0 kW ({power.min():.4g} kW)"
        if power.max() > _TIMES_LARGEST * max(float(np.max(member.largest_kW)), 1.0) or abs(cost) > _MOST_COST:
            return None, f"answered with {power.max():.4g} kW at a cost of {cost:.4g}, which no building like it has"
        return replace(answer, power_kW=np.maximum(power, 0.0), cost=cost), ""
