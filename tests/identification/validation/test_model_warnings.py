"""What is said besides the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, record

from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.zones.model import uncertain

LINEAR = IdentificationConfig(modulation="linear", order=1, sun_on_sensor=False, late_sensor=False)


@pytest.mark.slow
def test_power_that_does_not_follow_the_level_is_a_warning_and_no_reason():
    run = record(House(), 3.0, noise_K=0.01)
    hot_water = np.where(np.random.default_rng(0).random(run.n_steps) < 0.1, 6000.0, 0.0)
    clean, loaded = (
        identify(one, config=LINEAR, floor_area_m2=190.0).only.card
        for one in (run, replace(run, power_W=run.power_W + hot_water))
    )
    said = [note for note in loaded.notes if note.startswith("meter holds another load")]
    assert len(said) == 1
    assert "hot water" in said[0]
    assert not any(note.startswith("meter") for note in clean.notes)
    assert loaded.competence.competent


def test_an_effect_that_is_hardly_known_is_said():
    known = {"step_response_24h_K": 10.0, "step_response_24h_sd_K": 1.4}
    assert uncertain(known) == []
    (said,) = uncertain(known | {"step_response_24h_sd_K": 2.0})
    assert "± 20 %" in said
