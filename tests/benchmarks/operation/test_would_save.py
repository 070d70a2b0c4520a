"""`bench saving --mode worth`: what is said is judged by what the same controller saves in the house itself."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.operation.would_save import ROOMS, WorthCase, run_worth_case, worth_targets
from thermoforce_mpc.data import DAY_S, HOUR_S, Block, Plan, PlanStatus
from thermoforce_mpc.errors import DataError

CASE = WorthCase(seed=7, number=0, days=1, houses=2, gate=False)


class Held:
    """Holds all valves at a level, or leaves them to themselves."""

    name, step_s, horizon_s = "held", HOUR_S, 6 * HOUR_S

    def __init__(self, level):
        self.level, self.lower_C = level, {}

    def plan(self, observation, state=None):
        self.lower_C |= {observation.time_s: observation.boundary.lower_C[:, 0]}
        return Plan((Block((self.level,) * ROOMS, HOUR_S),), PlanStatus.SOLVED, "held")


@pytest.fixture
def row_of(monkeypatch):
    """Of a controller that holds a level: the row of a house for which 0.5 to 1.5 is said to be saved."""
    asked = {}

    def said(model, record, conditions, controller, **rest):
        asked.update(rest, record=record, conditions=conditions)
        counted = dict.fromkeys(("cost_was", "outside_Kh", "outside_was_Kh"), 1.0)
        return SimpleNamespace(saved=1.0, low=0.5, high=1.5, raised_K=-0.5, **counted)

    room = "benchmarks.operation.would_save"
    monkeypatch.setattr(f"{room}.identify", lambda record, **_: SimpleNamespace(cards=(SimpleNamespace(unfit=False),)))
    monkeypatch.setattr(f"{room}.worth", said)
    monkeypatch.setattr(f"{room}.BEFORE_DAYS", 2)

    def run(level):
        asked["controller"] = Held(level)
        monkeypatch.setattr(f"{room}.ThermoForceMPC", lambda model, config: asked["controller"])
        return run_worth_case(CASE), asked

    return run


def test_the_truth_is_what_the_house_costs_under_the_same_controller(row_of):
    alone, asked = row_of(None)
    assert alone["true"] == 0.0
    assert alone["true_cost_was"] > 0.0
    assert not alone["holds"]
    np.testing.assert_allclose(asked["conditions"].time_s, asked["record"].time_s)
    assert asked["start_s"] + asked["days"] * DAY_S == asked["record"].time_s[-1]
    record, lower_C = asked["record"], np.fmin(asked["conditions"].lower_C, asked["record"].T_zone_C) - 0.5
    for time_s, seen_C in asked["controller"].lower_C.items():
        np.testing.assert_allclose(seen_C, lower_C[:, record.nearest(time_s)], err_msg=f"plans at {time_s} s")
    off, _ = row_of(0.0)
    assert off["true"] != 0.0, "days after it are paid for, too"
    assert off["true_outside_Kh"] > alone["true_outside_Kh"] + 1.0
    assert off["true"] < off["true_cost_was"]
    assert off["holds"] == (0.5 <= off["true"] <= 1.5)


def test_a_house_whose_record_does_not_tell_is_no_band_that_holds(row_of, monkeypatch):
    def refused(*_, **__):
        raise DataError("too short")

    monkeypatch.setattr("benchmarks.operation.would_save.worth", refused)
    row, _ = row_of(None)
    assert row["refused"] == "too short"
    assert row["true"] is None
    known = row | {"refused": "", "low": -1.0, "high": 2.0, "cost_was": 10.0}
    rows = [row, *(known | {"holds": holds} for holds in (True, True, True, False))]
    found = [(one.value, one.holds) for one in worth_targets(rows)]
    assert found == [(0.75, False), (4, False), (pytest.approx(0.15), True)]
