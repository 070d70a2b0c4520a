"""Bounded minima, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize, rosen, rosen_der

from thermoforce_mpc.identification.estimation.optimisers import Point, minimised


def found(function, gradient, start, hessian, low, high):
    evaluations = []

    def evaluate(at):
        assert np.all((at >= low - 1e-12) & (at <= high + 1e-12)), "outside the bounds"
        evaluations.append(at)
        return Point(at, function(at), gradient(at))

    end = minimised(evaluate, evaluate(start), hessian, low, high)
    return end.at, len(evaluations)


@pytest.mark.parametrize("seed", range(20))
def test_a_quadratic_with_strong_correlation_ends_at_its_bounded_minimum_at_once(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3)) @ np.diag([1.0, 10.0, 30.0])
    H, centre = root.T @ root + 0.1 * np.eye(3), 3.0 * rng.normal(size=3)
    low, high = -np.ones(3), np.ones(3)
    at, evaluations = found(
        lambda x: 0.5 * (x - centre) @ H @ (x - centre), lambda x: H @ (x - centre), np.zeros(3), H, low, high
    )
    gradient = H @ (at - centre)
    inside = (at > low + 1e-9) & (at < high - 1e-9)
    assert np.abs(gradient[inside]).max(initial=0.0) <= 1e-5 * np.abs(H).max()
    assert np.all(gradient[at >= high - 1e-9] <= 0.0)
    assert np.all(gradient[at <= low + 1e-9] >= 0.0)
    assert evaluations <= 4


@pytest.mark.parametrize("high", [2.0, 0.6])
def test_a_curved_valley_is_followed_to_its_end(high):
    low, most = np.full(2, -2.0), np.full(2, high)
    at, evaluations = found(rosen, rosen_der, np.array([-1.2, 0.5]), np.diag([500.0, 200.0]), low, most)
    expected = minimize(
        rosen, [-1.2, 0.5], jac=rosen_der, bounds=[(-2.0, high)] * 2, options={"ftol": 1e-15, "gtol": 1e-9}
    )
    np.testing.assert_allclose(at, expected.x, atol=1e-5)
    assert evaluations < 100
