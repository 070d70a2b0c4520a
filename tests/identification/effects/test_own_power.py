"""Another load on the meter is in no law of the machine, and is expected where its meter is read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from houses import House, record

from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.model.thermal_model import load_model


def with_coil(run):
    """The record with an air unit's coil on the meter: from 6 to 19 h, more when it is cold."""
    hour = run.time_s[:-1] % DAY_S / HOUR_S
    coil_W = 500.0 + ((hour >= 6) & (hour < 19)) * 100.0 * (18.0 - run.T_out_C[:-1])
    return replace(run, power_W=run.power_W + coil_W), coil_W


def test_laws_are_those_of_the_machine_alone(tmp_path):
    linear = IdentificationConfig(modulation="linear")
    alone = record(House(), heat_measured=False)
    run, coil_W = with_coil(alone)
    model, without = identify(run, config=linear), identify(alone, config=linear)
    assert without.power[0].foreign is None
    levels, T_out = np.array([0.4, 0.7, 1.0]), np.full(3, 2.0)
    np.testing.assert_allclose(model.power[0](levels, T_out), without.power[0](levels, T_out), rtol=0.08)
    assert any("another load" in note for note in model.only.card.notes)

    # What is saved expects the meter as it is.
    read = load_model(model.save(tmp_path / "model"))
    assert read.power[0] == model.power[0]
    expected = read.power[0].metered(run.u[0], run.time_s[:-1], run.T_out_C[:-1])
    assert abs(expected.sum() / run.power_W[0].sum() - 1.0) < 0.03
    assert np.sqrt(np.mean((expected - run.power_W[0]) ** 2)) < 0.3 * coil_W.mean()
