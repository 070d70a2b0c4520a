"""The filter's likelihood against the normal distribution of all readings, its derivatives against complex steps."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from places import ROOT

from thermoforce_mpc.identification.network.filtering import FilteredRun, likelihood, prediction_errors

READINGS, INPUTS = 14, 3
STATES = 4, 8, 11


def plain(A, B, Q, R, x0, P0, inputs, readings, aired_K2):
    """Half the negative log density of the readings, up to a constant, from their joint mean and covariance."""
    N, n = readings.size, x0.size
    means, covariance = [x0], np.diag(P0)
    states = np.zeros((N, n, N, n), dtype=A.dtype)
    for k in range(N):
        if k:
            means.append(A @ means[-1] + B @ inputs[k - 1])
            covariance = A @ covariance @ A.T + np.diag(Q)
            covariance[0, 0] += aired_K2[k - 1]
        across = covariance
        for later in range(k, N):
            states[later, :, k], states[k, :, later] = across, across.T
            across = A @ across
    known = np.isfinite(readings.real)
    errors = (readings - np.array(means)[:, 0])[known]
    joint = states[:, 0, :, 0][np.ix_(known, known)] + R * np.eye(known.sum())
    return 0.5 * (np.log(np.linalg.det(joint)) + errors @ np.linalg.solve(joint, errors))


def problem(seed):
    """A random system, of more states by each seed, with gaps: at the start, in the middle, at the end."""
    rng, n = np.random.default_rng(seed), STATES[seed]
    A = 0.9 * np.eye(n) + 0.32 / n * rng.random((n, n))
    B, Q, R = rng.normal(size=(n, INPUTS)), 0.1 + rng.random(n), 0.3
    x0, P0 = rng.normal(size=n), rng.random(n)
    inputs, readings = rng.normal(size=(READINGS, INPUTS)), 3.0 * rng.normal(size=READINGS)
    readings[[0, 5, 6, 7, READINGS - 1]] = np.nan
    aired_K2 = np.where(np.arange(READINGS) % 4 == 2, 5.0, 0.0)
    return A, B, Q, R, x0, P0, inputs, readings, aired_K2


@pytest.mark.parametrize("seed", range(3))
def test_the_value_is_that_of_the_joint_distribution(seed):
    parts = problem(seed)
    assert likelihood(FilteredRun(*parts))[0] == pytest.approx(plain(*parts), rel=1e-10)


def test_errors_one_step_ahead_make_up_the_likelihood():
    parts = problem(0)
    errors, variances = prediction_errors(FilteredRun(*parts))
    np.testing.assert_array_equal(np.isnan(errors), np.isnan(parts[-2]))
    of_each = 0.5 * (np.log(variances) + errors**2 / variances)
    assert np.nansum(of_each) == pytest.approx(likelihood(FilteredRun(*parts))[0], rel=1e-12)


@pytest.mark.parametrize("seed", [0, 2])
def test_derivatives_are_those_of_complex_steps(seed):
    parts = problem(seed)
    _, slopes = likelihood(FilteredRun(*parts))
    places = {"A": 0, "B": 1, "Q": 2, "R": 3, "P0": 5}
    for name, place in places.items():
        found = np.atleast_1d(getattr(slopes, name))
        for index in np.ndindex(found.shape):
            shifted = [np.array(part, dtype=complex) for part in parts]
            if name == "R":
                shifted[place] = parts[place] + 1e-30j
            else:
                shifted[place][index] += 1e-30j
            assert found[index] == pytest.approx(plain(*shifted).imag / 1e-30, rel=1e-7, abs=1e-9), (name, index)


def test_a_run_without_readings_says_nothing():
    parts = list(problem(0))
    parts[-2] = np.full(READINGS, np.nan)
    value, slopes = likelihood(FilteredRun(*parts))
    assert value == 0.0
    assert not np.any(slopes.A)
    assert slopes.R == 0.0


@pytest.mark.slow
def test_a_signal_that_comes_while_it_is_computed_is_raised_after():
    """numba makes named tuples by calling their class, where a signal is raised, and crashes over that."""
    program = """
import signal, sys
import numpy as np
from thermoforce_mpc.errors import Terminated, terminated_by
from thermoforce_mpc.identification.network.filtering import FilteredRun, likelihood

signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGTERM))
parts = 0.9 * np.eye(4), np.ones((4, 3)), np.ones(4), 0.3, np.zeros(4), np.ones(4)
run = np.ones((300_000, 3)), np.ones(300_000)
likelihood(FilteredRun(*parts, *run))
with terminated_by("SIGTERM"):
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.001)
        likelihood(FilteredRun(*parts, *run))
    except Terminated as error:
        sys.exit(128 + error.number)
"""
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 143, ended.stderr
