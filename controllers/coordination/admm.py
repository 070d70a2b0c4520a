"""Agreement of buildings on their powers under a shared limit or peak price, each solving its own programme.

The sharing problem of Boyd et al. (2011), Distributed optimization and statistical learning via the alternating
direction method of multipliers, section 7.3: minimise Σ_i f_i(p_i) + g(Σ_i p_i) over the powers p_i of H buildings. In
scaled form with the mean p̄ = Σ p_i / H, over-relaxed (their section 3.4.3),

    p_i ← argmin f_i(p_i) + ρ/2 |p_i − (p_i − p̄ + z̄ − w)|²        each building, at the same time
    z̄   ← argmin g(H z̄) + Hρ/2 |z̄ − w − p̄|²                       the coordinator
    w   ← w + p̄ − z̄                                               ρ w is the price of power

with ρ by residual balancing (section 3.4.1). One wish goes to a building and one power comes back per iteration. Then
every building plans within its share of the limit, so that the limit holds whatever is left of the residual, and the
dual function at the price bounds the cost from below: the gap between them is known without the joint optimum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor

import numpy as np
from pydantic import Field

from controllers.coordination.conversation import Conversation
from controllers.coordination.limit import SharedPower
from controllers.coordination.member import Answer, Member
from controllers.coordination.settling import Agreement, better, settle
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.scenario.settings import StrictModel

_RELAXATION = 1.6
# ρ follows the ratio of the residuals, by at most this factor.
_BALANCED_EVERY, _FACTOR = 5, 3.0
# Where the residual stays large, plans are tried all the same.
_TRIED_EVERY = 20
# Mean power of a building below which it scales ρ no more, kW.
_LEAST_KW = 0.05


class Coordination(StrictModel):
    """Options of `coordinate`."""

    gap: float = Field(0.005, gt=0, description="cost above its lower bound at which to stop, relative")
    residual: float = Field(0.01, gt=0, description="residual, relative, at which plans and bound are tried")
    most_iterations: int = Field(200, ge=1, description="iterations before the best agreement so far is taken")
    price_per_kW: float = Field(0.05, gt=0, description="rough size of a price of power in a step, currency; scales ρ")


def coordinate(
    members: Sequence[Member],
    shared: SharedPower,
    config: Coordination | None = None,
    *,
    executor: Executor | None = None,
    on_iteration: Callable[[int, float], None] = lambda number, excess: None,
) -> Agreement:
    """Agree on powers; stops when the cost is within `config.gap` of its bound.

    Args:
        members: the buildings, each asked at the same time as the others.
        shared: limit and peak price of their summed power.
        config: options.
        executor: asks several at once; by default one after another.
        on_iteration: told the iteration and its excess over the limit, relative.

    Raises:
        DataError: no members, one name twice, or limits of another length.
    """
    names = [member.name for member in members]
    if not names or len(set(names)) < len(names):
        raise DataError("coordination: expected one building or more, each name once")
    for member in members:
        largest = np.asarray(member.largest_kW)
        if largest.shape != shared.limit_kW.shape or not (np.isfinite(largest) & (largest >= 0.0)).all():
            raise DataError(
                f"{member.name}: largest_kW has shape {largest.shape}, expected {shared.limit_kW.shape} with finite "
                "powers of at least 0 kW"
            )
    config = config or Coordination()
    talk = Conversation(members, shared, executor)
    price = np.zeros(shared.limit_kW.size)
    talk.all_answer(lambda member: member.answer(price, price, 0.0))
    agreement = None
    if talk.excess == 0.0 and not shared.peak_price_per_kW:
        agreement = settle(talk, price, config.price_per_kW, 0)
    weight = config.price_per_kW / max(float(talk.mean_kW.mean()), _LEAST_KW)
    z, tolerance, number = talk.mean_kW, config.residual, 0
    while talk.members and number < config.most_iterations and (agreement is None or agreement.gap > config.gap):
        number += 1
        before, mean, w, last = dict(talk.powers), talk.mean_kW, price / weight, z
        talk.all_answer(_near(before, mean - z + w, weight))
        if not talk.members:
            break
        count, now = len(talk.members), talk.mean_kW
        relaxed = _RELAXATION * now + (1.0 - _RELAXATION) * z
        z = talk.left.nearest(count * (relaxed + w), weight / count) / count
        price = weight * (w + relaxed - z)
        on_iteration(number, talk.excess)
        # Residuals of p_i = z_i with z_i = p_i + z̄ − p̄, each relative to what it is a difference of.
        moved = _norm(power + (z - now) - before[name] - (last - mean) for name, power in talk.powers.items())
        size = max(_norm(talk.powers.values()), _norm([z]) * count**0.5, 1e-9)
        primal, dual = count**0.5 * _norm([now - z]) / size, weight * moved / max(count**0.5 * _norm([price]), 1e-9)
        if max(primal, dual) <= tolerance or number % _TRIED_EVERY == 0:
            tried = settle(talk, price, config.price_per_kW, number)
            price = tried.price_per_kW
            agreement = better(agreement, tried)
            tolerance = min(tolerance, max(primal, dual) / 2.0) if max(primal, dual) <= tolerance else tolerance
        if number % _BALANCED_EVERY == 0:
            weight *= min(max((primal / max(dual, 1e-12)) ** 0.5, 1.0 / _FACTOR), _FACTOR)
    if agreement is None or len(talk.silent) > len(
        agreement.silent
    ):  # the others have to make room for who fell silent since
        agreement = settle(talk, price, config.price_per_kW, number)
    return agreement


def _near(powers: Mapping[str, Array], away: Array, weight: float) -> Callable[[Member], Answer | None]:
    nothing = np.zeros(away.size)
    return lambda member: member.answer(nothing, powers[member.name] - away, weight)


def _norm(vectors: Iterable[Array]) -> float:
    return float(np.sqrt(sum(float(vector @ vector) for vector in vectors)))
