"""Buildings that share a limit or a peak price: agreement beside the joint optimum, and silence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from controllers.coordination import Coordination, QPMember, SharedPower, coordinate, solve_jointly
from controllers.coordination.member import Answer, Settled
from controllers.errors import ControllerConfigError
from controllers.problem import ProblemShape, blocked_moves
from controllers.qp_backends import QPConfig
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.research.bench.zone_scaling import building_operator, building_problem

_CONFIG = QPConfig()


def _members(count: int) -> list[QPMember]:
    members = []
    for i in range(count):
        rng = np.random.default_rng([7, i])
        operator = building_operator(1, 0, rng)
        problem = replace(building_problem(operator, rng), power_cap=None)
        shape = ProblemShape(blocked_moves(problem.n_steps, 900.0, 6.0, 2.0), problem.machinery)
        members.append(QPMember(f"house {i}", operator, shape, problem, _CONFIG))
    return members


def _free_kW(members: Sequence[QPMember]) -> Array:
    nothing = np.zeros_like(members[0].largest_kW)
    answers = [member.answer(nothing, nothing, 0.0) for member in members]
    return np.sum([answer.power_kW for answer in answers if answer], axis=0)


@pytest.mark.parametrize(
    ("share", "peak_price"), [(0.8, 0.0), (np.inf, 200.0), (0.9, 50.0)], ids=["limit", "peak price", "both"]
)
def test_agreement_is_near_the_joint_optimum_and_inside_the_limit(share: float, peak_price: float) -> None:
    members = _members(5)
    free_kW = _free_kW(members)
    limit_kW = np.full(free_kW.size, share * free_kW.max())
    shared = SharedPower(limit_kW, peak_price, peak_so_far_kW=0.7 * free_kW.max() if peak_price else 0.0)
    agreement = coordinate(members, shared)
    best, powers = solve_jointly(members, shared, QPConfig(tolerance=1e-6))
    assert (agreement.total_kW <= limit_kW).all()
    assert free_kW.max() > agreement.total_kW.max() + 0.1  # it binds
    assert (powers.sum(axis=0) <= limit_kW + 1e-4).all()
    assert agreement.bound <= best * (1 + 1e-4)
    assert best <= agreement.cost * (1 + 1e-4)
    assert agreement.gap <= 0.005
    assert agreement.cost == pytest.approx(best, rel=0.01)
    plans = agreement.settled.values()
    assert sum(plan.cost for plan in plans) + shared.cost(agreement.total_kW) == pytest.approx(agreement.cost)


def test_a_limit_that_does_not_bind_costs_nothing() -> None:
    members = _members(3)
    shared = SharedPower(1.5 * np.sum([member.largest_kW for member in members], axis=0))
    agreement = coordinate(members, shared)
    assert agreement.iterations == 0
    assert not agreement.price_per_kW.any()
    assert agreement.cost == pytest.approx(agreement.bound, rel=1e-4)
    assert agreement.messages == 18  # three rounds to three houses and back


class _Silent:
    """A house that stops to answer after some questions, by raising or with numbers that are none."""

    def __init__(self, inner: QPMember, after: int, how: str) -> None:
        self.name, self.largest_kW, self._inner, self._left, self._how = inner.name, inner.largest_kW, inner, after, how

    def answer(self, price: Array, wish_kW: Array, weight: float) -> Answer | None:
        self._left -= 1
        if self._left < 0:
            if self._how == "raises":
                raise TimeoutError("no reply in 5 s")
            return None if self._how == "nothing" else Answer(np.full_like(price, np.nan), 1.0)
        return self._inner.answer(price, wish_kW, weight)

    def settle(self, limit_kW: Array) -> Settled | None:
        return None if self._left < 0 or self._how == "settling" else self._inner.settle(limit_kW)


@pytest.mark.parametrize(
    ("after", "how"), [(0, "raises"), (3, "nothing"), (2, "not finite"), (10**6, "settling")], ids=lambda v: str(v)
)
def test_the_limit_holds_whatever_a_silent_house_draws(after: int, how: str) -> None:
    members = _members(5)
    limit_kW = np.full(members[0].largest_kW.size, 0.9 * _free_kW(members).max())
    agreement = coordinate([_Silent(members[0], after, how), *members[1:]], SharedPower(limit_kW))
    assert set(agreement.silent) == {"house 0"}
    assert set(agreement.settled) == {f"house {i}" for i in range(1, 5)}
    assert (agreement.reserved_kW == members[0].largest_kW).all()
    assert (agreement.total_kW + members[0].largest_kW <= limit_kW).all()
    assert agreement.why_over == ""
    assert agreement.gap <= 0.005
    if how == "raises":
        assert "no reply in 5 s" in agreement.silent["house 0"]


def test_a_limit_that_silent_houses_may_exceed_is_said() -> None:
    members = _members(2)
    shared = SharedPower(np.full(members[0].largest_kW.size, 0.1))
    agreement = coordinate([_Silent(members[0], 0, "nothing"), members[1]], shared)
    assert "may draw" in agreement.why_over
    assert agreement.total_kW.max() <= 1e-3


def test_who_agrees_on_nothing_is_refused() -> None:
    members = _members(1)
    n = members[0].largest_kW.size
    with pytest.raises(DataError, match="each name once"):
        coordinate([*members, *members], SharedPower(np.ones(n)))
    with pytest.raises(DataError, match=r"house 0: largest_kW has shape"):
        coordinate(members, SharedPower(np.ones(n + 1)))
    with pytest.raises(DataError, match="limit_kW"):
        SharedPower(np.array([1.0, np.nan]))
    with pytest.raises(DataError, match="peak_price_per_kW"):
        SharedPower(np.ones(n), -1.0)


def test_one_iteration_leaves_a_limit_that_holds() -> None:
    members = _members(4)
    limit_kW = np.full(members[0].largest_kW.size, 0.8 * _free_kW(members).max())
    agreement = coordinate(members, SharedPower(limit_kW), Coordination(most_iterations=1))
    assert agreement.iterations == 1
    assert (agreement.total_kW <= limit_kW).all()


def test_a_problem_that_is_not_convex_is_refused() -> None:
    rng = np.random.default_rng(1)
    operator = building_operator(1, 0, rng)
    problem = replace(building_problem(operator, rng), power_cap=None)
    held = replace(problem.machinery, lowest_level=np.array([0.3]))
    shape = ProblemShape(blocked_moves(problem.n_steps, 900.0, 6.0, 2.0), held)
    with pytest.raises(ControllerConfigError, match="convex"):
        QPMember("house", operator, shape, replace(problem, machinery=held), _CONFIG)
