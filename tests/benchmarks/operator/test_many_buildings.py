"""Many buildings at once give what one after another gives."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from houses import House, record

from benchmarks.operator.many_buildings import box_minimisers, fit_two_stage_many
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.zones.two_stage import fit_two_stage


def _runs(n: int):
    rng = np.random.default_rng(0)
    for i in range(n):
        house = House(tau_h=(0.5, rng.uniform(2, 5), rng.uniform(30, 90)), gain_K=(2.0, rng.uniform(10, 30)))
        yield record(house, 3.0 + i % 3, 3600.0, seed=i, noise_K=0.02)


def test_same_as_one_after_another():
    runs = list(_runs(12))
    T = np.array(runs[3].T_zone_C[0])
    T[10:14] = np.nan
    runs[3] = replace(runs[3], T_zone_C=T)
    for together, alone in zip(fit_two_stage_many(runs), (fit_two_stage([run]) for run in runs), strict=True):
        for name, value in asdict(alone).items():
            if isinstance(value, float):
                # The bounded solver of one building stops within its tolerance.
                assert getattr(together, name) == pytest.approx(value, rel=2e-3, abs=2e-6), name
        assert (together.n_off, together.n_on) == (alone.n_off, alone.n_on)
        assert together.rmse_K <= alone.rmse_K * (1 + 1e-4)


def test_box_is_solved_exactly():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(40, 9, 3))
    normal, moment = A.transpose(0, 2, 1) @ A, rng.normal(size=(40, 3)) * 3
    low, high = np.array([-0.2, 0.0, -0.1]), np.array([0.2, np.inf, 0.3])
    x = box_minimisers(normal, moment, low, high)
    assert np.all((x >= low) & (x <= high))
    gradient = (normal @ x[..., None])[..., 0] - moment
    inside = (x > low + 1e-12) & (x < high - 1e-12)
    assert np.abs(gradient[inside]).max() < 1e-9
    assert np.all(gradient[x <= low + 1e-12] >= -1e-9), "at a lower bound the cost rises inwards"
    assert np.all(gradient[(x >= high - 1e-12)] <= 1e-9)
    assert 10 < inside.sum() < inside.size, "some bounds must be active"


def test_the_building_that_fails_is_named():
    runs = list(_runs(3))
    runs[1] = replace(runs[1], u=np.full(runs[1].n_steps, 0.5))
    with pytest.raises(DataError, match=r"building 1 has 0 steps with the actuator off"):
        fit_two_stage_many(runs)
    with pytest.raises(DataError, match="no runs"):
        fit_two_stage_many([])
    with pytest.raises(DataError, match=r"steps of \[900"):
        fit_two_stage_many([runs[0], record(House(), 3.0, 900.0)])
