"""The thermostat that is as comfortable as a controller, on thermostats whose discomfort is a known function."""

from __future__ import annotations

import math

import pytest

from thermoforce_mpc.simulation.comparison.equal_comfort import AsComfortable, as_comfortable


class House:
    """Discomfort falls with the set-point, from `cold` K·h per K below `enough_K`; above `warm_K` it rises again."""

    def __init__(self, enough_K: float = 0.0, warm_K: float = 9.0, least_KH: float = 0.0) -> None:
        self.enough_K, self.warm_K, self.least_KH, self.runs = enough_K, warm_K, least_KH, []

    def __call__(self, shift_K: float) -> dict[str, float]:
        self.runs.append(shift_K)
        cold, warm = max(self.enough_K - shift_K, 0.0), max(shift_K - self.warm_K, 0.0)
        return {"cost_tot": 1.0 + 0.06 * shift_K, "tdis_tot": self.least_KH + 10.0 * (cold + warm)}

    def beside(self, discomfort_Kh: float) -> AsComfortable:
        return as_comfortable(self, self(0.0), discomfort_Kh)


@pytest.mark.parametrize("enough_K", [-1.0, -0.33, -0.05, 0.0, 0.12, 0.5, 1.2])
def test_it_is_the_coldest_set_point_that_is_comfortable_enough(enough_K):
    house = House(enough_K)
    found = house.beside(0.4)
    # 0.4 + 0.1 K·h are 0.05 K at 10 K·h per K.
    assert enough_K - 0.05 - 1e-6 <= found.shift_K <= enough_K + 0.02
    assert found.comparable
    assert found.kpis["tdis_tot"] <= 0.5 + 1e-9
    assert len(set(house.runs)) == len(house.runs) - 1 or len(set(house.runs)) == len(house.runs)
    assert len(house.runs) < 10


def test_a_colder_baseline_is_no_saving():
    """At its own set-point the thermostat costs less, and leaves 3 K·h more."""
    found = House(0.3).beside(0.0)
    assert House(0.3)(0.0)["cost_tot"] < 1.015
    assert found.kpis["cost_tot"] == pytest.approx(1.018, abs=0.004)
    assert found.saving(0.99) == pytest.approx(1.0 - 0.99 / found.kpis["cost_tot"])
    assert found.beaten(0.99) is True
    assert found.beaten(1.05) is False


@pytest.mark.parametrize("house", [House(0.3, warm_K=0.3, least_KH=5.0), House(0.0, warm_K=0.0, least_KH=2.0)])
def test_where_no_set_point_is_as_comfortable_it_is_the_best_there_is(house):
    found = house.beside(1.0)
    assert not found.comparable
    assert abs(found.shift_K - house.enough_K) <= 0.2
    assert found.beaten(0.9) is True, "cheaper and more comfortable"
    assert found.beaten(1.5) is None, "dearer and more comfortable: neither"
    assert len(house.runs) < 12


def test_what_costs_nothing_has_no_share_to_save():
    assert math.isnan(AsComfortable(0.0, {"cost_tot": 0.0, "tdis_tot": 0.0}, True).saving(1.0))
