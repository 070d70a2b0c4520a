"""Buildings that share a limit or a peak price: agreement beside the joint optimum, and silence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy_problem
import pytest
from mpc_problems import N, machinery_of, random_building, random_building_problem

from benchmarks.fleet.joint_optimum import solve_jointly
from benchmarks.zones.scaling import building_operator, building_problem
from controllers.checks import ControllerConfigError
from controllers.coordination import Coordination, QPMember, SharedPower, coordinate
from controllers.coordination.member import Answer, Settled
from controllers.optimisation.problem import Cooling, ProblemShape, blocked_moves, every_step
from controllers.optimisation.solvers.qp_backends import QPConfig
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError

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
            power = {"not finite": np.full_like(price, np.nan), "other shape": price[:3], "list": [1.0] * price.size}
            if self._how == "cost not finite":
                return Answer(np.zeros_like(price), np.nan)
            return Answer(power[self._how], 1.0) if self._how in power else None  # type: ignore[arg-type]
        return self._inner.answer(price, wish_kW, weight)

    def settle(self, limit_kW: Array) -> Settled | None:
        if self._left < 0 or self._how == "settling":
            return None
        plan = self._inner.settle(limit_kW)
        wrong = {"above": 5.0, "settling not finite": np.nan}
        return plan and replace(plan, power_kW=plan.power_kW + wrong.get(self._how, 0.0))


@pytest.mark.parametrize(
    ("after", "how"),
    [
        (0, "raises"),
        (3, "nothing"),
        (2, "not finite"),
        (1, "cost not finite"),
        (1, "other shape"),
        (1, "list"),
        (10**6, "settling"),
        (10**6, "above"),
        (10**6, "settling not finite"),
    ],
    ids=lambda v: str(v),
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


def test_who_falls_silent_while_the_bound_is_asked_for_ends_no_search() -> None:
    members = _members(5)
    limit_kW = np.full(members[0].largest_kW.size, 0.8 * _free_kW(members).max())
    # Plans are tried at iteration 20; the answer after it is the first of those that make the bound.
    gone = coordinate([_Silent(members[0], 21, "raises"), *members[1:]], SharedPower(limit_kW))
    assert set(gone.silent) == {"house 0"}
    assert (gone.total_kW + members[0].largest_kW <= limit_kW).all()
    best, _ = solve_jointly(members[1:], SharedPower(limit_kW - members[0].largest_kW), QPConfig(tolerance=1e-6))
    assert gone.bound <= best * (1 + 1e-4)
    assert gone.cost == pytest.approx(best, rel=0.01)
    assert gone.gap <= 0.005
    stopped = coordinate(
        [_Silent(members[0], 21, "raises"), *members[1:]], SharedPower(limit_kW), Coordination(most_iterations=20)
    )
    assert stopped.gap == np.inf  # there is a plan of each, and no bound


def test_who_falls_silent_after_plans_were_found_has_no_part_in_them() -> None:
    members = _members(5)
    limit_kW = np.full(members[0].largest_kW.size, 0.45 * _free_kW(members).max())
    # All have plans at iteration 20, with a gap that is too large; nobody plans again until the last iteration.
    house = _Silent(members[0], 27, "raises")
    agreement = coordinate([house, *members[1:]], SharedPower(limit_kW), Coordination(most_iterations=30))
    assert set(agreement.silent) == {"house 0"}
    assert set(agreement.settled) == {f"house {i}" for i in range(1, 5)}
    assert (agreement.total_kW + members[0].largest_kW <= limit_kW).all()
    assert agreement.gap < np.inf


def test_a_limit_that_silent_houses_may_exceed_is_said() -> None:
    members = _members(2)
    shared = SharedPower(np.full(members[0].largest_kW.size, 0.1))
    agreement = coordinate([_Silent(members[0], 0, "nothing"), members[1]], shared)
    assert "may draw" in agreement.why_over
    assert agreement.total_kW.max() <= 1e-3


def _of_two_rooms(**changes: object) -> QPMember:
    """A building of two heated rooms that are easily kept inside their band."""
    rng = np.random.default_rng(4)
    operator = random_building(rng, 2, (1, 1))
    problem = random_building_problem(rng, operator, machinery_of(operator, (0, 0)))
    problem = replace(problem, T_free_C=np.full((2, N), 15.0), lower_C=np.full((2, N), 17.0), **changes)
    return QPMember("rooms", operator, ProblemShape(every_step(N), problem.machinery), problem, _CONFIG)


def _of_two_machines(**changes: object) -> QPMember:
    """The same with a machine in each room, which holds levels from 0.4 or 0.6 on and switches below."""
    rng = np.random.default_rng(4)
    operator = random_building(rng, 2, (1, 1))
    machinery = machinery_of(operator, (0, 1), lowest_level=np.array([0.4, 0.6]))
    problem = random_building_problem(rng, operator, machinery)
    problem = replace(problem, T_free_C=np.full((2, N), 15.0), lower_C=np.full((2, N), 17.0), **changes)
    return QPMember("rooms", operator, ProblemShape(every_step(N), machinery), problem, _CONFIG)


@pytest.mark.parametrize("of", [_of_two_rooms, _of_two_machines])
def test_power_that_grows_faster_than_heat_keeps_its_share_of_the_limit(of: Callable[..., QPMember]) -> None:
    curved = of(power_per_u2_W=np.full((2, N), 2000.0))
    nothing = np.zeros(N)
    free = curved.answer(nothing, nothing, 0.0)
    assert free is not None
    limit_kW = np.full(N, 0.8 * free.power_kW.max())
    settled = curved.settle(limit_kW)
    assert settled is not None
    assert (settled.power_kW <= limit_kW + 1e-5).all()


def test_the_most_a_building_may_draw_is_heating_in_one_room_and_cooling_in_another() -> None:
    per_u, cold = np.repeat([[1000.0], [3000.0]], N, axis=1), np.repeat([[2500.0], [500.0]], N, axis=1)
    rng = np.random.default_rng(4)
    operator = random_building(rng, 2, (1, 1))
    machinery = machinery_of(operator, (0, 1), u_min=np.array([-1.0, -1.0]))
    numbers = {
        "power_fixed_W": np.zeros((2, N)),
        "power_per_u_W": per_u,
        "cooling": Cooling(np.full((2, N), 0.2), cold),
    }
    problem = random_building_problem(rng, operator, machinery, **numbers)
    member = QPMember("rooms", operator, ProblemShape(every_step(N), machinery), problem, _CONFIG)
    assert member.largest_kW == pytest.approx(5.5)
    assert numpy_problem.power_W(problem, np.repeat([[-1.0], [1.0]], N, axis=1)).sum(axis=0) == pytest.approx(5500.0)


def test_who_agrees_on_nothing_is_refused() -> None:
    members = _members(1)
    n = members[0].largest_kW.size
    with pytest.raises(DataError, match="each name once"):
        coordinate([*members, *members], SharedPower(np.ones(n)))
    with pytest.raises(DataError, match=r"house 0: largest_kW has shape"):
        coordinate(members, SharedPower(np.ones(n + 1)))
    house = _Silent(members[0], 0, "nothing")
    house.largest_kW = -house.largest_kW
    with pytest.raises(DataError, match=r"house 0: largest_kW .* at least 0 kW"):
        coordinate([house], SharedPower(np.ones(n)))
    for limit_kW in ([1.0, np.nan], [1.0, -1.0], []):
        with pytest.raises(DataError, match="limit_kW"):
            SharedPower(np.array(limit_kW))
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
    operator = random_building(rng, 2, (1, 1))
    either = machinery_of(operator, (0, 1), exclusive=((0, 1),))
    problem = random_building_problem(rng, operator, either)
    with pytest.raises(ControllerConfigError, match="convex"):
        QPMember("house", operator, ProblemShape(every_step(N), either), problem, _CONFIG)
