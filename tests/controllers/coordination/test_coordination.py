"""Buildings that share a limit or a peak price: the joint plan beside each alone, and who has no plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from mpc_problems import N, machinery_of, random_building, random_building_problem

from benchmarks.fleet.coordination import house
from controllers.checks import ControllerConfigError
from controllers.coordination import JointPlan, Member, SharedPower, plan_jointly
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import ProblemShape, every_step
from controllers.optimisation.solution import Solution, failed
from controllers.optimisation.solvers.qp import QPConfig
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError

_CONFIG = QPConfig()


def _houses(count: int) -> list[Member]:
    return [house(7, i) for i in range(count)]


def _alone(members: Sequence[Member]) -> list[JointPlan]:
    steps = members[0].power_at.size
    return [plan_jointly([member], SharedPower(np.full(steps, np.inf)), _CONFIG) for member in members]


def _free_kW(members: Sequence[Member]) -> Array:
    return np.sum([plan.total_kW for plan in _alone(members)], axis=0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "peak_price"), [(0.8, 0.0), (np.inf, 200.0), (0.9, 50.0)], ids=["limit", "peak price", "both"]
)
def test_what_is_shared_is_kept_at_a_cost_between_alone_and_equal_shares(share: float, peak_price: float) -> None:
    members = _houses(5)
    free_kW = _free_kW(members)
    limit_kW = np.full(free_kW.size, share * free_kW.max())
    shared = SharedPower(limit_kW, peak_price, peak_so_far_kW=0.7 * free_kW.max() if peak_price else 0.0)
    joint = plan_jointly(members, shared, _CONFIG)
    assert not joint.silent
    assert (joint.total_kW <= limit_kW).all()
    assert free_kW.max() > joint.total_kW.max() + 0.1  # it binds
    alone = sum(plan.cost for plan in _alone(members))
    assert alone < joint.cost
    at_most_kW = np.minimum(limit_kW, joint.total_kW.max())
    equal = [plan_jointly([member], SharedPower(at_most_kW / 5), _CONFIG).cost for member in members]
    assert joint.cost < sum(equal) + shared.cost(at_most_kW)
    assert joint.cost == pytest.approx(sum(s.cost for s in joint.solutions.values()) + shared.cost(joint.total_kW))


def test_a_limit_that_does_not_bind_costs_nothing() -> None:
    members = _houses(3)
    joint = plan_jointly(
        members, SharedPower(2.0 * _free_kW(members).max() * np.ones(members[0].power_at.size)), _CONFIG
    )
    assert joint.cost == pytest.approx(sum(plan.cost for plan in _alone(members)), rel=1e-5)


class _Spoilt(Member):
    """A house whose plan does not pass its check."""

    def checked(self, x: Array) -> Solution:
        return failed("jointly:solved", 0, "it is wrong")


class _Unsolvable(Member):
    """A house whose programme has no solution."""

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self.programme = replace(self.programme, x_low=self.programme.x_high + 1.0)


@pytest.mark.parametrize(("kind", "why"), [(_Spoilt, "it is wrong"), (_Unsolvable, "no solver finds a plan for it")])
def test_who_has_no_plan_gets_the_most_it_may_draw_set_aside(kind: type[Member], why: str) -> None:
    members = [house(7, 0, kind), *_houses(5)[1:]]
    limit_kW = np.full(members[1].power_at.size, 0.9 * _free_kW(_houses(5)).max())
    joint = plan_jointly(members, SharedPower(limit_kW), _CONFIG)
    assert joint.silent == {"house 0": why}
    assert set(joint.solutions) == {f"house {i}" for i in range(1, 5)}
    assert joint.reserved_kW == members[0].largest_kW
    assert (joint.total_kW + members[0].largest_kW <= limit_kW).all()


def test_a_limit_of_nothing_leaves_nothing() -> None:
    members = _houses(2)
    joint = plan_jointly(members, SharedPower(np.zeros(members[0].power_at.size)), _CONFIG)
    assert not joint.silent
    assert joint.total_kW.max() <= 1e-3


def _of_two_rooms(lowest_level: tuple[float, float] | None) -> Member:
    """A building of two heated rooms that are easily kept inside their band, by a machine each that may switch."""
    rng = np.random.default_rng(4)
    operator = random_building(rng, 2, (1, 1))
    if lowest_level is None:
        machinery = machinery_of(operator, (0, 0))
    else:
        machinery = machinery_of(operator, (0, 1), lowest_level=np.array(lowest_level))
    problem = random_building_problem(rng, operator, machinery)
    problem = replace(
        problem,
        T_free_C=np.full((2, N), 15.0),
        lower_C=np.full((2, N), 17.0),
        power_per_u2_W=np.full((2, N), 2000.0),
    )
    return Member("rooms", PlanModel(operator, ProblemShape(every_step(N), machinery)), problem, 10.0)


@pytest.mark.parametrize("lowest_level", [None, (0.4, 0.6)], ids=["modulates", "switches"])
def test_power_that_grows_faster_than_heat_keeps_the_limit(lowest_level: tuple[float, float] | None) -> None:
    curved = _of_two_rooms(lowest_level)
    (free,) = _alone([curved])
    limit_kW = np.full(N, 0.8 * free.total_kW.max())
    joint = plan_jointly([curved], SharedPower(limit_kW), _CONFIG)
    assert not joint.silent
    assert (joint.total_kW <= limit_kW).all()


@pytest.mark.parametrize(
    "of",
    [
        lambda: SharedPower(np.array([1.0, np.nan])),
        lambda: SharedPower(np.array([1.0, -1.0])),
        lambda: SharedPower(np.array([])),
        lambda: SharedPower(np.ones(3), -1.0),
    ],
)
def test_a_limit_or_price_that_is_none_is_refused(of: Callable[[], SharedPower]) -> None:
    with pytest.raises(DataError, match="shared power: "):
        of()


def test_a_problem_that_is_not_convex_is_refused() -> None:
    rng = np.random.default_rng(1)
    operator = random_building(rng, 2, (1, 1))
    either = machinery_of(operator, (0, 1), exclusive=((0, 1),))
    problem = random_building_problem(rng, operator, either)
    with pytest.raises(ControllerConfigError, match="convex"):
        Member("house", PlanModel(operator, ProblemShape(every_step(N), either)), problem, 10.0)
