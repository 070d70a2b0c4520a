"""How far a power law is believed where it says what other levels would have taken."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.data import HOUR_S, Record
from thermoforce_mpc.model.machine.change import UNKNOWN, Share, share_of_change, weight_of_demand


def record(days: int, step_h: float = 0.5) -> tuple[Record, np.ndarray]:
    """Days whose levels are high when it is cold and dull, and the power that is not theirs, W."""
    rng, n = np.random.default_rng(3), round(24 * days / step_h)
    time_s = step_h * HOUR_S * np.arange(n + 1)
    hour, day = time_s / HOUR_S % 24, (time_s // (24 * HOUR_S)).astype(int)
    T_out_C = 5.0 + 4.0 * np.cos(2 * np.pi * (hour - 15) / 24) + rng.normal(0.0, 3.0, days + 1)[day]
    sun = np.maximum(600.0 * np.cos(2 * np.pi * (hour - 12) / 24), 0.0) * rng.uniform(0.1, 1.0, days + 1)[day]
    u = np.clip(
        0.5 - 0.04 * (T_out_C[:-1] - 5.0) - 0.0005 * sun[:-1] + np.repeat(rng.uniform(-0.3, 0.3, n // 6 + 1), 6)[:n],
        0.0,
        1.0,
    )
    seen = Record(time_s, np.full(n + 1, 20.0), T_out_C, sun, u=u, power_W=u, heat_W=u)
    return seen, 200.0 * np.isin(hour[:-1].astype(int) // 3, (2, 6)) + 30.0 * (10.0 - T_out_C[:-1]) - 1.5 * sun[:-1]


@pytest.mark.parametrize("share", [1.0, 0.6, 0.0])
@pytest.mark.parametrize("step_h", [0.5, 1.0])
def test_the_part_of_a_change_that_came_is_told_apart_from_weather_and_hour(share, step_h):
    seen, others_W = record(12, step_h)
    expected_W = 2000.0 * seen.u[0]
    measured_W = share * expected_W + others_W + np.random.default_rng(1).normal(0.0, 20.0, others_W.size)
    found = share_of_change(expected_W, measured_W, seen)
    assert found.mean == pytest.approx(share, abs=0.05)
    assert 0.001 < found.sd < 0.05
    assert found.spread == pytest.approx(np.hypot(share - 1.0, found.sd), abs=0.06)
    gaps = measured_W.copy()
    gaps[10:40] = np.nan
    assert share_of_change(expected_W, gaps, seen).mean == pytest.approx(share, abs=0.05)


def test_few_days_or_a_law_that_expects_no_change_say_nothing():
    seen, others_W = record(5)
    assert share_of_change(2000.0 * seen.u[0], others_W, seen) == Share(1.0, UNKNOWN)
    seen, others_W = record(12)
    assert share_of_change(np.full(others_W.size, 800.0), others_W, seen) == Share(1.0, UNKNOWN)


def test_power_goes_by_demand_the_more_the_law_is_wrong():
    assert [weight_of_demand(spread) for spread in (0.0, 0.15, 0.3, 1.0)] == pytest.approx([0.0, 0.5, 1.0, 1.0])
    assert Share(3.0, 0.2).spread == UNKNOWN
