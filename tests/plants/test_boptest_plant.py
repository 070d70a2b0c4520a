"""The plant on a service must tell the same story as the emulator inside that service."""

from __future__ import annotations

import math

import numpy as np
import pytest
from boptest_server import Fault, running_service

from boptest_client import TransportConfig
from thermoforce_mpc.errors import ConfigError, InputError, PlantError
from thermoforce_mpc.plants.boptest import BoptestPlant
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario import load_testcase
from thermoforce_mpc.types import DAY_S, HOUR_S
from thermoforce_mpc.weather import synthetic_weather

QUICK = TransportConfig(connect_timeout_s=1.0, read_timeout_s=20.0, retries=1, backoff_s=0.01)
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
        assert math.isnan(a.u) if u is None else a.u == u
    for name, value in inside.kpis().items():
        assert plant.kpis()[name] == pytest.approx(value)
    a, b = plant.forecast(DAY_S, HOUR_S), inside.forecast(DAY_S, HOUR_S)
    for name in a.__dataclass_fields__:
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-9, err_msg=name)


def test_the_past_holds_the_warm_up_with_heat_but_no_level(plant):
    plant.reset(20 * DAY_S, 2 * DAY_S)
    past = plant.past(HOUR_S)
    inside = EmbeddedPlant(synthetic_weather())
    inside.reset(20 * DAY_S, 2 * DAY_S)
    truth = inside.past(HOUR_S)
    assert past.n_steps == 48
    np.testing.assert_allclose(past.T_zone_C, truth.T_zone_C, atol=1e-6)
    np.testing.assert_allclose(past.heat_W, truth.heat_W, rtol=1e-9, atol=1e-6)
    assert np.isnan(past.u).all()


def test_named_periods_are_the_services_official_scenarios(plant, service):
    period = plant.period("peak_heat_day")
    before = service.count("scenario/")
    assert plant.reset(period.start_s, period.warmup_s).time_s == period.start_s
    assert service.count("scenario/") == before + 1
    service.ends = dict.fromkeys(service.ends, period.start_s + 3600)
    plant.advance(None, 3600)
    kpis = plant.kpis()
    with pytest.raises(PlantError, match="scenario ended"):
        plant.advance(None, 3600)
    assert kpis["ener_tot"] >= 0


def test_a_test_case_file_that_does_not_fit_is_refused_by_key(service):
    wrong = TESTCASE.model_copy(
        update={"measurements": TESTCASE.measurements.model_copy(update={"zone_temperature": "reaTZone_y"})}
    )
    stopped = len(service.stopped)
    with pytest.raises(ConfigError, match=r"measurements\.zone_temperature: .*did you mean 'reaTZon_y'"):
        BoptestPlant(service.url, wrong, config=QUICK)
    assert len(service.stopped) == stopped + 1, "the test it selected is stopped"


def test_a_test_case_the_service_does_not_offer_is_bad_input(service):
    with pytest.raises(ConfigError, match="not offered"):
        BoptestPlant(service.url, TESTCASE.model_copy(update={"name": "nonsense"}), config=QUICK)


@pytest.mark.parametrize("kind", ["500", "drop", "gone"])
def test_a_service_that_fails_is_a_plant_error(plant, service, kind):
    plant.reset(20 * DAY_S, 0)
    service.faults.append(Fault("advance/", kind))
    with pytest.raises(PlantError, match="BOPTEST service"):
        plant.advance(0.5, 900)


@pytest.mark.parametrize(("u", "duration"), [(float("nan"), 900), (1.5, 900), (0.5, 0), (0.5, float("inf"))])
def test_bad_actions_never_reach_the_service(plant, service, u, duration):
    plant.reset(20 * DAY_S, 0)
    before = service.count("advance/")
    with pytest.raises(InputError):
        plant.advance(u, duration)
    assert service.count("advance/") == before
