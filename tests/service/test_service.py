"""The embedded plant behind BOPTEST's protocol: our client and plain requests must find what the real service gives."""

from __future__ import annotations

import logging
import re
import threading
import time

import numpy as np
import pytest
import requests
from emulator_service import running_emulator_service
from waiting import LONG_S

from boptest_client import (
    BoptestClient,
    RequestRejected,
    ServiceError,
    ServiceScenario,
    TransportConfig,
    UnknownTest,
)
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import CONDITIONS, DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.plants.boptest.plant import BoptestPlant
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.service.server import build_server

NAME = "bestest_hydronic_heat_pump"
JSON = {"Content-Type": "application/json"}
QUICK = TransportConfig(connect_timeout_s=2.0, read_timeout_s=LONG_S, patience_s=0.0)


@pytest.fixture(scope="module")
def url():
    with running_emulator_service(most_tests=3) as address:
        yield address


@pytest.fixture
def client(url):
    with BoptestClient(url, NAME, config=QUICK) as test:
        yield test


@pytest.fixture(scope="module")
def house():
    return EmbeddedPlant(synthetic_weather())


@pytest.mark.slow
def test_the_plant_on_the_service_is_the_embedded_plant(url, house):
    with BoptestPlant(url, load_testcase(NAME), config=QUICK) as served:
        for plant in (served, house):
            plant.reset(20 * DAY_S, 2 * DAY_S, "dynamic")
        for u, duration in ((0.6, 900.0), (1.0, 3600.0), (0.0, 300.0), (None, 1800.0)):
            a, b = served.advance(u, duration), house.advance(u, duration)
            assert (a.time_s, a.T_zone_C) == (b.time_s, b.T_zone_C)
            assert a.u == pytest.approx(b.u, abs=1e-12)
            assert a.power_W == pytest.approx(b.power_W)
            assert a.heat_W == pytest.approx(b.heat_W)
        a, b = served.past(HOUR_S), house.past(HOUR_S)
        for name in ("time_s", "T_zone_C", "T_out_C", "solar_W_m2", "u", "power_W", "heat_W", "T_return_C"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-9, atol=1e-6, err_msg=name)
        a, b = served.forecast(DAY_S, HOUR_S), house.forecast(DAY_S, HOUR_S)
        for name in CONDITIONS:
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-9, err_msg=name)
        kpis = served.kpis()
        for name, value in house.kpis().items():
            assert kpis[name] == pytest.approx(value)


def test_every_point_of_the_test_case_is_there(client):
    assert {f"{p}_{e}" for p in ("oveHeaPumY", "oveTSet", "ovePum", "oveFan") for e in ("u", "activate")} == set(
        client.inputs()
    )
    assert client.inputs()["oveTSet_u"].minimum == 278.15
    switch = client.inputs()["oveFan_activate"]
    assert (switch.unit, switch.minimum, switch.maximum) == (None, None, None)
    assert switch.description == f"Activation for {client.inputs()['oveFan_u'].description}"
    measured, forecast = client.measurements(), client.forecast_points()
    assert len(measured) == 13 + 23
    assert len(forecast) == 3 + 8 + 23
    assert measured["weaSta_reaWeaTDryBul_y"].unit == forecast["TDryBul"].unit == "K"
    state = client.initialize(100.5 * DAY_S, 3600)
    assert set(state) == set(measured) | set(client.inputs()) | {"time"}
    assert all(np.isfinite(value) for value in state.values())
    series = client.forecast(list(forecast), 3600, 3600)
    for name in forecast:
        station = f"weaSta_reaWea{name[0].upper()}{name[1:]}_y"
        if station in state:
            assert series[name][0] == pytest.approx(state[station]), name
    assert state["weaSta_reaWeaTDewPoi_y"] <= state["weaSta_reaWeaTWetBul_y"] <= state["weaSta_reaWeaTDryBul_y"]
    assert 0 < state["weaSta_reaWeaSolAlt_y"] < np.pi / 2, "the sun is up at noon"
    record = client.results([*measured, *client.inputs()], 0, 1e9)
    assert record["time"][0] == 100.5 * DAY_S - 3600
    assert record["time"][-1] == 100.5 * DAY_S
    assert {name: values[-1] for name, values in record.items()} == state


def test_heat_out_of_the_air_and_power_make_the_heat_into_the_water(client):
    client.initialize(20 * DAY_S, 3600)
    state = client.advance({"oveHeaPumY_u": 1.0, "oveHeaPumY_activate": 1})
    assert state["reaQHeaPumEva_y"] < 0
    assert state["reaQHeaPumCon_y"] < -state["reaQHeaPumEva_y"] + state["reaPHeaPum_y"] + 1.0
    assert state["reaQHeaPumCon_y"] > -state["reaQHeaPumEva_y"]


def test_all_four_inputs_act_and_stay_until_changed(client):
    client.initialize(20 * DAY_S, DAY_S)
    client.set_step(600)
    on = client.advance({"oveHeaPumY_u": 0.7, "oveHeaPumY_activate": 1})
    assert on["oveHeaPumY_u"] == 0.7
    assert client.advance({})["oveHeaPumY_u"] == 0.7
    client.advance({"oveHeaPumY_activate": 0})
    off = client.advance({"oveTSet_u": 278.15, "oveTSet_activate": 1})
    assert off["oveTSet_u"] == 278.15
    fan = client.advance({"oveFan_u": 1, "oveFan_activate": True, "ovePum_u": "1", "ovePum_activate": "1"})
    assert fan["reaPFan_y"] > 0
    assert fan["reaPPumEmi_y"] > 0
    assert client.initialize(20 * DAY_S, 0)["time"] == 20 * DAY_S
    assert client.advance({})["oveTSet_u"] > 278.15, "initialising forgets what was overwritten"


def test_an_input_that_was_never_given_a_value_is_zero(client):
    """As RWTH's DDMPC begins: it activates what it will write, and advances once. A zero set-point heats nothing."""
    client.initialize(20 * DAY_S, DAY_S)
    client.set_step(900)
    state = client.advance({"oveHeaPumY_activate": 1})
    assert (state["oveHeaPumY_activate"], state["oveHeaPumY_u"], state["reaPHeaPum_y"]) == (1, 0, 0)
    assert client.advance({"oveHeaPumY_u": 0.5})["oveHeaPumY_u"] == 0.5
    client.initialize(20 * DAY_S, DAY_S)
    state = client.advance({"oveTSet_activate": 1})
    assert (state["oveTSet_u"], state["reaPHeaPum_y"]) == (0, 0)
    client.initialize(20 * DAY_S, DAY_S)
    assert client.advance({"ovePum_activate": 1, "oveFan_activate": 1})["reaPFan_y"] == 0


def test_the_measured_set_points_are_the_schedule_whatever_acts(client):
    client.initialize(21 * DAY_S + 6 * 3600, 0)
    client.set_step(900)
    for overwrites in ({}, {"oveTSet_u": 300.0, "oveTSet_activate": 1}):
        for _ in range(32):
            client.advance(overwrites)
    record = client.results(["reaTSetHea_y", "reaTSetCoo_y"], 0, 1e9)
    hour = np.array(record["time"]) % DAY_S / 3600
    # By the clock, as the real plant's own records have it: 07:00 is empty, 20:00 is not.
    at_home = (hour < 7) | (hour >= 20)
    np.testing.assert_array_equal(record["reaTSetHea_y"], np.where(at_home, 294.15, 288.15))
    np.testing.assert_array_equal(record["reaTSetCoo_y"], np.where(at_home, 297.15, 303.15))


def test_the_record_tells_when_an_input_was_overwritten(client):
    client.initialize(20 * DAY_S, 3600)
    client.set_step(600)
    for on in (1, 0, 1):
        assert client.advance({"oveHeaPumY_u": 0.4, "oveHeaPumY_activate": on})["oveHeaPumY_activate"] == on
    record = client.results(["oveHeaPumY_activate", "oveFan_activate"], 20 * DAY_S - 600, 1e9)
    assert np.diff(np.flatnonzero(record["oveHeaPumY_activate"])).max() == 21, "20 samples off between two steps on"
    assert sum(record["oveHeaPumY_activate"]) == 40
    assert not any(record["oveFan_activate"])
    assert record["time"][21] == 20 * DAY_S + 30
    assert record["oveHeaPumY_activate"][20:22] == [0.0, 1.0]


def test_a_learning_environment_finds_what_it_asks_for(url):
    """The calls of Gymnasium environments written for BOPTEST: bare requests, integers, regressive observations."""
    testid = requests.post(f"{url}/testcases/{NAME}/select", timeout=LONG_S).json()["testid"]

    def ask(method, verb, **body):
        answer = requests.request(method, f"{url}/{verb}/{testid}", json=body or None, timeout=LONG_S)
        assert answer.ok, answer.text
        return answer.json()["payload"]

    try:
        assert ask("get", "name") == {"name": NAME}
        assert ask("get", "step") == 3600
        assert ask("get", "scenario")["electricity_price"] == "constant"
        limits = ask("get", "inputs")["oveHeaPumY_u"]
        assert (limits["Minimum"], limits["Maximum"]) == (0, 1)
        start = ask("put", "initialize", start_time=1234567, warmup_period=86400)
        assert start["time"] == 1234567
        ask("put", "step", step=900)
        ask("put", "scenario", electricity_price="dynamic")
        spent = 0.0
        for _ in range(3):
            state = ask("post", "advance", oveHeaPumY_u=0.8, oveHeaPumY_activate=1.0)
            cost = ask("get", "kpi")["cost_tot"]
            assert cost > spent
            spent = cost
        past = ask("put", "results", point_names=["reaTZon_y"], start_time=int(state["time"] - 3600), final_time=1e9)
        assert past["time"][-1] - past["time"][0] == 3600
        names = ["TDryBul", "PriceElectricPowerDynamic"]
        future = ask("put", "forecast", point_names=names, horizon=3600, interval=900)
        assert [len(future[name]) for name in names] == [5, 5]
        forever = requests.put(
            f"{url}/results/{testid}",
            data={"point_names": "reaTZon_y", "start_time": "0", "final_time": "inf"},
            timeout=10,
        )
        assert forever.json()["payload"]["time"][-1] == state["time"]
    finally:
        assert requests.put(f"{url}/stop/{testid}", timeout=LONG_S).text == "OK"


def test_steps_of_any_length_last_as_long_as_they_say(client):
    client.initialize(20 * DAY_S, 3600)
    for step_s in (5, 1, 7.5, 45, 100, 3601):
        before_s = client.advance({})["time"]
        client.set_step(step_s)
        assert client.step() == step_s
        state = client.advance({"oveHeaPumY_u": 0.6, "oveHeaPumY_activate": 1})
        assert state["time"] == before_s + step_s
        record = client.results(["reaTZon_y", "oveHeaPumY_activate"], before_s, state["time"])
        assert (record["time"][0], record["time"][-1]) == (before_s, state["time"])
        assert record["reaTZon_y"][-1] == state["reaTZon_y"]
        assert all(record["oveHeaPumY_activate"][1:])


@pytest.mark.slow
def test_a_scenario_ends_on_time_whatever_the_step(client):
    start = client.set_scenario(ServiceScenario(time_period="typical_heat_day"))
    client.set_step(13 * DAY_S + 0.1)
    client.advance()
    client.set_step(86399.5)
    client.advance()
    assert client.advance()["time"] == start["time"] + 14 * DAY_S
    assert client.advance() == {}


def test_what_follows_the_clock_is_held_for_a_quarter_of_an_hour(client):
    """The real data lie every 15 min, with people still there at 07:00, and are held; day 21 is a Tuesday."""
    names = ["Occupancy[1]", "LowerSetp[1]", "UpperSetp[1]", "InternalGainsRad[1]", "PriceElectricPowerDynamic"]
    client.initialize(21 * DAY_S, 0)
    ahead = client.forecast(names, DAY_S, 300)
    at = {second: i for i, second in enumerate(np.array(ahead["time"]) - 21 * DAY_S)}

    def seen(hour, minute):
        return tuple(ahead[name][at[hour * 3600 + minute * 60]] for name in names)

    home, away = (5.0, 294.15, 297.15, 219.0), (0.0, 288.15, 303.15, 0.0)
    for hour, minute, people, price in (
        (6, 55, home, 0.2383), (7, 0, home, 0.2666), (7, 5, home, 0.2666), (7, 10, home, 0.2666),
        (7, 15, away, 0.2666), (19, 55, away, 0.2666), (20, 0, home, 0.2666), (22, 10, home, 0.2666),
        (22, 15, home, 0.2383),
    ):  # fmt: skip
        assert seen(hour, minute) == pytest.approx((*people, price)), (hour, minute)


def test_values_out_of_their_limits_are_clipped_with_a_warning(client, caplog):
    with caplog.at_level(logging.WARNING):
        state = client.advance({"oveHeaPumY_u": 1.7, "oveHeaPumY_activate": 1})
    assert state["oveHeaPumY_u"] == 1.0
    assert "WARNING: value of 1.7 for oveHeaPumY_u is above maximum of 1.0.  Using 1.0. ;" in caplog.text
    with caplog.at_level(logging.WARNING):
        client.advance({"oveTSet_u": 20, "oveTSet_activate": 1, "ovePum_u": -1})
    assert "WARNING: value of 20.0 for oveTSet_u is below minimum of 278.15.  Using 278.15. ;" in caplog.text
    assert "WARNING: value of -1.0 for ovePum_u is below minimum of 0.0.  Using 0.0. ;" in caplog.text


def test_whole_numbers_have_no_decimal_point_as_javascript_writes_them(client):
    """Everywhere: typed clients decode seconds into integers, and refuse 3600.0."""

    def ask(method, verb, **body):
        answer = requests.request(method, f"{client.url}/{verb}/{client.testid}", json=body or None, timeout=LONG_S)
        assert answer.ok, answer.text
        assert not re.search(r"\d\.0+[],} ]", answer.text), answer.text[:500]
        return answer.json()["payload"]

    assert isinstance(ask("put", "initialize", start_time=86400.0, warmup_period=0.0)["time"], int)
    assert isinstance(ask("put", "step", step=900.0)["step"], int)
    assert isinstance(ask("get", "step"), int)
    state = ask("post", "advance", oveHeaPumY_u=1.0, oveHeaPumY_activate=1.0)
    assert (state["time"], state["oveHeaPumY_activate"]) == (87300, 1)
    assert isinstance(state["oveHeaPumY_activate"], int)
    assert isinstance(state["reaTZon_y"], float)
    ahead = ask("put", "forecast", point_names=["Occupancy[1]", "TDryBul"], horizon=3600, interval=900)
    assert all(isinstance(second, int) for second in ahead["time"])
    assert isinstance(ahead["TDryBul"][1], float)
    ask("put", "results", point_names=["reaTZon_y", "oveHeaPumY_u", "reaPHeaPum_y"], start_time=0, final_time=1e9)
    for verb in ("kpi", "inputs", "measurements", "scenario"):
        ask("get", verb)
    ask("put", "step", step=7.5)
    assert ask("get", "step") == 7.5


def test_a_scenario_runs_two_weeks_and_ends(client):
    start = client.set_scenario(ServiceScenario("highly_dynamic", "typical_heat_day"))
    assert client.scenario().time_period == "typical_heat_day"
    record = client.results(["reaTZon_y"], 0, 1e9)
    assert start["time"] - record["time"][0] == 7 * DAY_S
    client.set_step(13.5 * DAY_S)
    client.advance()
    assert client.advance()["time"] == start["time"] + 14 * DAY_S, "the last step is cut"
    assert client.advance() == {}
    kpis = client.kpi()
    assert kpis["ener_tot"] > 0
    assert kpis["pgas_tot"] is None


def test_an_initialisation_may_name_its_end(client):
    def ask(method, verb, **body):
        answer = requests.request(method, f"{client.url}/{verb}/{client.testid}", json=body, timeout=LONG_S).json()
        return answer["message"], answer["payload"]

    start_s = 20 * DAY_S
    ask("put", "initialize", start_time=start_s, warmup_period=0, final_time=start_s + 5000)
    assert ask("post", "advance")[1]["time"] == start_s + 3600
    assert ask("post", "advance")[1]["time"] == start_s + 5000, "the last step is cut"
    assert ask("post", "advance") == ("End of test case scenario time period reached.", {})
    ask("put", "initialize", start_time=start_s, warmup_period=0, final_time=None)
    for hours in (1, 2):
        said, state = ask("post", "advance")
        assert state["time"] == start_s + hours * 3600
    assert said == f"Advanced simulation successfully from {start_s + 3600:.1f}s to {start_s + 7200:.1f}s."


def test_scenario_keys_that_mean_nothing_are_passed_over_and_a_seed_of_zero_is_none(client):
    def put(**body):
        answer = requests.put(f"{client.url}/scenario/{client.testid}", json=body, timeout=LONG_S)
        assert answer.ok, answer.text
        return answer.json()["payload"]

    keys = {"electricity_price", "time_period", "temperature_uncertainty", "solar_uncertainty", "seed"}
    said = put(electricity_price="dynamic", weather="sunny", seed=0)
    assert set(said) == keys
    assert (said["electricity_price"], said["seed"]) == ("dynamic", None)
    now = requests.get(f"{client.url}/scenario/{client.testid}", timeout=LONG_S).json()["payload"]
    assert set(now) == keys
    assert put(seed=5.0)["seed"] == 5


def test_results_and_forecasts_of_nothing_are_empty(client):
    def put(verb, **body):
        answer = requests.put(f"{client.url}/{verb}/{client.testid}", json=body, timeout=LONG_S)
        assert answer.ok, answer.text
        return answer.json()["payload"]

    client.initialize(20 * DAY_S, 7200)
    end_s, names = 20 * DAY_S, ["reaTZon_y", "oveFan_activate"]
    empty = {"time": [], "reaTZon_y": [], "oveFan_activate": []}
    assert put("results", point_names=names, start_time=end_s - 900, final_time=end_s - 1800) == empty
    assert put("results", point_names=names, start_time=end_s - 20, final_time=end_s - 10) == empty
    assert put("results", point_names=[], start_time=0, final_time=end_s) == {}
    assert put("forecast", point_names=[], horizon=3600, interval=1800) == {"time": [end_s, end_s + 1800, end_s + 3600]}


def test_the_version_begins_with_digits_and_says_whose_it_is(url):
    version = requests.get(f"{url}/version", timeout=LONG_S).json()["payload"]["version"]
    assert re.match(r"\d.\d.\d", version), "as BOPTEST's own test of it"
    assert "thermoforce-mpc" in version


def test_test_cases_have_their_namespace(url):
    offered = requests.get(f"{url}/testcases/ibpsa", timeout=LONG_S).json()
    assert offered == requests.get(f"{url}/testcases", timeout=LONG_S).json() == [{"testcaseid": NAME}]
    testid = requests.post(f"{url}/testcases/ibpsa/{NAME}/select", timeout=LONG_S).json()["testid"]
    assert requests.get(f"{url}/name/{testid}", timeout=LONG_S).json()["payload"] == {"name": NAME}
    assert requests.put(f"{url}/stop/{testid}", timeout=LONG_S).ok
    for method, path in (
        ("get", "testcases/resstock"), ("post", f"testcases/resstock/{NAME}/select"),
        ("post", "testcases/ibpsa/bestest_air/select"),
    ):  # fmt: skip
        assert requests.request(method, f"{url}/{path}", timeout=LONG_S).status_code == 404


def test_kpis_right_after_the_start_are_zero(client):
    client.initialize(20 * DAY_S, 3600)
    assert client.kpi()["ener_tot"] == 0.0


def test_the_time_ratio_is_of_each_wait_to_the_step_before_it(client):
    client.initialize(20 * DAY_S, 0)
    assert client.kpi()["time_rat"] is None, "nobody has been waited for yet"
    client.set_step(1)
    client.advance()
    threading.Event().wait(0.2)
    client.advance()
    assert client.kpi()["time_rat"] >= 0.2
    client.set_step(3600)
    assert client.kpi()["time_rat"] >= 0.2


def test_forecast_errors_repeat_with_the_seed_and_touch_only_what_they_should(client):
    def seen(scenario):
        client.set_scenario(scenario)
        client.initialize(100 * DAY_S, 0)
        return client.forecast(["TDryBul", "HGloHor", "HDirNor"], 24 * HOUR_S, HOUR_S)

    truth = seen(ServiceScenario())
    warm = seen(ServiceScenario(temperature_uncertainty="high", seed=3))
    assert warm["TDryBul"] != truth["TDryBul"]
    assert warm["HGloHor"] == truth["HGloHor"]
    assert warm == seen(ServiceScenario(temperature_uncertainty="high", seed=3))
    assert warm["TDryBul"] != seen(ServiceScenario(temperature_uncertainty="high", seed=4))["TDryBul"]
    sunny = seen(ServiceScenario(solar_uncertainty="medium", seed=3))
    assert sunny["TDryBul"] == truth["TDryBul"]
    assert sunny["HGloHor"] != truth["HGloHor"]
    with pytest.raises(RequestRejected, match="at most 48 hours in a solar_uncertainty scenario"):
        client.forecast(["HGloHor"], 49 * HOUR_S, HOUR_S)
    for name in ("LowerSetp[1]", "TDryBul"):  # points without errors
        assert len(client.forecast([name], 72 * HOUR_S, HOUR_S)["time"]) == 73
    hot = seen(ServiceScenario(temperature_uncertainty="high", solar_uncertainty="high", seed=3))
    for horizon_s in (0.0, 1800.0):  # the present alone
        now = client.forecast(["TDryBul", "HGloHor"], horizon_s, HOUR_S)
        assert now == {name: hot[name][:1] for name in now}
    assert seen(ServiceScenario()) == truth, "uncertainties that are not named again are gone"


def test_the_price_of_a_running_test_can_be_changed_without_disturbing_it(client):
    client.initialize(20 * DAY_S, 0)
    before = client.advance()
    client.set_scenario(ServiceScenario("dynamic"))
    assert client.advance()["time"] == before["time"] + 3600


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "path", "body", "status", "message"),
    [
        ("put", "step", {"step": "an hour"}, 400, "'an hour' of step"),
        ("put", "step", {"step": -900}, 400, "-900 of step"),
        ("put", "step", {"step": 0}, 400, "at least 0.001"),
        ("put", "step", {"step": 365 * DAY_S}, 400, "at most"),
        ("put", "step", {"step": [900]}, 400, "expected a number"),
        ("put", "step", {"step": True}, 400, "True of step: expected a number"),
        ("put", "step", {"step": "9_00"}, 400, "'9_00' of step: expected a number"),
        ("put", "step", {"step": "٩٠٠"}, 400, "expected a number"),
        ("put", "initialize", {"start_time": 0, "warmup_period": False}, 400, "False of warmup_period"),
        ("post", "advance", {"oveHeaPumY_u": True, "oveHeaPumY_activate": 1}, 400, "True of oveHeaPumY_u"),
        (
            "put",
            "results",
            {"point_names": ["reaTZon_y"], "start_time": 0, "final_time": "Infinity"},
            400,
            "final_time",
        ),
        ("put", "step", {}, 400, "Missing parameter step"),
        ("put", "initialize", {"start_time": -1, "warmup_period": 0}, 400, "start_time"),
        ("put", "initialize", {"start_time": 0, "warmup_period": None}, 400, "warmup_period"),
        ("put", "initialize", {"start_time": 365 * DAY_S, "warmup_period": 0}, 400, "beyond the year"),
        ("put", "initialize", {"start_time": "NaN", "warmup_period": 0}, 400, "expected a number"),
        ("put", "scenario", {"electricity_price": "cheap"}, 400, "constant, dynamic, highly_dynamic"),
        ("put", "scenario", {"time_period": "peak_day"}, 400, "peak_heat_day, typical_heat_day"),
        ("put", "scenario", {"temperature_uncertainty": "huge"}, 400, "none, low, medium, high"),
        ("put", "scenario", {"seed": -1}, 400, "seed"),
        ("put", "scenario", {"seed": "5"}, 400, "seed"),
        ("put", "scenario", {"seed": 5.5}, 400, "seed"),
        ("put", "initialize", {"start_time": 0, "warmup_period": 0, "final_time": "late"}, 400, "final_time"),
        ("post", "advance", {"oveHeaPumX_u": 1}, 400, "Unexpected input 'oveHeaPumX_u'"),
        ("post", "advance", {"oveHeaPumY_u": "full"}, 400, "'full' of oveHeaPumY_u"),
        ("post", "advance", {"oveHeaPumY_u": "nan", "oveHeaPumY_activate": 1}, 400, "expected a number"),
        ("post", "advance", {"oveHeaPumY_u": 1, "oveHeaPumY_activate": 2}, 400, "expected 0 or 1"),
        ("put", "forecast", {"point_names": ["TDryBull"], "horizon": 1, "interval": 1}, 400, "TDryBull"),
        ("put", "forecast", {"point_names": ["TDryBul"], "horizon": 3600, "interval": 0}, 400, "interval"),
        ("put", "forecast", {"point_names": ["TDryBul"], "horizon": 3e7, "interval": 1}, 400, "fewer points"),
        ("put", "forecast", {"horizon": 3600, "interval": 3600}, 400, "point_names"),
        ("put", "results", {"point_names": ["reaTZon_z"], "start_time": 0, "final_time": 1}, 400, "reaTZon_z"),
        ("put", "results", {"point_names": ["reaTZon_y"], "start_time": 9e6, "final_time": 9.1e6}, 400, "recorded"),
        ("put", "results", {"point_names": ["reaTZon_y"], "start_time": -9, "final_time": -1}, 400, "recorded"),
        ("put", "results", {"start_time": 0, "final_time": 1}, 400, "point_names"),
        ("post", "step", {}, 405, "use GET or PUT"),
        ("get", "reset", {}, 404, "no such endpoint"),
    ],
)
def test_bad_requests_get_the_services_status_and_a_reason(client, method, path, body, status, message):
    before = client.results(["reaTZon_y"], 0, 1e9)
    answer = getattr(requests, method)(f"{client.url}/{path}/{client.testid}", json=body, timeout=LONG_S)
    assert answer.status_code == status, answer.text
    said = answer.json()
    assert message in said["message"]
    assert (said["status"], said["payload"]) == (status, None)
    assert client.results(["reaTZon_y"], 0, 1e9) == before, "nothing half done"


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"{step", "not JSON"),
        (b"[1]", "a JSON list"),
        (b"[" * 5000, "JSON"),
        (b'{"step": Infinity}', "expected a finite number"),
        (b'{"step": NaN}', "expected a finite number"),
    ],
)
def test_bodies_that_are_no_object_of_finite_numbers_are_refused(client, body, message):
    answer = requests.put(f"{client.url}/step/{client.testid}", data=body, headers=JSON, timeout=LONG_S)
    assert answer.status_code == 400
    assert message in answer.json()["message"]


def test_forms_are_understood_as_older_clients_send_them(client):
    assert requests.put(f"{client.url}/step/{client.testid}", data={"step": "900"}, timeout=LONG_S).ok
    assert client.step() == 900
    form = {"point_names": ["TDryBul", "HGloHor"], "horizon": "3600", "interval": "900"}
    payload = requests.put(f"{client.url}/forecast/{client.testid}", data=form, timeout=LONG_S).json()["payload"]
    assert [len(payload[name]) for name in ("TDryBul", "HGloHor", "time")] == [5, 5, 5]
    advance = requests.post(
        f"{client.url}/advance/{client.testid}", data={"oveHeaPumY_u": "0.5", "oveHeaPumY_activate": "1"}, timeout=10
    )
    assert advance.json()["payload"]["oveHeaPumY_u"] == 0.5


def test_a_body_that_is_too_long_is_refused(client):
    # Refused by the announced length: the server need not read it, and may close before all is sent.
    try:
        answer = requests.put(f"{client.url}/step/{client.testid}", data=b"x" * 1_100_000, headers=JSON, timeout=LONG_S)
    except requests.ConnectionError:
        pass
    else:
        assert answer.status_code == 413
    assert client.step() == 3600


def test_a_test_that_does_not_exist_is_told_as_the_service_does(url):
    answer = requests.get(f"{url}/measurements/nonsense", timeout=LONG_S)
    assert answer.status_code == 400
    assert answer.json()["errors"][0]["msg"] == "Invalid testid: nonsense"
    with pytest.raises(UnknownTest, match="offers bestest_hydronic_heat_pump"):
        BoptestClient(url, "bestest_air", config=QUICK)


def test_tests_live_side_by_side_and_only_so_many(url):
    with BoptestClient(url, NAME, config=QUICK) as a, BoptestClient(url, NAME, config=QUICK) as b:
        outcomes = {}

        def run(test, level):
            test.initialize(20 * DAY_S, 3600)
            for _ in range(5):
                outcomes[level] = test.advance({"oveHeaPumY_u": level, "oveHeaPumY_activate": 1})

        threads = [threading.Thread(target=run, args=pair) for pair in ((a, 0.0), (b, 1.0))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(timeout=LONG_S)
        assert outcomes[1.0]["reaTZon_y"] > outcomes[0.0]["reaTZon_y"] + 0.1
        with (
            BoptestClient(url, NAME, config=QUICK),
            pytest.raises(ServiceError, match="All 3 tests of this service are in use"),
        ):
            BoptestClient(url, NAME, config=QUICK)


def test_idle_tests_are_dropped(monkeypatch):
    clock, later_s = time.monotonic, [0.0]
    with running_emulator_service(idle_s=900.0) as address, BoptestClient(address, NAME, config=QUICK) as test:
        monkeypatch.setattr(time, "monotonic", lambda: clock() + later_s[0])
        assert test.status() == "Running"
        later_s[0] = 901.0
        with pytest.raises(UnknownTest, match="Invalid testid"):
            test.step()


def test_an_address_in_use_and_senseless_numbers_are_told(url):
    weather = synthetic_weather()
    with pytest.raises(PlantError, match=r"cannot listen on 127\.0\.0\.1:\d+ \(Address already in use\); choose"):
        build_server(weather, port=int(url.rsplit(":", 1)[1]))
    with pytest.raises(PlantError, match=r"cannot listen on nowhere\.invalid:0"):
        build_server(weather, host="nowhere.invalid", port=0, token="0123456789abcdef")
    with pytest.raises(ConfigError, match="port 70000"):
        build_server(weather, port=70000)
