"""The fast forms of the identification's linear algebra, against their definitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, record
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.identification import Pair
from thermoforce_mpc.identification.estimation.columns import forced_columns, free_columns, other_columns
from thermoforce_mpc.identification.estimation.disturbance import ASSUMED_H, ASSUMED_SD_K, SENSOR_SD_K, Disturbance
from thermoforce_mpc.identification.estimation.joint import fit_joint
from thermoforce_mpc.identification.estimation.likelihood import residuals
from thermoforce_mpc.identification.estimation.modes import centred_priors
from thermoforce_mpc.identification.estimation.regression import pair_regression, run_regression, scaled
from thermoforce_mpc.identification.estimation.rows import Rows
from thermoforce_mpc.model.operator.heat_input import IDENTITY

LOG_TAU = np.log([0.6, 3.5, 50.0])
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def regression():
    run = record(House(), 1.2, seed=1, noise_K=0.01)
    gaps = np.isin(np.arange(run.n_steps + 1), [5, 6, 7, 40, *range(60, 90)])
    return run_regression(replace(run, T_zone_C=np.where(gaps, np.nan, run.T_zone_C)), IDENTITY)


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
        sd**2 * np.exp(-lag / h) for sd, h in zip(ASSUMED_SD_K, ASSUMED_H, strict=True)
    ) + SENSOR_SD_K**2 * np.eye(at.size)
    np.testing.assert_allclose(disturbance.covariance, expected, rtol=1e-12)
    L = np.linalg.cholesky(expected)
    np.testing.assert_allclose(disturbance.factor, L, atol=1e-10)
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
    np.testing.assert_allclose(rest.whitener, np.linalg.inv(L), rtol=1e-4, atol=1e-4)


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
    return solve_triangular(np.linalg.cholesky(regression.disturbance.covariance), values, lower=True)


def priors_of(order):
    return centred_priors(LOG_TAU[:order], np.array([0.5, 1.5, 12.0])[:order], 1.0)


def with_other(regression, order):
    """Beside an actuator that cools it."""
    gains = np.ones((1, 2, order))
    return replace(regression, others=-RNG.random((1, regression.n_steps)), other_gains=gains)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_rows_are_those_of_runs_and_pairs_and_of_their_priors(regression, pair, order):
    priors = priors_of(order)
    run = run_regression(record(House(), 1.0, seed=2, noise_K=0.01), IDENTITY)
    for data in ([regression, pair, run], [with_other(regression, order), with_other(pair, order)], [pair]):
        data = scaled(data, 0.2)
        system = Rows.of(data, priors, -1)
        begin, p = 0, system.columns.shape[1]
        assert system.columns.shape[0] == sum(e.rows.size for e in data) + p
        for e in data:
            expected, rows = plain_rows(e, priors.log_tau, -1), slice(begin, begin + e.rows.size)
            used = np.flatnonzero(np.abs(system.columns[rows]).max(axis=0))
            np.testing.assert_allclose(system.columns[rows][:, used], expected[:, :-1], rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(system.target[rows], expected[:, -1], rtol=1e-6, atol=1e-6)
            begin += e.rows.size
        mean, sd = priors.gains_at(priors.log_tau)
        np.testing.assert_allclose(np.diag(system.columns[begin:])[:order], 1.0 / sd)
        np.testing.assert_allclose(system.target[begin:][:order], mean / sd)
        assert (system.low[: order * (1 + data[0].others.shape[0])] == 0.0).all()


def test_the_fit_is_the_least_sum_of_squares_within_bounds(regression, pair):
    """Moving any parameter within its bounds makes it larger."""
    priors, data = priors_of(3), [regression, pair]
    fit = fit_joint(data, priors, 1, np.zeros((1, 6, 6)))
    system = Rows.of(data, priors, 1)
    expected = lsq_linear(system.columns, system.target, (system.low, np.inf), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(fit.gains, np.maximum(expected[:3], 1e-12), atol=1e-8)
    assert (fit.gains > 0.0).all()
