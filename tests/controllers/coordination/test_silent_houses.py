"""Houses that share a limit and, at random moments, fall silent, come back or answer with what are no powers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from controllers.coordination import Answer, Coordination, Settled, SharedPower, coordinate
from controllers.optimisation.solution import Solution
from thermoforce_mpc.data import Array

N = 6
_NO_SOLUTION = Solution(True, np.zeros((1, N)), "settled", 0.0, 0)


class House:
    """Wants `_wanted_kW` (N,) of at most `largest_kW` (N,), at _stiffness/2 · |power − wanted|².

    `wrong`: what goes wrong at its questions, by their number.
    """

    def __init__(self, name: str, rng: np.random.Generator, wrong: Mapping[int, str]) -> None:
        self.name, self.largest_kW = name, rng.uniform(1.0, 6.0) * np.ones(N)
        self._wanted_kW = self.largest_kW * rng.uniform(0.0, 1.0, N)
        self._stiffness, self._fixed = 10.0 ** rng.uniform(-3.0, -1.0), rng.uniform(0.1, 1.0)
        self._wrong, self._questions = wrong, 0

    @property
    def always_well(self) -> bool:
        return not self._wrong

    def at(self, price: Array) -> Array:
        return np.clip(self._wanted_kW - price / self._stiffness, 0.0, self.largest_kW)

    def cost(self, power_kW: Array) -> float:
        return self._fixed + self._stiffness / 2.0 * float(((power_kW - self._wanted_kW) ** 2).sum())

    def answer(self, price: Array, wish_kW: Array, weight: float) -> Answer | None:
        pulled = (self._stiffness * self._wanted_kW - price + weight * wish_kW) / (self._stiffness + weight)
        power_kW = np.clip(pulled, 0.0, self.largest_kW)
        return self._spoilt(Answer(power_kW, self.cost(power_kW)))

    def settle(self, limit_kW: Array) -> Settled | None:
        power_kW = np.minimum(self._wanted_kW, limit_kW)
        return self._spoilt(Settled(_NO_SOLUTION, self.cost(power_kW), power_kW))

    def _spoilt(self, answer):  # type: ignore[no-untyped-def]
        self._questions += 1
        wrong = self._wrong.get(self._questions, "")
        if wrong == "raises":
            raise TimeoutError("no reply")
        if wrong == "nothing":
            return None
        return _SPOILT[wrong](answer) if wrong else answer


_SPOILT = {
    "nan": lambda a: replace(a, power_kW=np.full(N, np.nan)),
    "short": lambda a: replace(a, power_kW=a.power_kW[:-1]),
    "text": lambda a: replace(a, power_kW=a.power_kW.astype(str)),
    "complex": lambda a: replace(a, power_kW=a.power_kW + 1j),
    "complex cost": lambda a: replace(a, cost=a.cost + 1j),
    "cost in an array": lambda a: replace(a, cost=np.array([a.cost])),
    "cost beyond all": lambda a: replace(a, cost=-1e308),
    "negative": lambda a: replace(a, power_kW=a.power_kW - 50.0),
    "huge": lambda a: replace(a, power_kW=a.power_kW + 1e200),
    "masked": lambda a: replace(a, power_kW=np.ma.masked_array(a.power_kW + 1e4, np.arange(N) < 3)),
    "of another kind": lambda a: 7,
}
KINDS = ("raises", "nothing", *_SPOILT)


def _best(houses: Sequence[House], limit_kW: Array) -> float:
    """Least cost of the houses together within the limit: in each step the price at which they just keep it."""

    def over(price: float, k: int) -> float:
        return float(sum(house.at(np.full(N, price))[k] for house in houses) - limit_kW[k])

    prices = [brentq(over, 0.0, 1.0, args=(k,), xtol=1e-14) if over(0.0, k) > 0.0 else 0.0 for k in range(N)]
    return sum(house.cost(house.at(np.array(prices))) for house in houses)


def _free_kW(houses: Sequence[House]) -> Array:
    return np.sum([house.at(np.zeros(N)) for house in houses], axis=0)


@st.composite
def _moments(draw: st.DrawFn) -> dict[int, str]:
    """Nothing wrong, or one thing from some question on, for some or for good."""
    kind, first = draw(st.sampled_from(("", *KINDS))), draw(st.integers(1, 40))
    return dict.fromkeys(range(first, first + draw(st.sampled_from((1, 2, 10, 1000)))), kind) if kind else {}


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32),
    wrongs=st.lists(_moments(), min_size=1, max_size=4),
    share=st.floats(0.05, 1.3),
    most_iterations=st.sampled_from((1, 5, 20, 40)),
)
def test_limit_and_bound_hold_whenever_houses_fall_silent(
    seed: int, wrongs: list[dict[int, str]], share: float, most_iterations: int
) -> None:
    rng = np.random.default_rng(seed)
    houses = [House(f"house {i}", rng, wrong) for i, wrong in enumerate(wrongs)]
    limit_kW = share * _free_kW(houses).max() * rng.uniform(0.6, 1.0, N)
    agreement = coordinate(houses, SharedPower(limit_kW), Coordination(most_iterations=most_iterations))
    settled = [house for house in houses if house.name in agreement.settled]
    silent = [house for house in houses if house.name not in agreement.settled]
    assert set(agreement.silent) == {house.name for house in silent}
    assert not any(house.always_well for house in silent)
    reserved_kW = np.sum([house.largest_kW for house in silent], axis=0) if silent else np.zeros(N)
    if not agreement.why_over:
        assert (agreement.total_kW + reserved_kW <= limit_kW + 1e-9).all()
    best = _best(settled, np.maximum(limit_kW - reserved_kW, 0.0))
    assert agreement.bound <= best + 1e-6
    assert best <= agreement.cost + 1e-6
    assert agreement.gap >= -1e-6


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("last", [3, 1000], ids=["once", "for good"])
def test_what_is_no_answer_takes_out_the_house_that_gave_it_and_no_other(kind: str, last: int) -> None:
    rng = np.random.default_rng(3)
    houses = [
        House("wrong", rng, dict.fromkeys(range(3, last + 1), kind)),
        *(House(f"house {i}", rng, {}) for i in range(4)),
    ]
    limit_kW = houses[0].largest_kW + 0.7 * _free_kW(houses[1:]).max()
    agreement = coordinate(houses, SharedPower(limit_kW))
    assert set(agreement.silent) == {"wrong"}
    assert "answer" in agreement.silent["wrong"]
    assert agreement.gap <= 0.005
    assert (agreement.total_kW + houses[0].largest_kW <= limit_kW).all()


def test_a_house_that_writes_its_answers_into_one_array_agrees_as_others_do() -> None:
    class OneArray(House):
        _buffer = np.zeros(N)

        def answer(self, price: Array, wish_kW: Array, weight: float) -> Answer | None:
            found = super().answer(price, wish_kW, weight)
            self._buffer[:] = found.power_kW if found else np.nan
            return found and replace(found, power_kW=self._buffer)

    found = []
    for kind in (House, OneArray):
        rng = np.random.default_rng(5)
        houses = [kind("first", rng, {}), *(House(f"house {i}", rng, {}) for i in range(3))]
        found.append(coordinate(houses, SharedPower(np.full(N, 0.6 * _free_kW(houses).max()))))
    assert found[1].cost == found[0].cost
    assert found[1].bound == found[0].bound


def test_plans_that_use_the_tolerance_of_a_solver_keep_the_limit() -> None:
    class Above(House):
        def settle(self, limit_kW: Array) -> Settled | None:
            plan = super().settle(limit_kW)
            return plan and replace(plan, power_kW=plan.power_kW + 0.99e-5)

    rng = np.random.default_rng(4)
    houses = [Above(f"house {i}", rng, {}) for i in range(8)]
    limit_kW = np.full(N, 0.5 * _free_kW(houses).max())
    agreement = coordinate(houses, SharedPower(limit_kW))
    assert len(agreement.settled) == 8
    assert (agreement.total_kW <= limit_kW).all()


def test_an_answer_that_is_not_the_least_leaves_no_gap_below_nothing() -> None:
    class Dear(House):
        def answer(self, price: Array, wish_kW: Array, weight: float) -> Answer | None:
            found = super().answer(price, wish_kW, weight)
            return found if weight or found is None else replace(found, cost=found.cost + 1000.0)

    rng = np.random.default_rng(6)
    houses = [Dear("dear", rng, {}), *(House(f"house {i}", rng, {}) for i in range(4))]
    limit_kW = np.full(N, 0.4 * _free_kW(houses).max())
    agreement = coordinate(houses, SharedPower(limit_kW))
    assert -1e-6 <= agreement.gap <= 0.005
    assert agreement.cost == pytest.approx(_best(houses, limit_kW), rel=0.005)
