"""What discomfort counts: per floor area of its zone, and always more than the heat that would avoid it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import FIXED_W, GAIN_K, PER_U_W, POLE, OutdoorResponse, SimpleHouse, simple_model
from two_houses import two_model, two_observation

from controllers import MPCConfig, ThermoForceMPC
from controllers.mpc.config import ObjectiveConfig
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Observation, Plan
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.thermal_model import ThermalModel

PER_M2 = ObjectiveConfig().comfort_weight_per_m2
# Cost of the simple house's heat that avoids a K·h over a day, currency: an hour at full level over its mean effect.
MEAN_K = GAIN_K / (1.0 - POLE) * (1.0 - (POLE ** np.arange(1.0, 25.0)).mean())
HEAT = 0.25 * (FIXED_W + PER_U_W) / 1000.0 / MEAN_K


def house(area_m2: float = 192.0) -> ThermalModel:
    return replace(simple_model(), floor_area_m2=(area_m2,))


def seen(zones: int = 1, price: float = 0.25) -> Observation:
    if zones == 1:
        plant = SimpleHouse()
        plant.reset(10 * DAY_S, 2 * DAY_S)
        observation = Observation(plant.past(HOUR_S), plant.forecast(DAY_S, HOUR_S))
    else:
        observation = two_observation()
    prices = np.full_like(observation.boundary.price_per_kWh, price)
    boundary = replace(observation.boundary, price_per_kWh=prices, heating_price_per_kWh=prices)
    return replace(observation, boundary=boundary)


def controller(model: ThermalModel, **objective: float) -> ThermoForceMPC:
    config = MPCConfig(step_s=None, horizon_h=24.0, objective=objective)
    return ThermoForceMPC(model, config, free_response=OutdoorResponse())


def weights(model: ThermalModel, price: float = 0.25, **objective: float) -> Array:
    """Those of the problem, one for each zone."""
    mpc, observation = controller(model, **objective), seen(len(model.operator.zones), price)
    return mpc.instance(mpc.predictor.context(observation), observation.history).weights.comfort


def first_plan(model: ThermalModel, price: float = 0.25, **objective: float) -> Plan:
    return controller(model, **objective).plan(seen(len(model.operator.zones), price))


def test_carbon_is_a_price_of_the_hour_in_which_it_is_emitted():
    observation = seen()
    dirty = 0.5 * (np.arange(observation.boundary.n_steps + 1) % 8 < 4)[None]
    emitting = replace(observation.boundary, emission_kg_per_kWh=dirty)
    prices = observation.boundary.price_per_kWh + 0.4 * dirty
    dearer = replace(observation.boundary, price_per_kWh=prices, heating_price_per_kWh=prices)
    plans = [
        controller(house(), carbon_price_per_kg=carbon).plan(replace(observation, boundary=boundary))
        for carbon, boundary in ((0.4, emitting), (0.0, dearer), (0.0, emitting))
    ]
    np.testing.assert_allclose(plans[0].u, plans[1].u, atol=1e-6)
    assert np.abs(plans[0].u - plans[2].u).max() > 0.1


def test_discomfort_counts_per_floor_area():
    large = 44 * 192.0
    assert weights(house()) == pytest.approx([192.0 * PER_M2])
    assert weights(house(large)) == pytest.approx(44 * weights(house()))
    assert weights(house(), comfort_weight_per_m2=0.1) == pytest.approx([19.2])
    assert weights(replace(two_model(), floor_area_m2=(60.0, 110.0))) == pytest.approx([60 * PER_M2, 110 * PER_M2])


def test_a_zone_of_unknown_area_counts_as_the_heat_pump_case():
    assert weights(simple_model()) == weights(house(192.0))
    assert ObjectiveConfig().comfort_weights([float("nan"), 10.0]) == pytest.approx([192 * PER_M2, 10 * PER_M2])


def test_a_weight_below_what_heat_costs_is_raised_and_the_first_plan_says_so():
    assert weights(house(), price=250.0) == pytest.approx([5_000 * HEAT])
    assert weights(house(), comfort_weight_per_m2=1e-5) == pytest.approx([5 * HEAT])
    for plan in (first_plan(house(), price=250.0), first_plan(house(), comfort_weight_per_m2=1e-5)):
        assert "a K·h of discomfort counts " in plan.news
        assert plan.why.startswith(plan.news)
    expected = f"counts {5 * HEAT:.3g} instead of {192e-5:.3g}, since the heat that avoids it costs {HEAT:.3g}"
    assert expected in first_plan(house(), comfort_weight_per_m2=1e-5).news


def test_it_is_said_once():
    plant = SimpleHouse()
    period = replace(plant.period("x"), scored_s=3 * HOUR_S)
    steps = run_closed_loop(plant, controller(house(), comfort_weight_per_m2=1e-5), period).steps
    assert ["a K·h of discomfort" in step.plan.why for step in steps] == [True, False, False]


def test_the_default_is_not_raised():
    assert 192 * PER_M2 > 5 * HEAT
    assert first_plan(house()).news == ""
    assert first_plan(replace(two_model(), floor_area_m2=(192.0, 192.0))).news == ""


def test_only_the_zones_whose_heat_is_dear_are_raised_by_name():
    model = replace(two_model(), floor_area_m2=(192.0, 1.0))
    assert weights(model) == pytest.approx([192 * PER_M2, 5 * HEAT])
    news = first_plan(model).news
    assert news.startswith("hall: a K·h")
    assert "bath" not in news


def test_the_highest_price_of_the_horizon_decides():
    observation = seen()
    price = observation.boundary.price_per_kWh.copy()
    price[:, 5] = 250.0
    dear = replace(observation.boundary, price_per_kWh=price, heating_price_per_kWh=price)
    mpc = controller(house())
    problem = mpc.instance(mpc.predictor.context(replace(observation, boundary=dear)), observation.history)
    assert problem.weights.comfort == pytest.approx([5_000 * HEAT])


def test_free_heat_raises_nothing():
    assert weights(house(), price=0.0, comfort_weight_per_m2=1e-5) == pytest.approx([192e-5])
    assert weights(house(), price=-1.0, comfort_weight_per_m2=1e-5) == pytest.approx([192e-5])


def test_a_cooled_zone_is_weighed_by_its_cold():
    zone = house().only
    cooled = replace(zone.operator, gains=-zone.operator.gains, sign=-1, heat_input=HeatInput())
    model = replace(ThermalModel.of_zone(replace(zone, operator=cooled)), floor_area_m2=(192.0,))
    assert weights(model, comfort_weight_per_m2=1e-5) == pytest.approx([5 * HEAT])
