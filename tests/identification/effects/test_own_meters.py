"""Another load on a meter of power or heat is in no law of the machine, and is expected where its meter is read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, record

from thermoforce_mpc.data import DAY_S, HOUR_S, Layout
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.meters import foreign_loads
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.model.free_response.linear_weather import Persistence
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import load_model


def with_coil(run):
    """The record with an air unit's coil on both meters: from 6 to 19 h, more when it is cold."""
    hour = run.time_s[:-1] % DAY_S / HOUR_S
    coil_W = 500.0 + ((hour >= 6) & (hour < 19)) * 100.0 * (18.0 - run.T_out_C[:-1])
    return replace(run, power_W=run.power_W + coil_W, heat_W=run.heat_W + 2.0 * coil_W), coil_W


@pytest.mark.slow
def test_laws_are_those_of_the_machine_alone(tmp_path):
    linear = IdentificationConfig(modulation="linear", sun_on_sensor=False, late_sensor=False)
    alone = record(House())
    run, coil_W = with_coil(alone)
    model, without = identify(run, config=linear), identify(alone, config=linear)
    assert (without.power[0].foreign, without.only.card.foreign_heat) == (None, None)
    levels, T_out = np.array([0.4, 0.7, 1.0]), np.full(3, 2.0)
    np.testing.assert_allclose(model.power[0](levels, T_out), without.power[0](levels, T_out), rtol=0.08)
    heat = [one.only.operator.heat_input.law(levels, T_out) for one in (model, without)]
    np.testing.assert_allclose(*heat, rtol=0.08)
    said = [note.split()[0] for note in model.only.card.notes if "the meter holds another load" in note]
    assert said == ["power", "heat"]

    # What is saved expects the meter of power as it is, and takes the other load off that of heat.
    read = load_model(model.save(tmp_path / "model"))
    assert read.power[0] == model.power[0]
    expected = read.power[0].metered(run.u[0], run.time_s[:-1], run.T_out_C[:-1])
    assert abs(expected.sum() / run.power_W[0].sum() - 1.0) < 0.03
    assert np.sqrt(np.mean((expected - run.power_W[0]) ** 2)) < 0.3 * coil_W.mean()
    own = read.in_rooms(run)
    assert np.sqrt(np.mean((own.heat_W - alone.heat_W) ** 2)) < 0.6 * coil_W.mean()
    effects = [Predictor(read.operator, Persistence()).forced_history(one).sum(-1) for one in (own, alone)]
    np.testing.assert_allclose(*effects, atol=0.05 * effects[1].max())


def test_cold_is_metered_below_zero():
    alone = record(House(sign=-1))
    coil_W = with_coil(alone)[1]
    layout = Layout.single("cooling")
    assert foreign_loads([alone], layout).heat == (None,)
    run = replace(alone, heat_W=alone.heat_W - coil_W)
    loads = foreign_loads([run], layout)
    own_W = loads.taken_off(run).heat_W
    assert (own_W <= 0.0).all()
    assert np.sqrt(np.mean((own_W - alone.heat_W) ** 2)) < 0.3 * coil_W.mean()
