"""The fast forms of the identification's linear algebra, against their definitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, record
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.identification import IdentificationConfig, Pair
from thermoforce_mpc.identification.estimation.columns import forced_columns, free_columns, other_columns
from thermoforce_mpc.identification.estimation.disturbance import Disturbance
from thermoforce_mpc.identification.estimation.likelihood import residuals
from thermoforce_mpc.identification.estimation.modes import wide_priors
from thermoforce_mpc.identification.estimation.optimisers import BoundedLeastSquares, FreeFirst
from thermoforce_mpc.identification.estimation.regression import pair_regression, run_regression, scaled
from thermoforce_mpc.identification.estimation.system import System
from thermoforce_mpc.model.operator.heat_input import IDENTITY

CONFIG = IdentificationConfig()
LOG_TAU = np.log([0.6, 3.5, 50.0])
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def regression():
    run = record(House(), 1.2, seed=1, noise_K=0.01)
    gaps = np.isin(np.arange(run.n_steps + 1), [5, 6, 7, 40, *range(60, 90)])
    return run_regression(replace(run, T_zone_C=np.where(gaps, np.nan, run.T_zone_C)), IDENTITY, CONFIG)


@pytest.fixture(scope="module")
def pair():
    a = record(House(), 0.5, seed=3)
    b = record(House(), 0.5, seed=3, u=np.zeros(a.n_steps))
    return pair_regression(Pair(a, b), IDENTITY)


def test_a_disturbance_is_whitened_by_its_covariance(regression):
    disturbance = regression.disturbance
    at = disturbance.time_s / HOUR_S
    lag = np.abs(at[:, None] - at)
    expected = sum(
        sd**2 * np.exp(-lag / h) for sd, h in zip(CONFIG.disturbance_sd_K, CONFIG.disturbance_hours, strict=True)
    ) + CONFIG.sensor_sd_K**2 * np.eye(at.size)
    np.testing.assert_allclose(disturbance.covariance(), expected, rtol=1e-12)
    L = np.linalg.cholesky(expected)
    np.testing.assert_allclose(disturbance.factor(), L, atol=1e-10)
    np.testing.assert_allclose(disturbance.factor(30), L[30:, 30:], atol=1e-10)
    values = RNG.normal(size=(at.size, 3))
    np.testing.assert_allclose(disturbance.whitened(values), solve_triangular(L, values, lower=True), rtol=1e-7)
    np.testing.assert_allclose(
        disturbance.scaled(0.1).first(20).whitened(values[:20]), 10.0 * disturbance.whitened(values)[:20], rtol=1e-9
    )


def test_independent_rows_are_divided_by_their_deviation():
    values = RNG.normal(size=5)
    np.testing.assert_allclose(Disturbance.independent(np.arange(5.0), 0.3).whitened(values), values / 0.3)


@pytest.mark.parametrize("scale", [0.03, 1.0])
def test_innovations_of_later_rows_are_the_end_of_those_of_all(regression, scale):
    rest = residuals(regression, LOG_TAU).scaled(scale)
    left = regression.target - rest.mean
    L = np.linalg.cholesky(rest.covariance)
    white = solve_triangular(L, left, lower=True)
    for first in (0, 1, 60):
        found, factor = rest.later(left, first)
        # A covariance with a condition of 10^10 is known to six digits.
        np.testing.assert_allclose(found, white[first:], atol=2e-5)
        np.testing.assert_allclose(factor, L[first:, first:], atol=1e-6)
    np.testing.assert_allclose(rest.whitener(), np.linalg.inv(L), rtol=1e-4, atol=1e-4)
    both = np.stack([left, np.arange(left.size) / left.size], axis=1)
    squares = (solve_triangular(L, both, lower=True) ** 2).sum(axis=0)
    np.testing.assert_allclose(rest.squares(both), squares, rtol=1e-6)


def test_the_likelihoods_of_all_scales_are_those_of_each(regression):
    rest = residuals(regression, LOG_TAU)
    left = regression.target - rest.mean
    for rows in (12, 60):  # fewer rows than columns, and more
        expected = []
        for scale in (0.1, 0.5, 2.0):
            L = np.linalg.cholesky(rest.scaled(scale).covariance[:rows, :rows])
            white = solve_triangular(L, left[:rows], lower=True)
            expected.append(-0.5 * float(white @ white) - float(np.log(np.diag(L)).sum()))
        found = rest.log_likelihoods(left, rows, (0.1, 0.5, 2.0))
        np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-6)


def plain_rows(regression, log_tau, sign):
    """The columns of a run or pair by their definition, the target last."""
    columns = [forced_columns(regression, log_tau, sign), other_columns(regression, log_tau)]
    columns += [] if regression.is_pair else list(free_columns(regression, log_tau))
    values = np.concatenate([*columns, regression.target[:, None]], axis=1)
    return solve_triangular(np.linalg.cholesky(regression.disturbance.covariance()), values, lower=True)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_rows_of_a_system_are_those_of_its_runs_and_pairs(regression, pair, order):
    priors = wide_priors(order)
    run = run_regression(record(House(), 1.0, seed=2, noise_K=0.01), IDENTITY, CONFIG)
    log_tau = priors.log_tau + 0.1
    data = [scaled([e], 0.2)[0] for e in (regression, pair, run)]
    system = System(data, order, -1)
    rows = system.rows(log_tau, priors)
    assert rows.shape == (system.n_data + system.variables.order.size, 1 + system.variables.order.size)
    begin, starts = 0, rows.shape[1] - 1
    for e in data:
        expected, found = plain_rows(e, log_tau, -1), rows[begin : begin + e.rows.size]
        used = np.flatnonzero(np.abs(found).max(axis=0))
        assert used[-1] == starts
        np.testing.assert_allclose(found[:, used], expected, rtol=1e-6, atol=1e-6)
        begin += e.rows.size
    mean, sd = priors.gains_at(log_tau)
    np.testing.assert_allclose(rows[begin:, :-1].sum(axis=0)[:order], 1.0 / sd)
    np.testing.assert_allclose(rows[begin:, -1][:order], mean / sd)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_slopes_are_derivatives_of_the_rows(regression, pair, order):
    priors = wide_priors(order)
    system = System([with_other(regression), with_other(pair)], order, -1)
    log_tau, step = priors.log_tau - 0.1, 1e-5
    values = np.append(RNG.normal(size=system.variables.order.size), -1.0)
    expected = [
        (system.rows(log_tau + d, priors) - system.rows(log_tau - d, priors)) @ values / (2.0 * step)
        for d in step * np.eye(order)
    ]
    found = system.slopes(log_tau, priors, values[:-1])
    np.testing.assert_allclose(found, np.stack(expected, axis=1), atol=1e-6)


def with_other(regression):
    """Beside an actuator that cools it."""
    others = -RNG.random((1, regression.n_steps))
    return replace(regression, others=others)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_search_ends_at_the_best_time_constants(regression, pair, order):
    priors = wide_priors(order)
    run = run_regression(record(House(), 1.0, seed=2, noise_K=0.01), IDENTITY, CONFIG)
    low, high = np.log(priors.bounds_h()).T
    for data in ([regression], [regression, run, pair], [with_other(pair)], [with_other(run)]):
        system = System(data, order, 1)
        found = system.likeliest(priors, priors.log_tau)

        def solved(log_tau, system=system):
            away = (log_tau - priors.log_tau) / priors.log_tau_sd
            best = BoundedLeastSquares(system.rows(log_tau, priors), system.variables)
            return best.squares + away @ away, best.values

        least, values = solved(found.at)
        assert found.value == pytest.approx(0.5 * least, rel=1e-9)
        gains = (1 + data[0].others.shape[0]) * order
        np.testing.assert_allclose(found.values[:gains], values[:gains], atol=1e-6 * np.abs(values).max())
        rows = system.rows(found.at, priors)
        np.testing.assert_allclose(found.residual, rows[:, :-1] @ values - rows[:, -1], atol=1e-6)
        for step in 1e-3 * np.concatenate([np.eye(order), -np.eye(order)]):
            assert solved(np.clip(found.at + step, low, high))[0] >= least * (1.0 - 1e-12)


def test_bounded_least_squares_agree_with_scipys():
    for _ in range(20):
        system = RNG.normal(size=(30, 9))
        positive = RNG.random(8) < 0.6
        positive[0] = True
        low = np.where(positive, 0.0, -np.inf)
        expected = lsq_linear(system[:, :-1], system[:, -1], bounds=(low, np.inf), method="bvls", tol=1e-14)
        found = BoundedLeastSquares(system, FreeFirst(positive))
        np.testing.assert_allclose(found.values, expected.x, atol=1e-7)
        assert found.squares == pytest.approx(2.0 * expected.cost, rel=1e-9)
        normal = system[:, :-1].T @ system[:, :-1]
        assert found.log_determinant == pytest.approx(np.linalg.slogdet(normal)[1], abs=1e-9)
