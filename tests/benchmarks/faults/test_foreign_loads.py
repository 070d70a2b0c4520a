"""Generated houses with an air unit on their meter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.faults.foreign import WithAirUnit, found_in
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house


@pytest.mark.parametrize("meter", ["power", "heat"])
def test_the_meter_holds_what_the_house_does_not_feel(meter):
    house = replace(draw_house(31, 0), heat_metered=True)
    own, beside, shown = GeneratedHousePlant(house), WithAirUnit(house, 0.5, meter), f"{meter}_W"
    for plant in (own, beside):
        plant.reset(30 * DAY_S, DAY_S)
    alone, measured = own.advance(0.5, 900.0), beside.advance(0.5, 900.0)
    other_W = getattr(measured, shown) - getattr(alone, shown)
    np.testing.assert_allclose(other_W, beside.other_W(np.array([30 * DAY_S]), measured.T_out_C))
    assert (other_W > 0.0).all()
    np.testing.assert_array_equal(measured.T_zone_C, alone.T_zone_C)
    np.testing.assert_allclose(
        getattr(beside.past(900.0), shown) - getattr(own.past(900.0), shown),
        [beside.other_W(own.past(900.0).time_s[:-1], own.past(900.0).T_out_C[:-1])],
    )
    assert own.kpis() == beside.kpis(), "it is not the house's"


@pytest.mark.slow
def test_it_is_found_and_taken_for_no_fault():
    found = found_in(draw_house(31, 2), 0.5, "power", days=1.0)
    assert "another load" in found.words
    assert (found.spells, found.steps) == (0, 0)
