"""Parts of a history and coarser steps of it: samples at the ends, means over the steps, nothing shifted."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.data import ACTING, SAMPLED, Boundary, Record
from thermoforce_mpc.errors import DataError


def history(n: int) -> Record:
    at, over = np.arange(n + 1.0), np.arange(float(n))
    return Record(900.0 * at, 20 + at, at, 10 * at, over / n, 100 * over, 1000 * over, 30 + over)


def test_a_part_has_the_samples_at_both_its_ends():
    part = history(10).slice(3, 6)
    np.testing.assert_array_equal(part.time_s, 900.0 * np.arange(3, 7))
    np.testing.assert_array_equal(part.power_W, [[300, 400, 500]])
    np.testing.assert_array_equal(part.T_return_C, [[33, 34, 35]])
    tail = history(10).last(2)
    for name in (*SAMPLED, *ACTING):
        np.testing.assert_array_equal(getattr(tail, name), getattr(history(10).slice(8, 10), name))


def test_its_weather_is_a_forecast_of_which_nothing_else_is_known():
    ahead = Boundary.measured(history(10).slice(3, 6))
    assert (ahead.n_steps, ahead.step_s) == (3, 900.0)
    np.testing.assert_array_equal(ahead.T_out_C, [3, 4, 5, 6])
    np.testing.assert_array_equal(ahead.solar_W_m2, [30, 40, 50, 60])
    assert np.isnan(
        [ahead.occupancy, ahead.lower_C, ahead.upper_C, ahead.price_per_kWh, ahead.emission_kg_per_kWh]
    ).all()


def test_coarser_steps_sample_at_their_ends_average_between_and_cut_the_rest():
    coarse = history(10).resample(4)
    assert coarse.step_s == 3600.0
    np.testing.assert_array_equal(coarse.T_zone_C, [[20, 24, 28]])
    np.testing.assert_array_equal(coarse.power_W, [[150, 550]])
    np.testing.assert_array_equal(coarse.T_return_C, [[31.5, 35.5]])


def boundary(time_s: np.ndarray) -> Boundary:
    return Boundary(time_s, *(np.zeros(time_s.size) for _ in range(7)))


def past(time_s: np.ndarray) -> Record:
    at, over = np.zeros(time_s.size), np.zeros(time_s.size - 1)
    return Record(time_s, at, at, at, over, over, over)


BOTH = pytest.mark.parametrize("made_of", [past, boundary])


@BOTH
@pytest.mark.parametrize(
    ("time_s", "found"),
    [
        ([0, 900, 1800, 3600, 4500], r"from 1800 s \(index 2\) to 3600 s: a step of 1800 s among steps of 900 s"),
        ([0, 900, 900, 1800], r"from 900 s \(index 1\) to 900 s: a step of 0 s among steps of 900 s"),
        ([0, 0, 0], r"from 0 s \(index 0\) to 0 s: a step of 0 s"),
        ([1800, 900, 0], r"from 1800 s \(index 0\) to 900 s: a step of -900 s"),
        ([0, 900, np.nan, 2700], r"from 900 s \(index 1\) to nan s: a step of nan s among steps of 900 s"),
        ([0, 900, 1800, 2699], r"from 1800 s \(index 2\) to 2699 s: a step of 899 s among steps of 900 s"),
    ],
    ids=["gap", "twice", "standing still", "backwards", "no number", "a second short"],
)
def test_instants_that_are_not_equally_spaced_are_refused_with_their_place(made_of, time_s, found):
    with pytest.raises(DataError, match=f"time_s goes {found}"):
        made_of(np.array(time_s, dtype=float))


@BOTH
def test_rounding_of_the_clock_is_no_irregular_step(made_of):
    summed = 31e6 + np.cumsum(np.full(1000, 0.1 * 9000))  # a clock that adds up
    rounded = np.round(31e6 + 86400 / 97 * np.arange(98), 3)  # and one that counts milliseconds
    for time_s in (summed, rounded, np.array([5.0])):
        assert made_of(time_s).n_steps == time_s.size - 1


def test_a_boundary_needs_an_instant():
    with pytest.raises(DataError, match="a boundary needs at least one instant"):
        boundary(np.empty(0))
