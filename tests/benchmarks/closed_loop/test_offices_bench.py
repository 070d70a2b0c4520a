"""Offices in the bench on buildings: rows and targets of made-up outcomes, and a morning for real."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace

import pytest

from benchmarks.closed_loop import offices
from benchmarks.closed_loop.offices import OfficeCase, OfficeOutcome, office_targets, run_office, run_offices
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.plants.rooms import HouseOfRooms


def kpis(cost: float, discomfort: float) -> dict[str, float]:
    return {"cost_tot": cost, "tdis_tot": discomfort}


def outcome(ours=(0.9, 0.5), setback=(0.8, 10.0), earlier=(1.0, 2.0), earliest=(1.2, 0.3), **changes) -> OfficeOutcome:
    values = {
        "case": OfficeCase("office:3rooms:1", "cold_week"),
        "words": "an office",
        "ours": kpis(*ours),
        "native": kpis(1.1, 0.0),
        "thermostats": {0: kpis(*setback), 2: kpis(*earlier), 4: kpis(*earliest), 6: kpis(1.3, 0.3)},
        "statuses": {"solved": 670, "guard": 2, "gate": 0},
    }
    return OfficeOutcome(**(values | changes))


def by_name(outcomes: list[OfficeOutcome]) -> list[tuple[float, bool]]:
    return [(target.value, target.holds) for target in office_targets(outcomes)]


FAILED = outcome(ours=(math.nan, math.nan), thermostats={}, failed="RuntimeError: broken")


def test_the_cheapest_thermostat_that_is_as_comfortable_is_the_yardstick():
    assert outcome().as_comfortable == 4
    assert outcome().saving == pytest.approx(1.0 - 0.9 / 1.2)
    assert outcome(ours=(0.9, 1.9)).as_comfortable == 2, "0.1 K·h more count as equal"
    none = outcome(ours=(0.9, 0.1))
    assert none.as_comfortable is None
    assert math.isnan(none.saving)
    assert math.isnan(FAILED.saving)


def test_targets_that_hold():
    assert by_name([outcome()] * 3) == [(0.0, True), (0.0, True), (pytest.approx(0.9), True), (0.25, True)]


def test_a_band_that_is_missed_in_the_morning_is_counted():
    late = outcome(ours=(0.9, 1.2))
    assert by_name([outcome(), late])[1] == (1.0, False)


def test_costs_are_judged_by_their_median_beside_a_setback_until_4():
    dear = outcome(ours=(1.3, 0.5))
    _, _, cost, saving = by_name([outcome(), dear, dear])
    assert cost == (pytest.approx(1.3), False)
    assert saving == (pytest.approx(1.0 - 1.3 / 1.2), False)


def test_a_failed_office_misses_its_target_and_counts_in_no_other():
    assert by_name([outcome(), FAILED]) == [(1.0, False), *by_name([outcome()])[1:]]
    assert [value for value, _ in by_name([FAILED])[2:]] == [pytest.approx(math.nan, nan_ok=True)] * 2
    assert not any(holds for _, holds in by_name([FAILED])[2:])


def test_rows_say_what_was_compared():
    row = outcome().row()
    assert row["thermoforce_mpc"] == "0.900 / 0.50"
    assert row["thermostat from 6:00"] == "0.800 / 10.00"
    assert row["as comfortable"] == "1.200 / 0.30 from 2:00"
    assert (row["saving"], row["plans"]) == ("25.0%", "solved 670, guard 2")
    assert outcome(ours=(0.9, 0.1)).row()["as comfortable"] == "–"
    assert FAILED.row()["thermoforce_mpc"] == "RuntimeError: broken"


def test_offices_are_those_of_the_seed_on_both_weeks(monkeypatch):
    told: list[str] = []

    def here(function, cases, engine, on_done, keep) -> list[dict]:
        found = [json.loads(json.dumps(asdict(outcome(case=case)))) for case in cases]
        for number, one in enumerate(found, start=1):
            on_done(number, one)
        return found

    monkeypatch.setattr(offices, "run_all", here)
    runs = [run_offices(n, 5, LocalEngine(1), told.append) for n in (3, 2)]
    names = [found.case.name for found in runs[0]]
    assert [found.case.week for found in runs[0]] == ["cold_week", "sunny_week"] * 3
    assert names[::2] == names[1::2]
    assert [name.rpartition(":")[2] for name in names[::2]] == ["500", "501", "502"]
    assert names[:4] == [found.case.name for found in runs[1]]
    assert told[0] == f"[1/6] {names[0]}, cold_week, 0 s: 0.900 / 0.50, saving 25.0%"
    assert run_offices(0, 5, LocalEngine(1), told.append) == []


def test_a_failure_is_named_and_the_others_go_on(monkeypatch):
    def fail(*args):
        raise RuntimeError("the solver is broken")

    monkeypatch.setattr(offices, "run_identification", fail)
    found = run_office(OfficeCase("office:1rooms:3", "cold_week"))
    assert found.failed == "RuntimeError: the solver is broken"
    assert "1 rooms on 1 storey" in found.words


@pytest.mark.slow
def test_a_morning_for_real(monkeypatch):
    """From midnight until noon: thermostats that start earlier are warmer at 6:00 and pay for it."""
    week = HouseOfRooms.period
    monkeypatch.setattr(HouseOfRooms, "period", lambda plant, name: replace(week(plant, name), scored_s=12 * HOUR_S))
    found = run_office(OfficeCase("office:1rooms:3", "cold_week"))
    assert found.failed == ""
    assert sum(found.statuses.values()) == 48
    early = [found.thermostats[lead] for lead in (0, 2, 3, 4, 5, 6)]
    discomfort = [kpis["tdis_tot"] for kpis in early]
    assert discomfort == sorted(discomfort, reverse=True)
    assert discomfort[0] > discomfort[-1] + 0.1
    assert early[0]["cost_tot"] < early[-1]["cost_tot"]
    assert found.ours["tdis_tot"] < discomfort[0]
