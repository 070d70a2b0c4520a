"""The plant on a service must tell the same story as the emulator inside that service."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from boptest_server import Fault, running_service

from boptest_client import TransportConfig
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import CONDITIONS, DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError, InputError, PlantError
from thermoforce_mpc.plants.boptest.plant import BoptestPlant
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant

# Patience is counted in the pauses that are asked for, none is slept.
QUICK = TransportConfig(
    connect_timeout_s=1.0, read_timeout_s=20.0, patience_s=2.0, backoff_s=0.01, sleep=lambda seconds: None
)
TESTCASE = load_testcase("bestest_hydronic_heat_pump")


@pytest.fixture(scope="module")
def service():
    with running_service() as running:
        yield running


@pytest.fixture
def plant(service):
    service.faults.clear()
    with BoptestPlant(service.url, TESTCASE, config=QUICK) as running:
        yield running


def test_it_measures_forecasts_and_scores_as_the_emulator_does(plant):
    inside = EmbeddedPlant(synthetic_weather())
    assert isinstance(plant, Plant)
    for p in (plant, inside):
        p.reset(20 * DAY_S, 2 * DAY_S, "dynamic")
    for u, duration in ((0.5, 900.0), (1.0, 3600.0), (0.0, 300.0), (None, 1800.0)):
        a, b = plant.advance(u, duration), inside.advance(u, duration)
        assert a.time_s == b.time_s
        for name in ("T_zone_C", "T_out_C", "solar_W_m2"):
            assert getattr(a, name) == pytest.approx(getattr(b, name), abs=1e-9)
        assert a.power_W == pytest.approx(b.power_W)
        assert a.heat_W == pytest.approx(b.heat_W)
        assert a.u == pytest.approx(b.u)
    for name, value in inside.kpis().items():
        assert plant.kpis()[name] == pytest.approx(value)
    a, b = plant.forecast(DAY_S, HOUR_S), inside.forecast(DAY_S, HOUR_S)
    for name in CONDITIONS:
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-9, err_msg=name)


def test_the_past_holds_the_warm_up(plant):
    plant.reset(20 * DAY_S, 2 * DAY_S)
    past = plant.past(HOUR_S)
    inside = EmbeddedPlant(synthetic_weather())
    inside.reset(20 * DAY_S, 2 * DAY_S)
    truth = inside.past(HOUR_S)
    assert past.n_steps == 48
    np.testing.assert_allclose(past.T_zone_C, truth.T_zone_C, atol=1e-6)
    for name in ("heat_W", "power_W", "u"):
        np.testing.assert_allclose(getattr(past, name), getattr(truth, name), rtol=1e-9, atol=1e-6, err_msg=name)
    assert past.u.max() > 0, "native control was at work"


@pytest.mark.slow
def test_named_periods_are_the_services_official_scenarios(plant, service):
    period = plant.period("peak_heat_day")
    before = service.count("scenario/")
    assert plant.reset(period.start_s, period.warmup_s).time_s == period.start_s
    assert service.count("scenario/") == before + 1
    plant.advance(None, 3600)
    with pytest.raises(PlantError, match="runs past it"):
        plant.advance(None, 14 * DAY_S)
    asked = service.count("results/")
    plant.advance(None, 14 * DAY_S - 3600)
    service.faults.append(Fault("kpi/", "500", times=99))
    assert plant.kpis()["ener_tot"] > 0, "read before anything else was asked at the end"
    kpi = max(i for i, path in enumerate(service.requests) if path.startswith("kpi/"))
    results = max(i for i, path in enumerate(service.requests) if path.startswith("results/"))
    assert service.count("results/") == asked + 1
    assert kpi < results
    with pytest.raises(PlantError, match="scenario ends"):
        plant.advance(None, 30)


def test_a_period_the_service_does_not_know_is_bad_input(plant):
    with pytest.raises(InputError, match=r"period 'peak_day'.*time_period is peak_day"):
        plant.period("peak_day")
    with pytest.raises(InputError, match="between 0 and 365"):
        plant.period("400")
    assert plant.period("44").start_s == 44 * DAY_S


def test_a_scenario_that_ends_early_is_told(plant, service):
    plant.reset(20 * DAY_S, 0)
    service.ends = dict.fromkeys(service.ends, 20 * DAY_S)
    with pytest.raises(PlantError, match="says that its scenario is over, at day 20"):
        plant.advance(None, 3600)


def test_forecast_errors_are_the_services(service):
    with BoptestPlant(service.url, TESTCASE, forecast_uncertainty="medium", seed=7, config=QUICK) as plant:
        plant.reset(20 * DAY_S, 0, "highly_dynamic")
        scenario = next(body for path, body in reversed(service.bodies) if path.startswith("scenario/"))
    assert scenario == {
        "electricity_price": "highly_dynamic",
        "time_period": None,
        "temperature_uncertainty": "medium",
        "solar_uncertainty": "medium",
        "seed": 7,
    }
    with pytest.raises(ConfigError, match="seed"):
        BoptestPlant(service.url, TESTCASE, forecast_uncertainty="low", seed=0, config=QUICK)


def test_a_test_dropped_while_idle_is_selected_again_at_reset(plant, service):
    service.tests.clear()
    assert plant.reset(20 * DAY_S, 0).time_s == 20 * DAY_S
    service.tests.clear()
    with pytest.raises(PlantError, match="Invalid testid"):
        plant.advance(None, 900)


def test_a_lost_answer_costs_no_run(plant, service):
    plant.reset(20 * DAY_S, 0)
    service.faults.append(Fault("advance/", "drop", after_work=True))
    assert plant.advance(1.0, 900).time_s == 20 * DAY_S + 900
    assert plant.advance(1.0, 900).time_s == 20 * DAY_S + 1800


def test_a_failing_stop_hides_nothing(service, caplog):
    plant = BoptestPlant(service.url, TESTCASE, config=QUICK)
    service.faults.append(Fault("stop/", "500", times=99))
    plant.close()
    plant.close()
    assert "not stopped" in caplog.text
    service.faults.clear()


def test_a_test_case_file_that_does_not_fit_is_refused_by_key(service):
    wrong = TESTCASE.model_copy(
        update={"measurements": TESTCASE.measurements.model_copy(update={"zone_temperature": "reaTZone_y"})}
    )
    stopped = len(service.stopped)
    with pytest.raises(ConfigError, match=r"measurements\.zone_temperature: .*did you mean 'reaTZon_y'"):
        BoptestPlant(service.url, wrong, config=QUICK)
    assert len(service.stopped) == stopped + 1, "the test it selected is stopped"


def test_a_test_case_the_service_does_not_offer_is_bad_input(service):
    with pytest.raises(ConfigError, match=r"not offered.*bestest_air"):
        BoptestPlant(service.url, TESTCASE.model_copy(update={"name": "nonsense"}), config=QUICK)


@pytest.mark.parametrize(
    ("update", "message"),
    [
        ({"point": "oveTSet", "minimum": 280.0, "maximum": 300.0}, r"actuator\.point: 'oveTSet_u' is in K.*expected 1"),
        ({"maximum": 2.0}, r"actuator\.maximum: 2 lies outside .*0 to 1"),
    ],
)
def test_an_actuator_in_another_unit_or_beyond_the_limits_is_refused(service, update, message):
    wrong = TESTCASE.model_copy(update={"actuator": TESTCASE.actuator.model_copy(update=update)})
    with pytest.raises(ConfigError, match=message):
        BoptestPlant(service.url, wrong, config=QUICK)


def test_an_address_that_is_none_is_bad_input():
    with pytest.raises(ConfigError, match=r"plant\.url"):
        BoptestPlant("localhost", TESTCASE)


@pytest.mark.parametrize("kind", ["500", "garbage", "gone"])
def test_a_service_that_fails_is_a_plant_error(plant, service, kind):
    plant.reset(20 * DAY_S, 0)
    service.faults.append(Fault("advance/", kind, times=9))
    with pytest.raises(PlantError, match="BOPTEST service"):
        plant.advance(0.5, 900)


def _cut(payload: dict, n: int) -> dict:
    return {name: values[:n] for name, values in payload.items()}


@pytest.mark.slow
@pytest.mark.parametrize(
    "edit",
    [
        lambda payload: _cut(payload, 0),
        lambda payload: _cut(payload, 1),
        lambda payload: _cut(payload, 5),
        lambda payload: payload | {"time": [payload["time"][0]] * len(payload["time"])},
        lambda payload: payload | {"time": [t + 3600.0 for t in payload["time"]]},
        lambda payload: payload | {"time": [2.0 * t for t in payload["time"]]},
        lambda payload: {},
        lambda payload: None,
    ],
)
def test_a_forecast_of_another_shape_or_clock_is_a_plant_error_with_its_endpoint(plant, service, edit):
    plant.reset(20 * DAY_S, 0)
    service.faults.append(Fault("forecast/", "edited", times=99, edit=edit))
    with pytest.raises(PlantError, match=r"http://.*/forecast/"):
        plant.forecast(DAY_S, HOUR_S)
    service.faults.clear()
    assert plant.forecast(DAY_S, HOUR_S).n_steps == 24


@pytest.mark.slow
@pytest.mark.parametrize("path", ["results/", "advance/", "initialize/", "kpi/"])
@pytest.mark.parametrize(
    "edit",
    [
        lambda payload: None,
        lambda payload: [],
        lambda payload: {name: [] for name in payload},
        lambda payload: payload | {"time": None},
        lambda payload: payload | {"time": [payload.get("time", 0.0)] * 31},
        lambda payload: payload | {"time": [None]},
    ],
)
def test_an_answer_that_makes_no_sense_is_a_plant_error(plant, service, path, edit):
    plant.reset(20 * DAY_S, HOUR_S)
    service.faults.append(Fault(path, "edited", times=9, edit=edit))
    with contextlib.suppress(PlantError):
        plant.reset(20 * DAY_S, HOUR_S)
    with contextlib.suppress(PlantError):
        plant.advance(0.5, 900)
    with contextlib.suppress(PlantError):
        plant.past(900)
    with contextlib.suppress(PlantError):
        plant.kpis()


@pytest.mark.parametrize(("u", "duration"), [(float("nan"), 900), (1.5, 900), (0.5, 0), (0.5, float("inf"))])
def test_bad_actions_never_reach_the_service(plant, service, u, duration):
    plant.reset(20 * DAY_S, 0)
    before = service.count("advance/")
    with pytest.raises(InputError):
        plant.advance(u, duration)
    assert service.count("advance/") == before
