"""Each fold of an identification sees its own part of the records only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, make_pair, record

from thermoforce_mpc.data import DAY_S, Layout
from thermoforce_mpc.identification import IdentificationConfig, Pair
from thermoforce_mpc.identification.effects.meters import identified_heat_input
from thermoforce_mpc.identification.zones.data import ZoneData
from thermoforce_mpc.identification.zones.network_estimate import network_estimates
from thermoforce_mpc.model.operator.heat_input import IDENTITY

LAYOUT, CONFIG = (
    Layout.single(floor_area_m2=190.0),
    IdentificationConfig(modulation="linear", sun_on_sensor=False, late_sensor=False),
)


def folds_of(run, pairs=(), config=CONFIG):
    """What the network says of a house from a run and pairs, fold by fold."""
    data = ZoneData(config, [run], pairs, IDENTITY, 1)
    (estimate,) = network_estimates([run], pairs, LAYOUT, [data], config)
    return data, estimate


def changed_from(run, step):
    """The run, 3 K warmer and at full level from a step on."""
    T_zone_C, u = np.array(run.T_zone_C), np.array(run.u)
    T_zone_C[:, step + 1 :] += 3.0
    u[:, step:] = 1.0
    return replace(run, T_zone_C=T_zone_C, u=u)


def later(pair, days):
    """The pair, some days later."""
    runs = [replace(run, time_s=run.time_s + days * DAY_S) for run in (pair.a, pair.b)]
    return Pair(*runs, label=pair.label)


def same(a, b):
    """Whether two folds say the same, bit for bit."""
    modes = [(getattr(a, name), getattr(b, name)) for name in ("log_tau", "gains")]
    free = [(getattr(a.free, name), getattr(b.free, name)) for name in ("poles", "weights", "process_K2")]
    return all(np.array_equal(*pair) for pair in modes + free)


@pytest.mark.slow
def test_held_out_rows_are_not_seen():
    run = record(House(), 3.0, 3600.0, noise_K=0.01)
    data, before = folds_of(run)
    seen = {fold: data.last_steps(fold)[0] for fold in ("whole", "training", "earlier")}
    assert seen["whole"] == run.n_steps
    assert seen["training"] == pytest.approx(0.75 * run.n_steps, abs=1)
    assert seen["earlier"] == pytest.approx(0.5 * run.n_steps, abs=1)
    _, late = folds_of(changed_from(run, seen["training"]))
    assert same(late.last, before.last)
    assert same(late.before, before.before)
    assert not same(late.everything, before.everything)
    _, middle = folds_of(changed_from(run, seen["earlier"]))
    assert same(middle.before, before.before)
    assert not same(middle.last, before.last)


def test_held_out_pairs_are_not_seen():
    pairs = [later(make_pair(House(), seed, 1.0), seed) for seed in range(4)]
    data = ZoneData(CONFIG, [], pairs, IDENTITY, 1)
    assert data.last_steps("whole") == [24] * 4
    assert sorted(data.last_steps("training")) == [0, 24, 24, 24]
    assert data.last_steps("earlier") == [0] * 4


@pytest.mark.slow
def test_the_last_part_of_the_only_pair_is_not_seen():
    pair = make_pair(House(), 0, 2.0)
    data = ZoneData(CONFIG, [], [pair], IDENTITY, 1)
    (n,) = data.last_steps("training")
    assert 0 < n < pair.a.n_steps
    changed = replace(pair, a=changed_from(pair.a, n))
    estimates = []
    for one in (pair, changed):
        data = ZoneData(CONFIG, [], [one], IDENTITY, 1)
        estimates += network_estimates([], [one], LAYOUT, [data], CONFIG)
    before, late = estimates
    np.testing.assert_array_equal(late.last.gains, before.last.gains)
    assert not np.array_equal(late.everything.gains, before.everything.gains)


def test_the_law_of_a_heat_meter_is_that_of_the_rows_that_are_seen():
    """A meter that reads twice as much from the held-out rows on changes no fold but the whole."""
    run = record(House(), 4.0, noise_K=0.01)
    data = {}
    for factor in (1.0, 2.0):
        heat_W = np.array(run.heat_W)
        heat_W[:, round(0.76 * run.n_steps) :] *= factor
        one = replace(run, heat_W=heat_W)
        whole = identified_heat_input([one], CONFIG, 1)[0]
        data[factor] = ZoneData(CONFIG, [one], [], whole, 1)
    for fold in ("training", "earlier"):
        assert data[1.0].heat_input_of(fold) == data[2.0].heat_input_of(fold)
        assert data[1.0].heat_input_of(fold).law is not None
    assert data[1.0].heat_input_of("whole").law != data[2.0].heat_input_of("whole").law
    few = replace(run, heat_W=np.where(np.arange(run.n_steps) > 0.6 * run.n_steps, run.heat_W, np.nan))
    little = ZoneData(CONFIG, [few], [], data[1.0].heat_input, 1)
    assert little.heat_input_of("earlier") == IDENTITY
