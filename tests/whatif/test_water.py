"""Heat of valves whose emitters are warm or cold, beside an emitter that is integrated."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.whatif.water import emitted

_STEP_S = 900.0


@pytest.mark.parametrize("emitters", [0.3, 1.0, 2.0])
def test_heat_of_a_level_is_that_of_an_emitter_between_water_and_room(emitters: float) -> None:
    """In the mean of each step: from water of 1 through u·r into the emitter, from there through 1 into a room of 0."""
    u = np.random.default_rng(5).uniform(0.0, 1.0, (2, 192)) * np.array([[1.0], [0.5]])
    begin = u[:, :96].mean(axis=1)
    warm, small, expected = emitters * begin / (1.0 + emitters * begin), 300, np.empty_like(u)
    for k in range(u.shape[1]):
        total = np.zeros(2)
        for _ in range(small):
            into = emitters * u[:, k] * (1.0 - warm)
            total += into / emitters
            warm = warm + (into - warm) * _STEP_S / small / (3.0 * HOUR_S)
        expected[:, k] = total / small
    np.testing.assert_allclose(emitted(u, _STEP_S, emitters)[0], expected, atol=1e-3)
    past, warmth = emitted(u[:, :120], _STEP_S, emitters)
    later, _ = emitted(u[:, 120:], _STEP_S, emitters, warmth)
    np.testing.assert_allclose(np.concatenate([past, later], axis=1), emitted(u, _STEP_S, emitters)[0])


def test_a_level_that_is_held_gives_less_than_when_it_begins() -> None:
    heat = emitted(np.concatenate([np.zeros((1, 96)), np.full((1, 96), 0.5)], axis=1), _STEP_S, 1.0)[0][0]
    assert heat[96] > 0.48
    assert heat[-1] == pytest.approx(0.5 / 1.5, abs=1e-3)
    assert (np.diff(heat[96:]) < 0.0).all()


def test_an_emitter_that_takes_any_heat_leaves_levels_as_they_are() -> None:
    u = np.random.default_rng(6).uniform(0.0, 1.0, (1, 96))
    np.testing.assert_allclose(emitted(u, _STEP_S, 0.0)[0], u)
