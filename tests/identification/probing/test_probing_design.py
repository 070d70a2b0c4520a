"""Probing keeps comfort, repeats itself, and learns more than chance does; pairs of it are true pairs."""

from __future__ import annotations

import numpy as np
import pytest
from simple_house import SimpleHouse

from benchmarks.probing.pair_probing import probe_pair
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, Record
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.probing.design import information
from thermoforce_mpc.identification.probing.excitation import Excitation
from thermoforce_mpc.identification.probing.probe import ProbingConfig
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.scenario.settings import validate


@pytest.fixture(scope="module")
def plant():
    return EmbeddedPlant(synthetic_weather())


def _probed(plant, design: str, day: int, seed: int = 1, days: float = 1.0) -> Record:
    config = ProbingConfig(design=design, levels=(0.0, 0.5, 1.0), warmup_days=2.0)
    return probe(plant, day * DAY_S, days, seed=seed, config=config)


@pytest.mark.slow
def test_chosen_draws_tell_more_than_the_first_that_come(plant):
    worth = {
        design: [information(_probed(plant, design, day)) for day in (20, 45, 70, 310)]
        for design in ("random", "informative")
    }
    assert np.mean(worth["informative"]) > 1.05 * np.mean(worth["random"]), worth


def test_probing_repeats_itself_and_seeds_differ(plant):
    first, again, other = (_probed(plant, "informative", 30, seed, days=0.6) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.u[0], again.u[0])
    assert np.abs(first.u[0] - other.u[0]).max() > 0.1


def test_comfort_comes_before_information(plant):
    record = _probed(plant, "informative", 20, days=2.0)
    assert record.T_zone_C[0, 24:].min() > 18.5
    assert record.T_zone_C[0].max() < 26.0
    excitation = Excitation((0.0, 1.0), (1,), np.random.default_rng(0))
    assert [excitation.next(2.0) for _ in range(5)] == [1.0] * 5, "too cold: always on"
    assert [excitation.next(-2.0) for _ in range(5)] == [0.0] * 5, "too warm: always off"


def test_more_is_known_of_what_was_excited():
    rng = np.random.default_rng(0)
    n = 96
    time_s, flat = np.arange(n + 1) * 900.0, np.zeros(n + 1)

    def worth(u) -> float:
        return information(Record(time_s, flat, flat, flat, u, u, u))

    switched = np.repeat(rng.choice([0.0, 1.0], 12), 8)
    assert worth(np.zeros(n)) == pytest.approx(0.0, abs=1e-9)
    assert worth(switched) > worth(0.2 * switched) > worth(np.zeros(n))
    assert worth(switched) > 1.2 * worth(np.full(n, 0.5)), "constant action is nearly indistinguishable from drift"


def test_a_house_of_another_kind_can_be_probed():
    record = probe(SimpleHouse(), 20 * DAY_S, 1.0, seed=1, config=ProbingConfig(warmup_days=1.0))
    assert record.n_steps == 96
    assert (np.abs(np.diff(record.u[0])) > 0).sum() >= 6


@pytest.mark.slow
def test_pairs_share_start_and_weather_and_identify(plant):
    config = ProbingConfig(warmup_days=2.0, levels=(0.0, 0.5, 1.0))
    pairs = [probe_pair(plant, day * DAY_S, 1.25, seeds=(day, day + 500), config=config) for day in (20, 50, 80)]
    for pair in pairs:
        np.testing.assert_array_equal(pair.a.T_out_C, pair.b.T_out_C)
        assert pair.a.T_zone_C[0, 0] == pair.b.T_zone_C[0, 0]
        assert np.abs(pair.a.u[0] - pair.b.u[0]).max() > 0.4
        assert np.abs(pair.a.T_zone_C[0] - pair.b.T_zone_C[0]).max() > 0.3
    model = identify(pairs=pairs, config=IdentificationConfig(modulation="linear"), floor_area_m2=192.0)
    assert model.only.operator.steady_gains_K.sum() > 5.0
    with pytest.raises(DataError, match="both runs have seed 3"):
        probe_pair(plant, 20 * DAY_S, 1.0, seeds=(3, 3))


def test_options_are_checked():
    with pytest.raises(ConfigError, match="informative"):
        validate(ProbingConfig, {"design": "informtive"}, "probing")
