"""What is left without effects is distributed as the filter of the free part says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, record

from thermoforce_mpc.data import Boundary, Names
from thermoforce_mpc.identification import Pair
from thermoforce_mpc.identification.estimation.regression import pair_regression, run_regression, without_others
from thermoforce_mpc.identification.estimation.rest import fitted_to_pairs, rest_of
from thermoforce_mpc.model.free_response.rc import INPUTS, RcFreeResponse, RcParameters
from thermoforce_mpc.model.operator.heat_input import IDENTITY

WEIGHTS = np.zeros((3, len(INPUTS)))
WEIGHTS[:, :3] = [[0.02, 1e-4, 0.3], [0.001, 1e-5, 0.02], [0.0, 0.0, 0.0]]
# Modes that are disturbed together, as those of a network are.
LOADING = np.array([[0.05, 0.0], [-0.01, 0.02], [0.03, 0.01]])
FREE = RcParameters(
    np.array([0.9, 0.995, 0.97]), WEIGHTS, 900.0, LOADING @ LOADING.T, np.diag([9.0, 100.0, 1.0]), sensor_sd_K=0.05
)


@pytest.fixture(scope="module")
def run():
    whole = record(House(), 1.5, seed=1, noise_K=0.01)
    gaps = np.isin(np.arange(whole.n_steps + 1), [5, 6, 7, *range(70, 98)])
    return replace(whole, T_zone_C=np.where(gaps, np.nan, whole.T_zone_C))


@pytest.mark.parametrize("start", [100, 130])
def test_a_reading_given_those_before_is_what_the_filter_forecasts(run, start):
    rest, regression = rest_of(run_regression(run, IDENTITY), FREE), run_regression(run, IDENTITY)
    before = int(np.searchsorted(regression.rows, start, side="right"))
    left = regression.target - rest.mean
    C = rest.covariance
    ahead = np.linalg.solve(C[:before, :before], left[:before]) @ C[:before, before:] + rest.mean[before:]
    history = run.slice(0, start)
    forecast = RcFreeResponse(FREE).forecast(
        history.T_zone_C[0], history, Boundary.measured(run.slice(start, run.n_steps))
    )
    np.testing.assert_allclose(ahead, forecast.median_C[regression.rows[before:] - start - 1], atol=1e-6)


def test_a_pair_needs_no_free_part():
    a = record(House(), 0.5, seed=3)
    pair = pair_regression(Pair(a, record(House(), 0.5, seed=3, u=np.zeros(a.n_steps))), IDENTITY)
    rest = rest_of(pair, FREE)
    assert not rest.mean.any()
    np.testing.assert_array_equal(rest.covariance, rest.covariance[0, 0] * np.eye(pair.rows.size))


def test_one_mode_is_that_of_the_pairs():
    """The mode that suits ten days of a network is ten times slower than that of a day's differences."""
    a = record(House(), 1.0, seed=3)
    pair = pair_regression(Pair(a, record(House(), 1.0, seed=3, u=np.zeros(a.n_steps))), IDENTITY)
    pair = replace(pair, target=pair.effect(np.log([2.2]), np.array([5.0]), 1))
    log_tau, gains = fitted_to_pairs([pair], np.log([25.0]), np.array([2.0]), 1)
    assert np.exp(log_tau[0]) == pytest.approx(2.2, rel=0.05)
    assert gains[0] == pytest.approx(5.0, rel=0.05)


def test_what_others_did_is_taken_off(run):
    """Of a pair, the difference of what they did in both runs; heat cools where the other one's sign is negative."""
    level = np.zeros((1, run.n_steps))
    level[0, 10:] = 1.0
    log_tau, gains = np.log([0.5, 3.0, 50.0]), np.array([[0.3, 1.0, 8.0]])
    names, heat_W = Names(("zone",), ("heater", "chiller"), ("machine",)), np.full((2, run.n_steps), np.nan)
    with_other = replace(run, u=np.concatenate([run.u, level]), heat_W=heat_W, names=names)
    regression = run_regression(with_other, IDENTITY)
    alone = without_others(regression, [IDENTITY], [-1], log_tau, gains)
    did = regression.target - alone.target
    assert not did[regression.rows <= 10].any()
    assert (np.diff(did[regression.rows >= 10]) < 0.0).all()
    expected = replace(regression, drives=((1, level[0]),)).effect(log_tau, gains[0], -1)
    np.testing.assert_allclose(did, expected, atol=1e-12)
    both = pair_regression(Pair(with_other, with_other), IDENTITY)
    np.testing.assert_allclose(without_others(both, [IDENTITY], [-1], log_tau, gains).target, both.target, atol=1e-12)
