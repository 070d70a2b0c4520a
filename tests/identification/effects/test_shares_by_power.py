"""Shares of actuators on one machine of which nothing is known but its power."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermoforce_mpc.data import Layout, Names, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.couplings import sizes_by_power, with_shares_by_power
from thermoforce_mpc.identification.effects.meters import power_of_machine

NAMES = Names(("living", "bedroom", "bath"), ("a", "b", "c"), ("heat_pump",))
LAYOUT = Layout(NAMES, (1, 1, 1), (0, 1, 2), (0, 0, 0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (45.0, 25.0, 12.0))


def record_of(u, power_W):
    n = u.shape[1]
    nothing = np.full((1, n), np.nan)
    return Record(
        900.0 * np.arange(n + 1), np.full((3, n + 1), 20.0), np.zeros(n + 1), np.zeros(n + 1), u, power_W[None],
        np.full((3, n), np.nan), nothing, names=LAYOUT.names,
    )  # fmt: skip


def test_valves_on_one_machine_share_it_by_what_its_power_says_of_each():
    rng = np.random.default_rng(1)
    u = np.repeat(rng.random((3, 14 * 8)), 12, axis=1)  # two weeks, held for three hours
    taken_W = 40.0 + np.array([900.0, 300.0, 300.0]) @ u + 50.0 * rng.standard_normal(u.shape[1])
    shares = with_shares_by_power(LAYOUT, [record_of(u, taken_W)]).shares
    np.testing.assert_allclose(shares, (0.6, 0.2, 0.2), atol=0.04)
    together = np.tile(u[:1], (3, 1))
    shares = with_shares_by_power(LAYOUT, [record_of(together, 1500.0 * together[0])]).shares
    np.testing.assert_allclose(shares, np.full(3, 1 / 3), atol=0.01)
    not_metered = record_of(u, np.full(u.shape[1], np.nan))
    np.testing.assert_allclose(with_shares_by_power(LAYOUT, [not_metered]).shares, np.full(3, 1 / 3))
    given = replace(LAYOUT, shares=(0.5, 0.3, 0.2))
    assert with_shares_by_power(given, [record_of(u, taken_W)]).shares == given.shares


def test_a_meter_says_as_much_of_valves_as_its_errors_leave_it():
    """Errors of a step are averaged out; those of an hour tell no more in four steps than in one."""
    rng = np.random.default_rng(4)
    u, taken_W = np.repeat(rng.random((3, 24)), 3, axis=1), np.array([900.0, 150.0, 450.0])
    quarters = np.repeat(u, 4, axis=1)
    by_steps, by_hours = rng.normal(0.0, 150.0, quarters.shape[1]), rng.normal(0.0, 800.0, u.shape[1])

    def shares(u, error_W, step_s=900.0):
        record = record_of(u, 1000.0 + taken_W @ u + error_W)
        return np.array(with_shares_by_power(LAYOUT, [replace(record, time_s=record.time_s * step_s / 900.0)]).shares)

    np.testing.assert_allclose(shares(quarters, by_steps), (0.6, 0.1, 0.3), atol=0.04)
    by_the_hour = shares(u, by_hours, 3600.0)
    assert np.abs(by_the_hour - (0.6, 0.1, 0.3)).max() > 0.05
    np.testing.assert_allclose(shares(quarters, np.repeat(by_hours, 4)), by_the_hour, atol=0.03)


def test_rooms_are_as_large_as_what_their_emitters_take():
    """Emitters of one room count together; rooms are alike without a meter, or where a machine feeds one alone."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.random((3, 14 * 8)), 12, axis=1)
    record = record_of(u, 40.0 + np.array([900.0, 300.0, 300.0]) @ u)
    np.testing.assert_allclose(sizes_by_power(LAYOUT, [record]), (1.8, 0.6, 0.6), atol=0.1)
    of_two = replace(LAYOUT, home=(0, 1, 1))
    np.testing.assert_allclose(sizes_by_power(of_two, [record]), (1.2, 0.8, 1.0), atol=0.1)
    not_metered = record_of(u, np.full(u.shape[1], np.nan))
    np.testing.assert_allclose(sizes_by_power(LAYOUT, [not_metered]), np.ones(3))
    np.testing.assert_allclose(sizes_by_power(replace(LAYOUT, home=(0, 0, 0)), [record]), np.ones(3))


def test_three_open_valves_take_more_than_one():
    """Where shares are not given, one valve is not the whole machine."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.random((3, 14 * 8)), 12, axis=1)
    record = record_of(u, np.array([500.0, 500.0, 500.0]) @ u)
    layout = with_shares_by_power(LAYOUT, [record])
    power = power_of_machine([record], IdentificationConfig(), layout, 0)
    weights = layout.weights
    one, all_of_them = (
        power.of_actuators(level, weights, np.zeros(1))[0] for level in (np.eye(3)[:, :1], np.ones((3, 1)))
    )
    assert one == pytest.approx(500.0, rel=0.1)
    assert all_of_them == pytest.approx(1500.0, rel=0.05)


def test_the_law_of_a_machine_is_fitted_as_it_is_used():
    """Levels of valves that water holds: a law of levels held for a step was used as one of on-times."""
    rng = np.random.default_rng(3)
    water = np.repeat(rng.uniform(0.2, 0.9, 14 * 8), 12)
    u = np.array([1.0, 0.9, 0.8])[:, None] * water
    layout = replace(LAYOUT, shares=(0.5, 0.3, 0.2))
    load = layout.weights @ u
    record = record_of(u, 800.0 * np.minimum(load / 0.4, 1.0) + 200.0 * load)
    power = power_of_machine([record], IdentificationConfig(), layout, 0)
    said_W = power.of_actuators(record.u, layout.weights, record.T_out_C[:-1])
    error_W = float(np.sqrt(np.mean((said_W - record.power_W[0]) ** 2)))
    assert error_W == pytest.approx(power.rmse_W, rel=0.01)
