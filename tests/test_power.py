"""Fitting electric power and heat to what was measured."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.power import HEAT_SLOPE, fit_load, fit_power
from thermoforce_mpc.types import History


def _machine(u, T):
    return (u > 0) * (1500 + 5 * T) + u * (2000 + 40 * T)


def _history(u, T, power) -> History:
    n = len(u)
    return History(
        time_s=np.arange(n + 1) * 900.0,
        T_zone_C=np.full(n + 1, 21.0),
        T_out_C=np.append(T, T[-1]),
        solar_W_m2=np.zeros(n + 1),
        u=u,
        power_W=power,
        heat_W=np.full(n, np.nan),
    )


def test_levels_recover_fixed_and_proportional_part():
    rng = np.random.default_rng(0)
    u, T = rng.choice([0, 0.2, 0.4, 0.7, 1.0], 400), rng.uniform(-5, 12, 400)
    fit = fit_load(u, T, _machine(u, T), what="power")
    np.testing.assert_allclose(fit.load.coefficients, (1500, 5, 2000, 40), rtol=1e-6)
    assert fit.load.lowest_level == 0.2
    assert fit.rmse_W < 1e-6
    assert fit.r2 == pytest.approx(1.0)
    model = fit_power(_history(u, T, _machine(u, T)))
    np.testing.assert_allclose(model(np.array([0.0, 0.5]), 3.0), [0.0, _machine(0.5, 3.0)], rtol=1e-3)


def test_a_narrow_range_leans_on_the_slope_known_beforehand():
    rng = np.random.default_rng(3)
    u, T = rng.choice([0, 0.2, 0.4, 0.7, 1.0], 96), rng.uniform(4.5, 5.5, 96)
    y = u * 9000 * (1 + 0.025 * T) * (1 + 0.02 * rng.normal(size=96))
    truth = 9000 * (1 - 0.025 * 5)
    with_prior = fit_load(u, T, y, what="heat", slope=HEAT_SLOPE).load(np.array(1.0), np.array(-5.0))
    without = fit_load(u, T, y, what="heat").load(np.array(1.0), np.array(-5.0))
    # Ten kelvin away, one prior standard deviation is 15 %.
    assert abs(with_prior / truth - 1) < 0.2
    assert abs(without - truth) > 1.5 * abs(with_prior - truth)


def test_duty_data_give_a_load_proportional_to_the_share_of_time():
    rng = np.random.default_rng(1)
    u, T = rng.choice([0, 1 / 3, 2 / 3, 1.0], 300), rng.uniform(-5, 12, 300)
    share = u * _machine(1.0, T)
    fit = fit_load(u, T, share, what="power")
    assert fit.load.lowest_level == 1.0
    assert not fit.load.levels_seen
    np.testing.assert_allclose(fit.load(u, T), share, rtol=1e-9)


def test_a_load_that_would_go_negative_is_held_at_zero():
    rng = np.random.default_rng(2)
    T = rng.uniform(-10, 10, 300)
    y = np.maximum(200.0 * T, 0.0)  # nothing below 0 °C: an affine law through it would go below zero
    fit = fit_load(np.ones(300), T, y, what="power")
    assert fit.load(np.ones(2), np.array([-10.0, 10.0])).min() >= 0


def test_unusable_power_is_refused_with_numbers():
    u, T = np.ones(50), np.zeros(50)
    with pytest.raises(DataError, match="only 0 of 50"):
        fit_load(u, T, np.full(50, np.nan), what="electric power")
    with pytest.raises(DataError, match="on in 0"):
        fit_load(0 * u, T, np.zeros(50), what="electric power")


def test_real_machine_within_two_percent(shared):
    frame = pd.read_csv(shared / "boptest_hp" / "excite_jan.csv.gz")
    power = (frame.reaPHeaPum_y + frame.reaPFan_y + frame.reaPPumEmi_y).to_numpy()
    u, T = frame.oveHeaPumY_u.to_numpy(), frame.weaSta_reaWeaTDryBul_y.to_numpy()
    half = len(u) // 2
    fit = fit_load(u[:half], T[:half], power[:half], what="electric power")
    later = fit.load(u[half:], T[half:])
    assert abs(later.sum() / power[half:].sum() - 1) < 0.02
    # The machine's map at 0 °C outside and 30 °C return (test case documentation), with its fan and pump.
    auxiliary = 510.2 + 20.5
    for level, compressor in ((0.25, 1596.0), (0.5, 2105.0), (1.0, 3148.0)):
        assert fit.load(np.array(level), np.array(0.0)) == pytest.approx(compressor + auxiliary, rel=0.05)
