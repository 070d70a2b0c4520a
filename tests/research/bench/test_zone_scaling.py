"""The script of solve times over the number of zones solves what it times, and fits its exponent."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.research.bench.zone_scaling import building_operator, building_problem, exponent, solve_times


def test_the_exponent_is_the_slope_of_log_time():
    assert exponent({1: 2.0, 2: 4.0, 8: 16.0}) == pytest.approx(1.0)
    assert exponent({1: 1.0, 10: 100.0}) == pytest.approx(2.0)


def test_buildings_are_solved_at_every_size():
    seconds = solve_times((1, 2), neighbours=1, instances=1)
    assert set(seconds) == {1, 2}
    assert all(0.0 < value < 10.0 for value in seconds.values())


def test_neighbours_are_reached_and_no_one_else():
    rng = np.random.default_rng(0)
    operator = building_operator(5, 1, rng)
    assert [pair is not None for pair in operator.pairs[0]] == [True, True, False, False, True]
    problem = building_problem(operator, rng)
    assert (problem.T_free_C.shape, problem.price_per_kWh.shape) == ((5, 192), (1, 192))
