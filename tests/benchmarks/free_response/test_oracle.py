"""The limit of free responses: the true future, from a branch that the plant does not notice."""

from __future__ import annotations

import numpy as np
import pytest
from buildings.simple_house import simple_model
from buildings.two_houses import TwoHouses

from benchmarks.free_response.oracle import oracles
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Observation
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house
from thermoforce_mpc.plants.rooms import house_of_rooms

HOURS = 24


def operator_of(plant) -> BuildingOperator:
    names, pair = plant.past(HOUR_S).names, simple_model().only.operator
    n = len(names.zones)
    pairs = tuple(tuple(pair if a == z else None for a in range(n)) for z in range(n))
    return BuildingOperator(names.zones, names.actuators, pairs, tuple(range(n)))


@pytest.mark.slow
@pytest.mark.parametrize(
    "plant",
    [
        lambda: EmbeddedPlant(synthetic_weather(), people=7),
        lambda: GeneratedHousePlant(draw_house(2026, 0), people=7),
        lambda: house_of_rooms("house:2rooms", 7),
    ],
    ids=["embedded", "generated", "rooms"],
)
def test_without_action_what_it_knows_comes_to_pass_and_the_plant_stands_where_it_stood(plant):
    plant = plant()
    zones = len(np.atleast_1d(plant.reset(44 * DAY_S, DAY_S).T_zone_C))
    for level in (1.0, 0.3, 0.0):  # what was done is still in the house
        plant.advance((level,) * zones, 2 * HOUR_S)
    operator = operator_of(plant)
    observation = Observation(plant.past(HOUR_S), plant.forecast(HOURS * HOUR_S, HOUR_S))
    before = plant.past(HOUR_S), plant.kpis()
    context = Predictor(operator, oracles(plant, operator)).context(observation)
    np.testing.assert_array_equal(plant.past(HOUR_S).T_zone_C, before[0].T_zone_C)
    assert plant.kpis() == before[1]

    said = context.predict(np.zeros((zones, HOURS))).total_C
    came = [plant.advance((0.0,) * zones, HOUR_S).T_zone_C for _ in range(HOURS)]
    np.testing.assert_allclose(said, np.array(came).T, atol=1e-9)
    assert np.abs(context.free.median_C - said).max() > 0.1  # the rest of the heat is in F, not in what is free


def test_a_plant_that_stands_elsewhere_or_keeps_its_state_to_itself_is_refused():
    plant = GeneratedHousePlant(draw_house(2026, 0))
    plant.reset(44 * DAY_S, DAY_S)
    operator = operator_of(plant)
    history, boundary = plant.past(HOUR_S), plant.forecast(HOURS * HOUR_S, HOUR_S)
    plant.advance(0.0, HOUR_S)
    with pytest.raises(InputError, match="hand it the plant that is controlled"):
        oracles(plant, operator)[0].forecast(history.T_zone_C[0], history, boundary)
    with pytest.raises(InputError, match="TwoHouses keeps its state to itself"):
        oracles(TwoHouses(), operator)
