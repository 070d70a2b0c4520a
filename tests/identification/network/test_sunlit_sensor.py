"""Sun on a zone sensor: found where it is, not where the sun warms the room, and taken off what is planned from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from thermoforce_mpc.boundary.weather.solar import on_plane, sun_position
from thermoforce_mpc.boundary.weather.synthetic import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Layout, Observation, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.network.sensor import sun_on_sensor
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.loop.probing import Probing
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor, facade_W_m2, sensor_lag, sun_at
from thermoforce_mpc.model.thermal_model import load_model
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, House, draw_house
from thermoforce_mpc.whatif.rollouts import rollouts

# Three sunny days in March, before the sunny week of these houses.
START_S = 66 * DAY_S
SUN = SunOnSensor(3.0, 0.5, 0.9, 180.0, 600.0, 50.0, 12.0 * HOUR_S)


def probed(house: House, days: float = 3.0) -> tuple[Record, Array]:
    """Record of `days` of probing, and the true temperature at its boundaries, °C."""
    plant = GeneratedHousePlant(house)
    run = Probing(plant, START_S, seed=1, layout=plant.testcase.layout)
    run.go_on(days)
    trace = plant.recorded(float(run.record.time_s[0]), float(run.record.time_s[-1]))
    return run.record, np.interp(run.record.time_s, trace["time"], trace["T_operative"]) - 273.15


def found(record: Record) -> SunOnSensor | None:
    sun = sun_on_sensor([record], 0, Layout.single(), [HeatInput()], IdentificationConfig())
    return sun if sun is not None and sun.likely else None


@pytest.fixture(scope="module")
def sunlit() -> tuple[Record, Array]:
    """A very light, floor-heated house whose sensor reads 3.1 K too much in the south sun."""
    return probed(draw_house(501, 34))


@pytest.mark.slow
def test_sun_on_a_sensor_is_found_and_its_size_is_right(sunlit):
    record, truth = sunlit
    sun = found(record)
    assert sun is not None
    assert sun.probability > 0.99
    assert sun.azimuth_deg == 180.0
    day = record.solar_W_m2 > 5.0
    wrong = record.T_zone_C[0] - truth
    left = wrong - sun.part_K(record.time_s, record.solar_W_m2)
    assert np.sqrt(np.mean(wrong[day] ** 2)) > 0.5, "the readings are wrong in the sun"
    assert np.sqrt(np.mean(left[day] ** 2)) < 0.4 * np.sqrt(np.mean(wrong[day] ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("index", [34, 35])
def test_sun_that_warms_a_light_room_is_not_taken_for_sun_on_its_sensor(index):
    # Very light houses; 35 with glass of 0.29 of the floor area.
    house = replace(draw_house(501, index), sun_bias_K=0.0)
    assert found(probed(house)[0]) is None


@pytest.mark.slow
def test_a_search_ends_where_the_slopes_vanish():
    """A leaky house with air heating, whose curvatures differ by 10⁵: by slopes alone it ended 180 nats away."""
    sun = found(probed(draw_house(9601, 4), days=7.0)[0])
    assert sun is not None
    assert sun.probability > 0.99
    assert sun.full_K == pytest.approx(1.7, abs=0.5)


@pytest.mark.slow
def test_levels_of_room_set_points_do_not_tell(sunlit):
    levels = HeatInput(u_min=-1.0)
    assert sun_on_sensor([sunlit[0]], 0, Layout.single(), [levels], IdentificationConfig()) is None


@pytest.mark.slow
def test_a_model_is_that_of_the_room_and_says_so(sunlit, tmp_path):
    record, truth = sunlit
    model = identify(record, config=IdentificationConfig(modulation="linear"))
    card = model.only.card
    assert card.sun_on_sensor is not None
    assert any("stands in the sun from the south" in note for note in card.notes)
    day = record.solar_W_m2 > 5.0
    errors = [np.sqrt(np.mean((T[0] - truth)[day] ** 2)) for T in (model.in_rooms(record).T_zone_C, record.T_zone_C)]
    assert errors[0] < 0.4 * errors[1]
    assert load_model(model.save(tmp_path / "model")).only.card.sun_on_sensor == card.sun_on_sensor
    blind = identify(record, config=IdentificationConfig(modulation="linear", sun_on_sensor=False))
    assert blind.only.card.sun_on_sensor is None
    assert blind.in_rooms(record) is record
    plain = replace(model, cards=(replace(card, sun_on_sensor=None),))
    shown, rooms = rollouts(model, record), rollouts(plain, model.in_rooms(record))
    assert shown is not None
    assert rooms is not None
    np.testing.assert_array_equal(shown.predicted_C, rooms.predicted_C)
    np.testing.assert_array_equal(shown.rmse_K, rooms.rmse_K)


def test_a_controller_plans_from_the_room():
    model = simple_model()
    warm = replace(model, cards=(replace(model.cards[0], sun_on_sensor=SUN),))
    house = SimpleHouse()
    house.reset(10 * DAY_S, 24 * HOUR_S)
    plans = []
    for one in (model, warm):
        mpc = ThermoForceMPC(one, MPCConfig(step_s=None), free_response=OutdoorResponse())
        history = house.past(HOUR_S)
        # Noon of a sunny day.
        history = replace(
            history, solar_W_m2=np.full_like(history.solar_W_m2, 300.0), time_s=history.time_s + DAY_S / 2
        )
        boundary = house.forecast(mpc.horizon_s, HOUR_S)
        boundary = replace(boundary, time_s=boundary.time_s + DAY_S / 2)
        plans.append(mpc.plan(Observation(history, boundary)))
    part = SUN.part_K(history.time_s, history.solar_W_m2)[-1]
    assert part > 0.5
    assert plans[0].T_free_now_C[0] - plans[1].T_free_now_C[0] == pytest.approx(part)


def test_irradiance_on_a_facade_is_near_that_of_its_own_components():
    weather, time_s = synthetic_weather(3), np.arange(20.0, 100.0, 0.02) * DAY_S
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    truth = on_plane(weather, sun, time_s, 90.0, 180.0)
    true_W_m2 = truth.beam + truth.diffuse
    noon_s = (12.0 + weather.timezone_h - weather.longitude_deg / 15.0) * HOUR_S
    nominal = sun_at(time_s, weather.latitude_deg, noon_s)
    np.testing.assert_allclose(nominal.zenith, sun.zenith, atol=1e-9)
    estimate = facade_W_m2(time_s, weather.at("global_W_m2", time_s), weather.latitude_deg, noon_s, (180.0,))[:, 0]
    high = np.rad2deg(sun.zenith) < 80.0
    assert np.corrcoef(estimate[high], true_W_m2[high])[0, 1] > 0.95
    assert np.mean(estimate[high]) == pytest.approx(np.mean(true_W_m2[high]), rel=0.15)


def test_lag_of_a_ramp_and_gaps_in_the_irradiance():
    time_s = np.arange(0.0, 6 * HOUR_S, 900.0)
    ramp = np.maximum(time_s - HOUR_S, 0.0)
    late = sensor_lag(ramp, time_s, 600.0)
    rising = time_s >= HOUR_S
    after = time_s[rising] - HOUR_S
    np.testing.assert_allclose(late[rising], after - 600.0 * (1.0 - np.exp(-after / 600.0)), atol=1e-9)
    noon = np.arange(0.0, DAY_S, 900.0)
    solar = np.maximum(np.sin(2 * np.pi * (noon / DAY_S - 0.25)), 0.0) * 300.0
    holed = solar.copy()
    holed[48] = np.nan
    assert SUN.part_K(noon, holed) == pytest.approx(SUN.part_K(noon, solar), abs=0.02)
    assert SUN.part_K(noon, solar)[0] == 0.0
    assert not SUN.part_K(noon, np.full_like(solar, np.nan)).any()


def test_without_irradiance_there_is_nothing_to_find(sunlit):
    record = sunlit[0]
    assert found(replace(record, solar_W_m2=np.zeros_like(record.solar_W_m2))) is None
