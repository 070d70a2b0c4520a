"""From powers that nearly keep a limit to plans that keep it, and how far their cost may be from the best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from controllers.coordination.conversation import Conversation
from controllers.coordination.member import LIMIT_TOLERANCE_KW, Settled
from controllers.coordination.recovery import combined
from thermoforce_mpc.data import Array

# The shares of the limit stay below it by this, relative, for rounding, and by the tolerance of each building's plan.
_BELOW = 1e-6
# Of the limit this is shared equally: an interior point method needs room above no power at all.
_EQUALLY = 1e-3
# What is above the limit in no known combination of answers costs this many times the highest price.
_OVER = 10.0


@dataclass(frozen=True, eq=False)
class Agreement:
    """What buildings agreed on over N steps.

    `settled`: plans by name; `silent`: why a building is left out, by name: it keeps its own controller and
    `reserved_kW` (N,), the most it may draw, is set aside for it. `price_per_kW` (N,): price of power in each step,
    currency. `total_kW` (N,): power of all settled plans. `cost`, `bound`: their cost, and what it is at least for
    these buildings, currency, −∞ where that is not known. `messages`: vectors sent either way. `why_over`: '', or why
    the limit may be exceeded.
    """

    settled: Mapping[str, Settled]
    silent: Mapping[str, str]
    reserved_kW: Array
    price_per_kW: Array
    total_kW: Array
    cost: float
    bound: float
    iterations: int
    messages: int
    why_over: str = ""

    @property
    def gap(self) -> float:
        """How much of the cost may at most be saved, relative to its bound; infinite where there is no bound."""
        if not np.isfinite(self.bound):  # a building was silent when it was asked for the bound
            return np.inf
        return (self.cost - self.bound) / max(abs(self.bound), 1e-9)


def better(former: Agreement | None, tried: Agreement) -> Agreement:
    """Of an agreement and a later one the cheaper, with the higher bound of both; the later where more are silent."""
    if former is None or len(tried.silent) > len(former.silent):
        return tried
    best = min(former, tried, key=lambda agreement: agreement.cost)
    bound = max(former, tried, key=lambda agreement: agreement.bound)
    return replace(best, bound=bound.bound, price_per_kW=bound.price_per_kW)


def settle(talk: Conversation, price: Array, price_per_kW: float, iterations: int) -> Agreement:
    """Plans within shares of the limit. `price` (N,): the latest, currency/kW; `price_per_kW`: size of one.

    The agreement's price is the better one of `price` and that of the combination of answers which the shares are.
    """
    settled: dict[str, Settled] = {}
    prices = [price]
    while talk.members:
        count, settled = len(talk.members), {}
        shares, prices = _shares(talk, price, price_per_kW)
        for member, plan, why in talk.plans(shares):
            if plan is None:
                talk.leave_out(member, f"asked for a plan within its share of the limit, it {why}")
            else:
                settled[member.name] = plan
        if len(talk.members) == count:
            break
        # The others have to make room for who fell silent.
    bounds = []
    for each in prices:
        finite, least = talk.left.least(np.maximum(each, 0.0))
        bounds.append((talk.all_at(finite, settled) + least, finite))
    bound, best = max(bounds, key=lambda pair: pair[0])
    total = sum((plan.power_kW for plan in settled.values()), np.zeros(price.size))
    return Agreement(
        settled=settled,
        silent=dict(talk.silent),
        reserved_kW=talk.reserved_kW,
        price_per_kW=best,
        total_kW=total,
        cost=sum(plan.cost for plan in settled.values()) + talk.left.cost(total),
        bound=bound,
        iterations=iterations,
        messages=talk.messages,
        why_over=talk.why_over,
    )


def _shares(talk: Conversation, price: Array, price_per_kW: float) -> tuple[dict[str, Array], list[Array]]:
    """Shares of the limit by name, kW (N,), and prices that may be better than `price`.

    Powers of least cost that are known, scaled down where they exceed the limit, else with what is left of it.
    """
    left, powers, prices = talk.left, dict(talk.powers), [price]
    several = any(len(kept) > 1 for kept in talk.answers.values())
    if several and (combination := combined(talk.answers, left, _OVER * max(float(price.max()), price_per_kW))):
        powers = combination[0]
        prices.append(combination[1])
    total, count = np.sum(list(powers.values()), axis=0), len(powers)
    limit = left.limit_kW
    if left.peak_price_per_kW:
        limit = np.minimum(limit, max(float(total.max()), left.peak_so_far_kW))  # the peak they agreed on
    limit = np.maximum(limit * (1.0 - _BELOW) - count * LIMIT_TOLERANCE_KW, 0.0)
    scale = np.minimum(limit / np.maximum(total, 1e-9), 1.0) * (1.0 - _EQUALLY)
    spare = np.where(limit > total, limit - total * scale, _EQUALLY * limit) / count
    return {name: power * scale + spare for name, power in powers.items()}, prices
