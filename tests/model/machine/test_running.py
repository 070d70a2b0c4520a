"""How long a shared machine runs: the integral against its dual, and its limits."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from thermoforce_mpc.model.machine.load import running_share


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 6), st.integers(0, 10_000))
def test_it_is_the_support_function_of_its_polymatroid(n, seed):
    rng = np.random.default_rng(seed)
    on, weights = rng.choice([0.0, 0.3, 1.0, rng.random()], n), rng.uniform(0.05, 1.0, n)
    best = linprog(-on, A_ub=np.ones((1, n)), b_ub=[1.0], bounds=[(0.0, w) for w in weights])
    np.testing.assert_allclose(running_share(on[:, None], weights)[0], -best.fun, atol=1e-9)


def test_its_limits_are_the_longest_and_the_load():
    on = np.random.default_rng(0).random((4, 3, 7))
    np.testing.assert_allclose(running_share(on, np.ones(3)), on.max(axis=-2))
    weights = np.array([0.2, 0.3, 0.4])
    np.testing.assert_allclose(running_share(on, weights), np.einsum("...an,a->...n", on, weights))
