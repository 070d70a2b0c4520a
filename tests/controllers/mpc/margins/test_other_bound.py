"""The bound that actuation does not protect is kept for the quantile at which heat and discomfort cost the same."""

from __future__ import annotations

from dataclasses import replace

import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from thermoforce_mpc.data import DAY_S, HOUR_S, Observation


def backoffs_K(price_per_kWh: float) -> tuple[float, float]:
    """Back-off inside the upper bound of a heated house, and inside the lower at a fifth, first step, K."""
    house = SimpleHouse(21.0)
    house.reset(10 * DAY_S, 0.0)
    ahead = house.forecast(DAY_S, HOUR_S)
    prices = 0.0 * ahead.price_per_kWh + price_per_kWh
    seen = Observation(house.past(HOUR_S), replace(ahead, price_per_kWh=prices, heating_price_per_kWh=prices))
    config = MPCConfig.model_validate(
        {
            "step_s": None,
            "horizon_h": 24.0,
            "backoff_level": 0.2,
        }
    )
    plan = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse()).plan(seen)
    lower, upper = plan.margins["backoff"][:, 0]
    return float(upper), float(lower)


def test_cheap_heat_keeps_more_room_below_the_upper_bound_than_dear_heat(monkeypatch):
    monkeypatch.setattr(MPCConfig, "backoff_violation_K", 9.0)
    (cheap, _), (dear, lower) = backoffs_K(0.01), backoffs_K(20.0)
    assert cheap > 1.2 * dear > 0.0
    # However dear, a K·h counts as at least five times the heat that avoids it: the fifth.
    assert dear == pytest.approx(lower, rel=0.01)
