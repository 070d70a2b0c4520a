"""The network is trained and kept by default; held-out data and held levels decide what it is kept over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, make_pair, random_levels, record

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification import modulation as module
from thermoforce_mpc.identification.modulation import with_network
from thermoforce_mpc.model.forced_state import forced_history, heat_drive
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.parameters import feature_matrix, linear_operator

HOUSE = House()
# Off and full level, as a machine that is switched is probed.
SWITCHED = random_levels(288, 1, levels=(0.0, 1.0))


def found(run, **options):
    return identify(
        [run],
        config=IdentificationConfig(order=3, sun_on_sensor=False, late_sensor=False, **options),
        floor_area_m2=190.0,
    ).only


def counts(model):
    return model.operator.n_trained, model.operator.n_used, model.operator.n_effective


@pytest.mark.slow
def test_three_days_of_probing_give_the_level_and_the_network():
    """17 held-out hours and no clear gain from the network: it is kept all the same."""
    model = found(record(HOUSE, 3.0, u=SWITCHED, noise_K=0.01))
    assert counts(model) == (199, 199, 199)
    assert model.operator.parameters_in_words == "199 trained parameters, 199 used"
    assert (model.operator.heat_input.heat, model.card.scores["modulation_kept"]) == (None, 1.0)
    assert "heat input: the level, v = u" in model.card.notes
    assert certificate(model.operator).certified


@pytest.mark.slow
def test_the_network_is_the_measured_heat_of_full_level_where_temperatures_say_nothing():
    """Also in weather that the record has not seen, and in the meter's units: a control step reads meters by it."""
    run = record(HOUSE, 3.0, u=SWITCHED, noise_K=0.01)
    model = found(run)
    T_out = run.T_out_C.mean() + np.array([-8.0, -4.0, 0.0, 4.0, 8.0])
    features = feature_matrix(np.full(5, 15.0), T_out, np.full(5, 50.0), np.full(5, 6 * HOUR_S))
    full_share = (1 + HOUSE.slope_per_K * T_out) / (1 + HOUSE.slope_per_K * run.T_out_C[:-1].mean())
    np.testing.assert_allclose(model.operator.modulation(features), full_share, rtol=0.05)
    heat_input = model.operator.heat_input
    np.testing.assert_allclose(heat_input.of_meter(0.5 * HOUSE.heat_W(1.0, T_out), T_out), 0.5, rtol=0.01)


@pytest.mark.slow
def test_linear_trains_no_network():
    model = found(record(HOUSE, 3.0, u=SWITCHED), modulation="linear")
    assert counts(model) == (6, 6, 6)
    assert model.operator.heat_input.heat is not None
    assert model.operator.constant_modulation == 1.0


@pytest.mark.slow
def test_runs_do_not_say_the_size_of_the_effect(monkeypatch):
    """Training that takes half of it away keeps its shape: over the record the gain is 1 in the mean."""
    trained = module.train
    monkeypatch.setattr(module, "train", lambda *given: replace(trained(*given), output_bias=-1.0))
    run = record(HOUSE, 3.0, noise_K=0.01)
    operator = found(run).operator
    free_C = run.T_zone_C[0] - forced_history(single(operator), run).sum(axis=(0, 1, 3))
    features = feature_matrix(free_C[:-1], run.T_out_C[:-1], run.solar_W_m2[:-1], run.time_s[:-1])
    heat = heat_drive(single(operator), run, 0, run.n_steps)[0]
    assert heat @ operator.modulation(features) / heat.sum() == pytest.approx(1.0, abs=0.02)


def changing_house():
    """Full level gives half as much again by day and half by night, and after the part to train on the reverse."""
    pairs = []
    for seed in range(8):
        pair = make_pair(HOUSE, seed)
        runs = []
        for run in (pair.a, pair.b):
            hour = run.time_s[:-1] / HOUR_S % 24
            share = np.where((hour > 9) & (hour < 21), 0.4, -0.4) * (-1.0 if seed in HELD_OUT else 1.0)
            extra = HOUSE.effect_K(share * run.heat_W[0] / sum(HOUSE.machine_W), run.step_s)
            runs.append(replace(run, T_zone_C=run.T_zone_C + extra, time_s=run.time_s + 10 * 86400.0 * seed))
        pairs.append(replace(pair, a=runs[0], b=runs[1]))
    return pairs


HELD_OUT = frozenset(np.random.default_rng(IdentificationConfig().seed).permutation(8)[:2].tolist())


@pytest.mark.slow
@pytest.mark.parametrize(("modulation", "kept"), [("auto", False), ("always", True)])
def test_a_network_that_is_significantly_worse_is_dropped_unless_it_is_always_kept(modulation, kept):
    pairs = changing_house()
    config = IdentificationConfig(order=3, modulation=modulation, heat_input="identity")
    model = identify(pairs=pairs, config=config, floor_area_m2=190.0).only
    scores = model.card.scores
    assert scores["held_out_neural"] > 1.02 * scores["held_out_linear"]
    assert bool(scores["modulation_kept"]) is kept
    assert counts(model) == ((199, 199, 199) if kept else (199, 6, 6))
    said = [
        note for note in model.card.notes if note.startswith("network not kept: m = 1 instead, since held-out data")
    ]
    assert bool(said) is not kept
    if not kept:
        assert model.operator.parameters_in_words == "199 trained parameters, 6 used: the network was not kept"


@pytest.mark.slow
def test_levels_that_are_held_keep_the_heat_map_under_the_network():
    """A plan that holds levels needs the heat at each, which v = u does not have."""
    model = found(record(HOUSE, 3.0, noise_K=0.01))
    assert model.operator.heat_input.heat is not None
    assert counts(model) == (199, 199, 199)
    (said,) = [note for note in model.card.notes if note.startswith("heat input")]
    assert said.startswith("heat input: measured heat, since levels between off and full are held")


def test_without_a_meter_the_network_starts_at_one():
    linear = linear_operator([0.9], [0.1], step_s=900.0)
    start = with_network(linear, seed=1)
    assert start.n_trained == 195
    assert start.constant_modulation == 1.0


@pytest.mark.slow
def test_a_circuit_on_a_heating_curve_has_the_heat_that_was_measured_in_any_weather():
    """A network that saw mild days knows little of the heat in the cold, and would ask neighbours for it."""
    house = House(slope_per_K=-0.04)
    run = record(house, 3.0, u=SWITCHED, noise_K=0.01)
    model = found(run)
    heat_input = model.operator.heat_input
    assert heat_input.heat is not None
    assert any(note.endswith("per K outdoors") for note in model.card.notes)
    T_out = run.T_out_C.min() - np.array([0.0, 5.0, 10.0])
    full = heat_input(np.ones(3), T_out)
    np.testing.assert_allclose(full / full[0], house.heat_W(1.0, T_out) / house.heat_W(1.0, T_out[0]), rtol=0.02)
