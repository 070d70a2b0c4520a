"""Samples of a plant: kept in arrays that copies share until two of them go on."""

from __future__ import annotations

import copy

import numpy as np

from thermoforce_mpc.plants.shell import Samples


def grown(samples: Samples, *values: float) -> Samples:
    """With samples of these values, a second after another."""
    for value in values:
        samples.append(samples.times[-1:] + 1.0, np.array([[value]]))
    return samples


def test_copies_go_their_own_ways():
    samples = grown(Samples(0.0, np.array([1.0])), 2.0, 3.0)
    then = copy.deepcopy(samples)
    grown(samples, 4.0, 5.0)
    other = grown(copy.deepcopy(then), 6.0)
    again = grown(copy.deepcopy(then), 7.0)
    assert [one.rows[:, 0].tolist() for one in (then, samples, other, again)] == [
        [1.0, 2.0, 3.0],
        [1.0, 2.0, 3.0, 4.0, 5.0],
        [1.0, 2.0, 3.0, 6.0],
        [1.0, 2.0, 3.0, 7.0],
    ]
    assert samples.times.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_copy_that_alone_goes_on_copies_nothing():
    samples = grown(Samples(0.0, np.array([1.0])), 2.0, 3.0)
    went_on = grown(copy.deepcopy(samples), 4.0)
    assert np.shares_memory(went_on.rows, samples.rows)


def test_samples_between_two_times_include_both():
    samples = grown(Samples(0.0, np.array([1.0])), 2.0, 3.0, 4.0)
    times, rows = samples.between(1.0, 2.0)
    assert (times.tolist(), rows[:, 0].tolist()) == ([1.0, 2.0], [2.0, 3.0])
