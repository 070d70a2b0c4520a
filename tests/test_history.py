"""Parts of a history and coarser steps of it: samples at the ends, means over the steps, nothing shifted."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import ACTING, SAMPLED, Record


def history(n: int) -> Record:
    at, over = np.arange(n + 1.0), np.arange(float(n))
    return Record(900.0 * at, 20 + at, at, 10 * at, over / n, 100 * over, 1000 * over, 30 + over)


def test_a_part_has_the_samples_at_both_its_ends():
    part = history(10).slice(3, 6)
    np.testing.assert_array_equal(part.time_s, 900.0 * np.arange(3, 7))
    np.testing.assert_array_equal(part.power_W, [300, 400, 500])
    np.testing.assert_array_equal(part.T_return_C, [33, 34, 35])
    tail = history(10).last(2)
    for name in (*SAMPLED, *ACTING):
        np.testing.assert_array_equal(getattr(tail, name), getattr(history(10).slice(8, 10), name))


def test_its_weather_is_a_forecast_of_which_nothing_else_is_known():
    ahead = history(10).slice(3, 6).weather()
    assert (ahead.n_steps, ahead.step_s) == (3, 900.0)
    np.testing.assert_array_equal(ahead.T_out_C, [3, 4, 5, 6])
    np.testing.assert_array_equal(ahead.solar_W_m2, [30, 40, 50, 60])
    assert np.isnan(
        [ahead.occupancy, ahead.lower_C, ahead.upper_C, ahead.price_per_kWh, ahead.emission_kg_per_kWh]
    ).all()


def test_coarser_steps_sample_at_their_ends_average_between_and_cut_the_rest():
    coarse = history(10).resample(4)
    assert coarse.step_s == 3600.0
    np.testing.assert_array_equal(coarse.T_zone_C, [20, 24, 28])
    np.testing.assert_array_equal(coarse.power_W, [150, 550])
    np.testing.assert_array_equal(coarse.T_return_C, [31.5, 35.5])
