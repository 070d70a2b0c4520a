"""The bound that actuation does not protect is kept for the quantile at which heat and discomfort cost the same."""

from __future__ import annotations

from dataclasses import replace

import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from thermoforce_mpc.data import DAY_S, HOUR_S, Observation


def upper_backoff_K(price_per_kWh: float, weight: float = 0.026, **options: float) -> float:
    """Back-off inside the upper bound of a heated house at the end of the first step, K."""
    house = SimpleHouse(21.0)
    house.reset(10 * DAY_S, 0.0)
    ahead = house.forecast(DAY_S, HOUR_S)
    prices = 0.0 * ahead.price_per_kWh + price_per_kWh
    seen = Observation(house.past(HOUR_S), replace(ahead, price_per_kWh=prices, heating_price_per_kWh=prices))
    config = MPCConfig.model_validate(
        {
            "step_s": None,
            "horizon_h": 24.0,
            "backoff_violation_K": None,
            "objective": {"comfort_weight_per_m2": weight},
            **options,
        }
    )
    plan = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse()).plan(seen)
    return float(plan.margins["backoff"][1, 0])


def test_cheap_heat_keeps_more_room_below_the_upper_bound_than_dear_heat():
    cheap, dear = upper_backoff_K(0.01), upper_backoff_K(20.0)
    assert cheap == pytest.approx(upper_backoff_K(0.01, backoff_level_other=0.05))
    assert cheap > 1.2 * dear > 0.0
    # However dear, a K·h counts as at least five times the heat that avoids it: the fifth.
    assert dear == pytest.approx(upper_backoff_K(20.0, backoff_level_other=0.2), rel=0.01)


def test_a_level_that_is_given_stays():
    assert upper_backoff_K(0.01, backoff_level_other=0.3) == upper_backoff_K(20.0, backoff_level_other=0.3)
