"""The heat capacity from little: what machines have in common fills in what was not seen, and yields to what was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from machine_history import machine_history

from benchmarks.operator.data import cut, read_run
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig
from thermoforce_mpc.identification.effects.meters import identified_heat_input
from thermoforce_mpc.model.machine.heat_capacity import AIR_CONDITIONER, DIRECT, HEAT_PUMP, OTHER, fit_heat, kinds_for

HEATS = kinds_for(1)


def _levels(seed, levels, n=96):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.choice(levels, n // 4), 4).astype(float)


def _day(low, high, n=96):
    return 0.5 * (low + high) + 0.5 * (high - low) * np.sin(2 * np.pi * np.arange(n) / 96)


def _heat_pump(u, T):
    """Bends: full is an eighth short of what low levels promise."""
    straight = (u > 0) * 0.15 + 0.85 * u
    return 11000.0 * (straight + 0.12 * (u > 0) * (u - 0.2) * (1 - u)) * (1 + 0.027 * (T - 5))


def _fit(u, T, y, kinds=HEATS, **options):
    return fit_heat(u, T, y, kinds=kinds, step_s=900.0, **options)


def test_a_narrow_range_leans_on_the_slope_of_heat_pumps():
    rng = np.random.default_rng(3)
    u, T = _levels(3, (0, 0.2, 0.4, 0.7, 1.0)), _day(4.5, 5.5)
    y = _heat_pump(u, T) * (1 + 0.02 * rng.normal(size=96))
    truth = _heat_pump(np.array(1.0), -7.0)
    # Twelve kelvin away, one standard deviation of the prior is 9 %.
    assert _fit(u, T, y).load(np.array(1.0), np.array(-7.0)) == pytest.approx(truth, rel=0.09)
    blind = replace(HEAT_PUMP, slope=(0.0, 0.5))
    assert abs(_fit(u, T, y, (blind,)).load(np.array(1.0), np.array(-7.0)) / truth - 1) > 0.09


def test_full_heat_is_told_from_low_levels_with_the_bend_of_heat_pumps():
    u, T = _levels(1, (0, 0.2, 0.4, 0.6)), _day(2, 8)
    truth = _heat_pump(np.array(1.0), 5.0)
    fit = _fit(u, T, _heat_pump(u, T))
    straight = _fit(u, T, _heat_pump(u, T), (replace(HEAT_PUMP, sag=(0.0, 1e-3)),))
    assert abs(straight.load(np.array(1.0), np.array(5.0)) / truth - 1) > 0.04
    assert fit.load(np.array(1.0), np.array(5.0)) == pytest.approx(truth, rel=0.02)
    # One level alone says even less, but is not taken for proportional.
    u = _levels(2, (0, 0.4))
    fit = _fit(u, T, _heat_pump(u, T))
    assert fit.load(np.array(1.0), np.array(5.0)) == pytest.approx(truth, rel=0.15)
    assert fit.full_sd > 0.05


def test_what_was_seen_counts_more_than_what_is_known_beforehand():
    u, T = np.tile(_levels(4, (0, 0.25, 0.5, 1.0), 480), 3), np.tile(_day(-5, 12, 480), 3)
    y = ((u > 0) * 4000.0 + u * 5000.0) * (1 + 0.01 * (T - 5))
    fit = _fit(u, T, y, (HEAT_PUMP,))
    for level in (0.25, 0.5, 1.0):
        assert fit.load(np.array(level), np.array(5.0)) == pytest.approx(4000.0 + 5000.0 * level, rel=0.03)
    assert fit.full_sd < 0.02


def test_a_heater_that_ignores_the_weather_is_recognised():
    u, T = _levels(5, (0, 0.2, 0.5, 1.0)), _day(-2, 6)
    fit = _fit(u, T, 4000.0 * u)
    assert fit.kind == DIRECT.name
    np.testing.assert_allclose(fit.load(np.array([0.3, 1.0]), np.array(-15.0)), [1200.0, 4000.0], rtol=0.03)


def test_kinds_are_told_apart_and_a_machine_of_no_kind_is_let_be():
    u = _levels(6, (0, 0.2, 0.5, 1.0))
    assert _fit(u, _day(-2, 8), _heat_pump(u, _day(-2, 8))).kind == HEAT_PUMP.name
    T = _day(24, 38)
    cooled = 5000.0 * u * (1 - 0.009 * (T - 35))
    assert _fit(u, T, cooled, kinds_for(-1)).kind == AIR_CONDITIONER.name
    odd = _fit(u, T, 5000.0 * u * (1 - 0.05 * (T - 31)), kinds_for(-1))
    assert odd.kind == OTHER.name
    assert odd.load(np.array(1.0), np.array(25.0)) == pytest.approx(5000.0 * 1.3, rel=0.05)


def test_levels_made_by_switching_are_proportional():
    rng = np.random.default_rng(1)
    u, T = rng.choice([0, 1 / 3, 2 / 3, 1.0], 300), rng.uniform(-5, 12, 300)
    share = u * 10000.0 * (1 + 0.025 * (T - 5))
    fit = _fit(u, T, share)
    assert fit.load.lowest_level == 1.0
    assert not fit.load.levels_seen
    np.testing.assert_allclose(fit.load(u, T), share, rtol=0.02, atol=1.0)


def test_levels_near_full_are_not_taken_for_switching():
    u, T = _levels(7, (0, 0.8, 1.0)), _day(2, 8)
    fit = _fit(u, T, _heat_pump(u, T))
    assert fit.load.lowest_level == 0.8


def test_unusable_heat_is_refused_with_numbers():
    u, T = np.ones(50), np.zeros(50)
    with pytest.raises(DataError, match="only 0 of 50"):
        _fit(u, T, np.full(50, np.nan))
    with pytest.raises(DataError, match="on in 0"):
        _fit(0 * u, T, np.zeros(50))
    with pytest.raises(DataError, match="its mean while the actuator was on is 0 W: check the meter"):
        _fit(u, T, np.zeros(50))


def _run(u):
    return machine_history(u, _day(2, 8), heat_W=_heat_pump(u, _day(2, 8)))


def test_the_note_says_that_full_was_never_seen():
    u = _levels(1, (0, 0.2, 0.4, 0.6))
    _, notes = identified_heat_input([_run(u)], IdentificationConfig(), 1)
    assert any("heat at full level is extrapolated" in note and "0.6" in note for note in notes)
    _, notes = identified_heat_input([_run(_levels(1, (0, 0.2, 0.4, 1.0)))], IdentificationConfig(), 1)
    assert len(notes) == 1


def test_a_day_of_the_real_machine_tells_full_heat_of_other_months(shared):
    runs = [read_run(shared / "boptest_hp" / f"excite_{month}.csv.gz") for month in ("jan", "mar", "apr")]
    u = np.concatenate([run.u[0] for run in runs])
    T = np.concatenate([run.T_out_C[:-1] for run in runs])
    heat = np.concatenate([run.heat_W[0] for run in runs])
    full = u > 0.98
    errors = []
    for run in runs:
        for day in range(27):
            part = cut(run, day, 1)
            try:
                fit = _fit(part.u[0], part.T_out_C[:-1], part.heat_W[0])
            except DataError:
                continue
            errors.append(np.sqrt(np.mean((fit.load(u[full], T[full]) / heat[full] - 1) ** 2)))
    assert len(errors) >= 75
    assert np.mean(errors) < 0.04
    assert np.max(errors) < 0.15
