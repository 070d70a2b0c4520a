"""`bench commands`: what days saved against the house left alone."""

from __future__ import annotations

import pytest

from benchmarks.commands.bench import Lived


def test_heat_that_is_missing_in_the_house_counts_at_its_mean_cost():
    own = Lived(cost=10.0, energy_kWh=40.0, below_Kh=0.0, above_Kh=0.0, heat_kWh=100.0, stored_kWh=50.0)
    warmer = Lived(cost=11.0, energy_kWh=44.0, below_Kh=0.0, above_Kh=0.0, heat_kWh=110.0, stored_kWh=60.0)
    colder = Lived(cost=9.0, energy_kWh=36.0, below_Kh=0.0, above_Kh=0.0, heat_kWh=90.0, stored_kWh=45.0)
    assert own.saved_by(warmer) == pytest.approx(-0.1)
    assert own.saved_by(colder) == pytest.approx(0.05)
