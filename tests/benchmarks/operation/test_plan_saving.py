"""`bench saving --mode plan`: what is said of a plan in levels is judged by the house that lives it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.operation.plan_saving import ROOMS, PlanCase, plan_targets, run_plan_case
from thermoforce_mpc.errors import DataError

ROOM = "benchmarks.operation.plan_saving"


class Held:
    """Holds all valves at a level."""

    def __init__(self, level):
        self.level = level

    def plan(self, observation):
        return SimpleNamespace(u=np.full((ROOMS[0], 24), self.level))


@pytest.fixture
def rows_of(monkeypatch):
    """Of plans that hold a level, of which 0.5 to 1.5 is said to be saved."""
    monkeypatch.setattr(f"{ROOM}.identify", lambda record, **_: None)
    monkeypatch.setattr(f"{ROOM}.BEFORE_DAYS", 2)

    def run(level, said=lambda *_: SimpleNamespace(saved=1.0, low=0.5, high=1.5, cost_alone=2.0)):
        monkeypatch.setattr(f"{ROOM}.ThermoForceMPC", lambda model, config: Held(level))
        monkeypatch.setattr(f"{ROOM}.saving_of_levels", said)
        return run_plan_case(PlanCase(seed=7, number=0, days=2))

    return run


def test_the_truth_is_what_the_house_costs_both_ways_with_the_days_after(rows_of):
    off, full = rows_of(0.0), rows_of(1.0)
    assert [row["true_cost_alone"] for row in off] == [row["true_cost_alone"] for row in full]
    for one, other in zip(off, full, strict=True):
        assert 0.0 < one["true"] < one["true_cost_alone"], "what a cold house needs later is paid for"
        assert other["true"] < 0.0
        assert one["holds"] == (0.5 <= one["true"] <= 1.5)
        assert not other["holds"]


def test_a_plan_of_which_nothing_is_said_is_no_band_that_holds(rows_of):
    def refused(*_):
        raise DataError("no habit")

    rows = rows_of(0.3, refused)
    assert [row["refused"] for row in rows] == ["no habit"] * 2
    known = rows[0] | {"refused": "", "low": -1.0, "high": 2.0, "true_cost_alone": 10.0}
    rows += [known | {"holds": holds} for holds in (True, True, True, False)]
    found = [(one.value, one.holds) for one in plan_targets(rows)]
    assert found == [(0.75, False), (4, True), (pytest.approx(0.15), True)]
