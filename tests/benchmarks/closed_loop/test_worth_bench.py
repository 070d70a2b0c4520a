"""The bench of worth: what is compared with what, which cases there are, and what each runs."""

from __future__ import annotations

import pytest
from buildings.simple_house import simple_model

from benchmarks.closed_loop import worth
from benchmarks.closed_loop.worth import Case, controller_with, run_case, run_worth_bench, targets, with_shares
from benchmarks.free_response.oracle import Oracle
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_testcase


def row(name, cost, discomfort_Kh, history="1 d", window="44"):
    about = {"building": "a", "window": window, "price": "constant", "people": True, "history": history}
    both = cost + 0.026 * discomfort_Kh
    scores = {"cost": cost, "discomfort_Kh": discomfort_Kh, "both": both, "not_solved": 0, "step_ms": 1.0}
    return about | {"free response": name, "refused": ""} | scores


def test_shares_are_of_the_gain_in_what_the_controller_minimises_over_all_cases():
    runs = [row("linear_weather", 1.0, 2.0), row("default", 0.9, 2.0), row("oracle", 0.8, 2.0)]
    runs += [row("linear_weather", 1.0, 3.0, "3 d"), row("default", 1.01, 3.2, "3 d"), row("oracle", 1.0, 0.0, "3 d")]
    rows = with_shares(runs)
    assert [one["gain"] for one in rows[:3]] == pytest.approx([0.0, 0.1, 0.2])
    assert rows[4]["dearer"] == pytest.approx(0.01)
    assert rows[4]["more_Kh"] == pytest.approx(0.2)
    shares = {(one["history"], one["free response"]): one["share"] for one in worth.summary(rows)}
    assert shares["1 d", "default"] == pytest.approx(0.5)
    assert shares["3 d", "default"] == pytest.approx(-(0.01 + 0.026 * 0.2) / (0.026 * 3.0))
    assert {one["share"] for one in worth.summary(rows) if one["free response"] == "oracle"} == {1.0}
    assert [one["default"] for one in worth.table(rows)] == ["0.9000 / 2.00", "1.0100 / 3.20"]
    assert worth.table(rows)[0]["default, share"] == pytest.approx(0.5)
    share, dearer, less_comfort = targets(rows)
    assert share.value == pytest.approx((0.1 - 0.01 - 0.026 * 0.2) / (0.2 + 0.026 * 3.0))
    assert (dearer.value, less_comfort.value) == pytest.approx((0.01, 0.2))
    assert [target.holds for target in (share, dearer, less_comfort)] == [False, False, False]


def test_there_is_no_share_where_the_truth_gains_nothing():
    runs = [row("linear_weather", 1.0, 0.0), row("default", 0.9, 0.0), row("oracle", 1.1, 0.0)]
    rows = with_shares(runs)
    assert worth.table(rows)[0]["default, share"] is None
    assert not targets(rows)[0].holds


def test_free_responses_are_named_as_a_user_names_them_and_nothing_stands_in_for_the_truth():
    testcase, model, plant = load_testcase(worth.HEAT_PUMP), simple_model(), EmbeddedPlant(synthetic_weather())
    weather, known = (controller_with(name, testcase, model, plant) for name in ("chronos:shipped_weather", "oracle"))
    assert weather.config.free_response.name == "chronos"
    assert weather.config.free_response.options == {"backbone": "shipped_weather"}
    assert not known.config.free_response.substitutes
    assert isinstance(known.predictor.free_responses[0].method, Oracle)


def test_no_watch_takes_control_from_the_plans_that_are_compared():
    testcase, model, plant = load_testcase(worth.HEAT_PUMP), simple_model(), EmbeddedPlant(synthetic_weather())
    names = ("linear_weather", "default", "oracle")
    assert not any(controller_with(name, testcase, model, plant).config.watch.enabled for name in names)


@pytest.mark.slow
def test_a_case_runs_each_free_response_on_the_same_days_and_says_where_there_is_no_model(monkeypatch):
    case = Case(worth.HEAT_PUMP, "108", "constant", 7, "none", 0.25, (1,), ("linear_weather", "oracle"))
    monkeypatch.setattr(worth, "model_for", lambda task, plant: simple_model())
    first, known = run_case(case)
    assert (first["free response"], known["free response"]) == ("linear_weather", "oracle")
    assert first["cost"] != known["cost"]
    assert first["people"] is True

    def refuse(task, plant):
        raise DataError("too little")

    monkeypatch.setattr(worth, "model_for", refuse)
    assert [one["refused"] for one in run_case(case)] == ["too little"]


def test_cases_are_the_heat_pump_with_people_the_sharp_tariff_with_and_without_and_houses(monkeypatch):
    def here(function, cases, engine, on_done, keep):
        return [[row(name, 1.0, 0.0, window=one.window) for name in one.free_responses] for one in cases]

    asked = []
    monkeypatch.setattr(worth, "run_all", lambda function, cases, *rest: asked.extend(cases) or here(0, cases, *rest))
    result = run_worth_bench(windows=["44"], houses=1, methods=["chronos"], engine=LocalEngine(1))
    assert [(one.testcase, one.window, one.price, one.people) for one in asked] == [
        (worth.HEAT_PUMP, "44", "constant", 7),
        (worth.HEAT_PUMP, "108", "highly_dynamic", 7),
        (worth.HEAT_PUMP, "108", "highly_dynamic", None),
        ("generated:2044:0", "cold_week", "constant", 7),
        ("generated:2044:0", "sunny_week", "constant", 7),
    ]
    assert {one.free_responses for one in asked} == {("linear_weather", "default", "chronos", "oracle")}
    assert [target["holds"] for target in result["targets"]][1:] == [True, True]
