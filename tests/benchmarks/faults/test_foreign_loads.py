"""Generated houses with an air unit on their meter."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.faults.foreign import WithAirUnit, found_in
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house


def test_the_meter_holds_what_the_house_does_not_feel():
    house = draw_house(31, 0)
    own, beside = GeneratedHousePlant(house), WithAirUnit(house, 0.5)
    for plant in (own, beside):
        plant.reset(30 * DAY_S, DAY_S)
    alone, measured = own.advance(0.5, 900.0), beside.advance(0.5, 900.0)
    other_W = measured.power_W - alone.power_W
    np.testing.assert_allclose(other_W, beside.other_W(np.array([30 * DAY_S]), measured.T_out_C))
    assert (other_W > 0.0).all()
    np.testing.assert_array_equal(measured.T_zone_C, alone.T_zone_C)
    np.testing.assert_allclose(
        beside.past(900.0).power_W - own.past(900.0).power_W,
        [beside.other_W(own.past(900.0).time_s[:-1], own.past(900.0).T_out_C[:-1])],
    )
    assert own.kpis() == beside.kpis(), "it is not the house's"


@pytest.mark.slow
def test_it_is_found_and_taken_for_no_fault(monkeypatch):
    monkeypatch.setattr("benchmarks.faults.foreign.DAYS", 1.0)
    found = found_in(draw_house(31, 2), 0.5)
    assert "another load" in found.words
    assert (found.spells, found.steps) == (0, 0)
