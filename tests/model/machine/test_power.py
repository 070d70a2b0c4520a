"""Fitting electric power and heat to what was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from machine_history import machine_history

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.power import ReturnWater, fit_both_directions, fit_load, fit_power


def _machine(u, T):
    return (u > 0) * (1500 + 5 * T) + u * (2000 + 40 * T)


def test_levels_recover_fixed_and_proportional_part():
    rng = np.random.default_rng(0)
    u, T = rng.choice([0, 0.2, 0.4, 0.7, 1.0], 400), rng.uniform(-5, 12, 400)
    fit = fit_load(u, T, _machine(u, T), what="power")
    np.testing.assert_allclose(fit.load.coefficients, (1500, 5, 2000, 40), rtol=1e-6)
    assert fit.load.lowest_level == 0.2
    assert fit.quality.rmse_W < 1e-6
    assert fit.quality.r2 == pytest.approx(1.0)
    model = fit_power([machine_history(u, T, power_W=_machine(u, T))])
    np.testing.assert_allclose(model(np.array([0.0, 0.5]), 3.0), [0.0, _machine(0.5, 3.0)], rtol=1e-3)


def test_a_record_of_three_kelvin_does_not_outvote_the_prior_of_colder_days():
    """Of three mild days, in which what a circuit takes goes up and down for other reasons than the weather."""
    rng = np.random.default_rng(4)
    steps = np.arange(288)
    T = 0.6 + 1.3 * np.sin(2 * np.pi * steps / 96)
    swing = np.convolve(rng.standard_normal(400), np.ones(24) / np.sqrt(24.0), "valid")[:288]
    u = np.repeat(rng.choice([0.0, 0.3, 0.6, 1.0], 36), 8)
    power = (u > 0) * 1.5e5 * (1.0 + 0.15 * swing + 0.06 * (T - 0.6))
    model = fit_power([machine_history(u, T, power_W=power)])
    cold, mild, warm = (float(model(np.array([1.0]), T_out)[0]) for T_out in (-15.0, 0.6, 15.0))
    assert mild == pytest.approx(1.5e5, rel=0.15)
    assert 0.75 * mild < cold < 1.25 * mild
    assert 0.75 * mild < warm < 1.25 * mild
    both = fit_both_directions([machine_history(u, T, power_W=power * u)], u, np.zeros(288))
    cold, warm = (float(both(np.array([1.0]), T_out)[0]) for T_out in (-15.0, 15.0))
    assert 0.5 < cold / warm < 2.0


def test_power_that_grows_faster_than_heat_is_told_apart():
    rng = np.random.default_rng(5)
    u, T = rng.choice([0, 0.2, 0.4, 0.7, 1.0], 400), rng.uniform(-5, 12, 400)
    power = u * (800 - 10 * T) + 1200 * u**2
    model = fit_power([machine_history(u, T, power_W=power)], squares=u**2)
    assert model.load.curve_W == pytest.approx(1200.0, rel=0.02)
    np.testing.assert_allclose(model(np.array([0.5, 1.0]), 3.0), [685.0, 1970.0], rtol=0.01)
    two = model.of_actuators(np.array([[0.6], [0.2]]), np.array([0.5, 0.5]), np.array([3.0]))
    assert two[0] == pytest.approx(0.4 * 770.0 + 1200.0 * 0.5 * (0.36 + 0.04), rel=0.01)
    with pytest.raises(DataError, match="bends downwards"):
        replace(model.load, curve_W=-1.0)


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


def _water_history(rng, n=300):
    u, T = rng.choice([0, 0.2, 0.4, 0.7, 1.0], n), rng.uniform(-5, 12, n)
    T_return = 27 + 4 * u + rng.normal(0, 1.5, n)
    power = _machine(u, T) * (1 + 0.008 * (T_return - 30))
    return replace(machine_history(u, T, power_W=power), T_return_C=T_return)


def test_the_return_water_explains_what_level_and_weather_leave_over():
    rng = np.random.default_rng(4)
    history = _water_history(rng)
    model = fit_power([history])
    blind = fit_power([replace(history, T_return_C=np.full(history.n_steps, np.nan))])
    assert blind.water is None
    assert model.water is not None
    assert model.water.per_K == pytest.approx(0.008, rel=0.15)
    assert model.rmse_W < 0.2 * blind.rmse_W
    other = _water_history(rng)
    missed = model(other.u[0], other.T_out_C[:-1], other.T_return_C[0]) - other.power_W[0]
    assert np.abs(missed).max() < 0.02 * other.power_W[0].max()
    # Not measured: the load as at the reference, and no NaN.
    assert model(np.array([1.0]), np.array([0.0])) == pytest.approx(model.load(np.array([1.0]), np.array([0.0])))
    fixed, per_u = model.parts(np.array([0.0]), np.array([model.water.reference_C + 2.0]))
    assert fixed + per_u == pytest.approx(model.load(np.array(1.0), np.array(0.0)) * (1 + 2 * model.water.per_K))


def test_errors_that_last_for_hours_say_less_of_the_return_water():
    """The same steps in another order are as likely, but for what goes on from one to the next."""
    rng = np.random.default_rng(6)
    u, T, lasting = np.full(96, 0.7), rng.uniform(-5, 12, 96), np.sin(np.arange(96) / 8.0)
    T_return = 30.0 + 1.5 * lasting + rng.normal(0, 1.0, 96)
    power = _machine(u, T) * (1 + 0.04 * 1.5 * lasting)
    per_K = []
    for order in (np.arange(96), rng.permutation(96)):
        history = machine_history(u, T[order], power_W=power[order])
        per_K.append(fit_power([replace(history, T_return_C=T_return[order])]).water.per_K)
    lasting_K, shuffled_K = (abs(one - 0.01) for one in per_K)
    assert lasting_K < 0.9 * shuffled_K


def test_few_running_steps_say_nothing_of_the_return_water():
    history = _water_history(np.random.default_rng(5), 12)
    assert fit_power([history]).water is None


def test_return_water_ahead_is_as_far_above_the_zone_as_yesterday():
    water = ReturnWater(0.008, 30.0, (25.0, 35.0), above_zone_K=9.0)
    history = _water_history(np.random.default_rng(6))
    day = 96
    on = history.u[0, -day:] > 0
    above = np.average((history.T_return_C[0, -day:] - 21.0)[on], weights=history.u[0, -day:][on])
    np.testing.assert_allclose(water.expected_C(history, np.array([20.0, 22.0])), np.array([20.0, 22.0]) + above)
    silent = replace(history, T_return_C=np.full(history.n_steps, np.nan))
    np.testing.assert_allclose(water.expected_C(silent, np.array([20.0])), [29.0])
    # Far from what was seen the factor is held.
    assert water.factor(np.array(60.0)) == water.factor(np.array(35.0))


def test_unusable_power_is_refused_with_numbers():
    u, T = np.ones(50), np.zeros(50)
    with pytest.raises(DataError, match="only 0 of 50"):
        fit_load(u, T, np.full(50, np.nan), what="electric power")
    with pytest.raises(DataError, match="on in 0"):
        fit_load(0 * u, T, np.zeros(50), what="electric power")
    with pytest.raises(DataError, match="its mean while the actuator was on is -800 W: check the meter and its sign"):
        fit_load(u, T, np.full(50, -800.0), what="electric power")


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


def test_real_machine_within_one_percent_with_its_return_water(shared):
    frames = [pd.read_csv(shared / "boptest_hp" / f"{name}.csv.gz") for name in ("excite_jan", "excite_mar")]
    january, march = (
        replace(
            machine_history(
                frame.oveHeaPumY_u.to_numpy(),
                frame.weaSta_reaWeaTDryBul_y.to_numpy(),
                power_W=(frame.reaPHeaPum_y + frame.reaPFan_y + frame.reaPPumEmi_y).to_numpy(),
            ),
            T_return_C=frame.reaTRet_y.to_numpy(),
        )
        for frame in frames
    )
    model = fit_power([january])
    on = march.u[0] > 0
    missed = (model(march.u[0], march.T_out_C[:-1], march.T_return_C[0]) - march.power_W[0])[on]
    blind = (model.load(march.u[0], march.T_out_C[:-1]) - march.power_W[0])[on]
    assert np.sqrt(np.mean(missed**2)) < 0.01 * march.power_W[0, on].mean()
    assert np.sqrt(np.mean(missed**2)) < 0.5 * np.sqrt(np.mean(blind**2))


def test_a_machine_that_heats_one_zone_and_cools_another_has_a_law_for_each():
    rng = np.random.default_rng(6)
    heating, cooling, T = rng.uniform(0, 1, 200), rng.uniform(0, 2, 200), rng.uniform(-5, 20, 200)
    power = heating * 9000.0 + cooling * (3000.0 + 40.0 * T)
    power[3] = np.nan
    model = fit_both_directions([machine_history(heating, T, power_W=power)], heating, cooling)
    at = np.array([0.5, -1.5])
    np.testing.assert_allclose(model(at, 10.0), [4500.0, 1.5 * 3400.0], rtol=0.02)
    assert "taken" not in model.source


def test_a_direction_that_was_never_used_costs_what_the_other_does_and_the_source_says_so():
    rng = np.random.default_rng(7)
    heating, T = rng.uniform(0, 1, 100), rng.uniform(-5, 5, 100)
    history = machine_history(heating, T, power_W=9000.0 * heating)
    model = fit_both_directions([history], heating, np.zeros(100))
    np.testing.assert_allclose(model(np.array([1.0, -1.0]), 0.0), [9000.0, 9000.0], rtol=0.01)
    assert "of heating; the other direction was hardly used" in model.source
    with pytest.raises(DataError, match="power of heating: the actuator was on in 0"):
        fit_both_directions([history], np.zeros(100), np.zeros(100))
