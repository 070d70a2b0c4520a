"""Many buildings: each gets the model it would get alone, and one that cannot be identified costs only itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, record

from thermoforce_mpc.data import Layout
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.pipeline import BuildingRecords, identify_many

LIGHT = House(tau_h=(0.3, 2.0, 30.0), gain_K=(3.0, 15.0))
COOLED = House(sign=-1)


@pytest.fixture(scope="module")
def buildings():
    """Of different lengths, steps, gaps and signs."""
    silent = record(House(), 2.0, seed=2, noise_K=0.01)
    silent = replace(silent, T_zone_C=np.where(np.arange(silent.n_steps + 1) % 7 == 3, np.nan, silent.T_zone_C))
    return [
        BuildingRecords("heavy", [record(House(), 2.0, seed=1, noise_K=0.01)]),
        BuildingRecords("silent sensor", [silent], config=IdentificationConfig(order=2, modulation="linear")),
        BuildingRecords("light", [record(LIGHT, 1.5, 600.0, seed=3, noise_K=0.01, heat_measured=False)]),
        BuildingRecords(
            "cooled", [record(COOLED, 1.5, seed=4, noise_K=0.01)], layout=Layout.single("cooling", 0.0, 150.0)
        ),
    ]


def same(one, other):
    for a, b in ((one.only.operator, other.only.operator), (one.only.free, other.only.free)):
        np.testing.assert_allclose(a.poles, b.poles, rtol=1e-6)
    np.testing.assert_allclose(one.only.operator.gains, other.only.operator.gains, rtol=1e-6)
    np.testing.assert_allclose(one.only.free.weights, other.only.free.weights, rtol=1e-6, atol=1e-9)
    assert one.only.card == other.only.card


def test_each_gets_the_model_that_it_gets_alone_in_any_order(buildings):
    config = IdentificationConfig(modulation="linear")
    many = {found.name: found for found in identify_many(buildings, config)}
    assert list(many) == [building.name for building in buildings]
    again = {found.name: found for found in identify_many(buildings[::-1], config)}
    for building in buildings:
        alone = identify(building.runs, config=building.config or config, layout=building.layout)
        same(many[building.name].model, alone)
        same(again[building.name].model, alone)
    assert many["cooled"].model.only.operator.sign == -1


def test_one_without_a_model_costs_only_itself(buildings):
    idle = replace(buildings[0].runs[0], u=np.zeros(buildings[0].runs[0].n_steps))
    damaged = BuildingRecords("damaged", ["not a record"])
    found = list(identify_many([BuildingRecords("idle", [idle]), damaged, BuildingRecords("empty"), buildings[1]]))
    assert [one.name for one in found] == ["idle", "damaged", "empty", "silent sensor"]
    assert [one.model is None for one in found] == [True, True, True, False]
    assert [one.refused for one in found] == [True, False, True, False]
    assert "u is constant" in found[0].reason
    assert found[1].reason.startswith("AttributeError")
    assert "give at least one run or pair" in found[2].reason
    assert found[3].reason == ""


def test_buildings_are_taken_one_at_a_time(buildings):
    taken = []

    def told():
        for building in buildings[1:]:
            taken.append(building.name)
            yield building

    next(identify_many(told()))
    assert taken == ["silent sensor"]
