"""The on/off rule that acts in a plan's place: the set-point that it keeps, and the bounds that it is taken from."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.safety.fallback_policy import FallbackConfig, FallbackPolicy
from thermoforce_mpc.data import HOUR_S, Boundary


def bounds(lower_C, upper_C) -> Boundary:
    """Hourly bounds from now on."""
    still = np.zeros(len(lower_C))
    return Boundary(
        time_s=HOUR_S * np.arange(still.size),
        T_out_C=still,
        solar_W_m2=still,
        occupancy=still[None],
        lower_C=np.array([lower_C]),
        upper_C=np.array([upper_C]),
        price_per_kWh=still[None],
        emission_kg_per_kWh=still[None],
    )


def level(mode: str, T_zone_C: float, lower_C, upper_C, level: float = 0.8, **options) -> float | None:
    policy = FallbackPolicy(FallbackConfig(**options), 900.0, level, mode)
    return policy.rule_at(T_zone_C, bounds(lower_C, upper_C), 0.0)[0]


@pytest.mark.parametrize(("T_C", "acts"), [(21.29, 0.8), (21.31, 0.0)])
def test_heating_keeps_the_set_point_above_the_lower_bound(T_C, acts):
    assert level("heating", T_C, [21.0] * 5, [24.0] * 5) == acts


@pytest.mark.parametrize(("T_C", "acts"), [(23.71, 0.8), (23.69, 0.0)])
def test_cooling_keeps_it_below_the_upper_bound(T_C, acts):
    assert level("cooling", T_C, [21.0] * 5, [24.0] * 5) == acts


def test_the_tightest_bound_of_the_hours_ahead_counts_and_none_after_them():
    rising = [17.0, 17.0, 17.0, 21.0, 22.0]
    assert level("heating", 21.2, rising, [26.0] * 5) == 0.8, "21 °C is asked for in 3 h"
    assert level("heating", 21.4, rising, [26.0] * 5) == 0.0, "22 °C only in 4 h"
    falling = [26.0, 26.0, 24.0, 23.0, 22.0]
    assert level("cooling", 22.8, [17.0] * 5, falling) == 0.8
    assert level("cooling", 22.6, [17.0] * 5, falling) == 0.0


def test_without_bounds_the_safe_set_points_are_kept():
    unknown = [np.nan] * 5
    assert [level("heating", T, unknown, unknown) for T in (19.9, 20.1)] == [0.8, 0.0]
    assert [level("cooling", T, unknown, unknown) for T in (25.1, 24.9)] == [0.8, 0.0]


def test_bounds_that_no_building_has_move_it_no_further_than_its_limits():
    assert [level("heating", T, [60.0] * 5, [70.0] * 5) for T in (34.9, 35.1)] == [0.8, 0.0]
    assert [level("cooling", T, [-70.0] * 5, [-60.0] * 5) for T in (5.1, 4.9)] == [0.8, 0.0]
