"""Paired windows of a zone whose answer to its control is known exactly: two modes, a daily course, no noise."""

import numpy as np
from scipy.signal import lfilter

from benchmarks.interventions.dataset import ClimateData, Probe, Window
from benchmarks.interventions.protocol import SHIFTS_K, WINDOW_START_H
from thermoforce_mpc.data import DAY_S, Record
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.plants.energyplus.zone import CLIMATES

STEP_S = 900.0
TIME_CONSTANTS_H, GAINS_K = (1.2, 20.0), (8.0, 12.0)
N = 24


def forced(u):
    """Response at the end of each step to u (..., n), K."""
    poles = np.exp(-0.25 / np.array(TIME_CONSTANTS_H))
    return sum(g * lfilter([1 - a], [1, -a], u, axis=-1) for g, a in zip(GAINS_K, poles, strict=True))


def run(first_day, u):
    """A record that begins at midnight of `first_day` in the steady state of u = 0."""
    n = u.size
    time_s = first_day * DAY_S + STEP_S * np.arange(n + 1)
    hour = (time_s % DAY_S) / 3600.0
    free = 15.0 + 2.0 * np.sin(2 * np.pi * (hour - 9.0) / 24.0)
    T = free + np.concatenate([[0.0], forced(u)])
    solar = np.maximum(300.0 * np.sin(2 * np.pi * (hour - 6.0) / 24.0), 0.0)
    return Record(time_s, T, free - 12.0, solar, u, np.full(n, np.nan), np.full(n, np.nan))


def window(day, name, shift_K, part="test", seed=0):
    """One pair: ten days before it, then a shift of the control in its sign for four hours."""
    rng = np.random.default_rng([seed, day])
    u = np.clip(0.4 + 0.2 * np.repeat(rng.standard_normal(11 * 24), 4), 0.1, 0.9)
    start = 10 * 96 + round(WINDOW_START_H[name] * 4)
    moved = u.copy()
    moved[start : start + 16] = np.clip(moved[start : start + 16] + 0.12 * shift_K, 0.0, 1.0)
    a, b = run(day - 10, u), run(day - 10, moved)
    return Window(
        "heating_chicago",
        name,
        part,
        day,
        shift_K,
        a.slice(0, start),
        a.slice(start, start + N),
        b.slice(start, start + N),
    )


def data(test_days=2, validation_days=2):
    """A climate's data with a probe of three days."""
    windows = [
        window(day, name, SHIFTS_K[(day + i) % 6], part)
        for part, first, days in (("validation", 30, validation_days), ("test", 40, test_days))
        for day in range(first, first + days)
        for i, name in enumerate(WINDOW_START_H)
    ]
    rng = np.random.default_rng(5)
    u = np.clip(0.4 + 0.2 * np.repeat(rng.standard_normal(13 * 24), 4), 0.05, 0.95)
    probed = u.copy()
    probed[960:] = np.clip(u[960:] + np.repeat(rng.choice([-0.3, 0.0, 0.3], 36), 8), 0.0, 1.0)
    plain, moved = run(15, u), run(15, probed)
    end = u.size
    probe = Probe(plain.slice(0, 960), Pair(moved.slice(960, end), plain.slice(960, end)))
    return ClimateData(CLIMATES["heating_chicago"], tuple(windows), {3: probe})
