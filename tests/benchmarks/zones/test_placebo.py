"""Valves with the levels of another house: what is taken from where."""

from __future__ import annotations

import numpy as np
import pytest
from houses import House, record

from benchmarks.zones.placebo import with_foreign_levels
from thermoforce_mpc.errors import DataError


def test_levels_and_heat_come_from_one_other_record_and_the_rest_stays():
    own, other = record(House(), 1.0, seed=1), record(House(), 1.0, seed=2)
    found = with_foreign_levels(own, [other], np.random.default_rng(0))
    by = [k for k in range(own.n_steps) if np.array_equal(found.u[0], np.roll(other.u[0], k))]
    assert any(np.array_equal(found.heat_W[0], np.roll(other.heat_W[0], k)) for k in by)
    assert np.array_equal(found.T_zone_C, own.T_zone_C)
    assert not np.array_equal(found.u, own.u)


def test_records_of_another_length_cannot_lend_theirs():
    own, longer = record(House(), 1.0), record(House(), 2.0)
    with pytest.raises(DataError, match="nothing to take levels from"):
        with_foreign_levels(own, [longer], np.random.default_rng(0))
