"""The forced state followed step by step, and what a wrong model costs in closed loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from faults import FaultyHouse
from mpc_problems import random_operator
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.forced_state import followed, forced_history
from thermoforce_mpc.model.free_response.linear_weather import LinearWeather
from thermoforce_mpc.model.predictor import Predictor


def some_history(n: int = 60, seed: int = 0) -> Record:
    rng = np.random.default_rng(seed)
    return Record(
        time_s=HOUR_S * np.arange(n + 1),
        T_zone_C=20.0 + np.cumsum(rng.normal(0, 0.1, n + 1)),
        T_out_C=rng.normal(5, 3, n + 1),
        solar_W_m2=np.maximum(rng.normal(50, 100, n + 1), 0),
        u=rng.random(n),
        power_W=np.full(n, np.nan),
        heat_W=np.full(n, np.nan),
    )


def test_step_by_step_is_the_rollout_of_the_whole_history():
    operator, history = simple_model().operator, some_history()
    state = None
    for n in (0, 1, 2, 3, 30, 31, 60):
        state = followed(operator, state, history.slice(0, n))
    assert state.forced_K.shape == (1, 1, 61, operator.shape[2])
    # The first day sets the steady start, so the start is known from the first whole rollout on.
    begun = followed(operator, None, history.slice(0, 30))
    np.testing.assert_allclose(
        followed(operator, begun, history).forced_K, forced_history(operator, history), atol=1e-12
    )


def test_a_trained_network_is_followed_on_what_is_free_of_the_actions_as_the_rollout_is():
    """Features hold T − F, and this network is one whose F would move by tenths of a kelvin if they held T."""
    trained = random_operator(np.random.default_rng(1), order=2)
    operator, history = simple_model().operator.map(lambda pair: trained), some_history()
    whole = forced_history(operator, history)
    begun = followed(operator, None, history.slice(0, 30))
    np.testing.assert_allclose(followed(operator, begun, history).forced_K, whole, atol=1e-12)
    warmer = replace(history, T_zone_C=history.T_zone_C + whole.sum(axis=(1, 3)))
    assert np.abs(forced_history(operator, warmer) - whole).max() > 0.1, "T for T − F is seen"


def test_following_changes_no_state_that_was_given():
    operator, history = simple_model().operator, some_history()
    begun = followed(operator, None, history.slice(0, 30))
    kept = begun.forced_K.copy()
    a, b = (followed(operator, begun, history) for _ in range(2))
    np.testing.assert_array_equal(a.forced_K, b.forced_K)
    np.testing.assert_array_equal(begun.forced_K, kept)
    assert followed(operator, a, history) is a


def test_another_run_starts_anew():
    operator = simple_model().operator
    before = followed(operator, None, some_history(40))
    other = some_history(50, seed=3)
    other = replace(other, time_s=other.time_s + 5 * 86400.0)
    np.testing.assert_allclose(followed(operator, before, other).forced_K, forced_history(operator, other), atol=1e-12)


def test_a_gap_in_a_new_step_is_refused_with_its_place():
    history = some_history(10)
    operator = simple_model().operator
    state = followed(operator, None, history.slice(0, 9))
    broken = replace(history, T_out_C=np.append(history.T_out_C[:-1], np.nan))
    with pytest.raises(DataError, match="T_out_C is not finite at step 10 of 10"):
        followed(operator, state, broken)


def test_free_and_forced_always_add_up_to_what_was_measured():
    model, history = simple_model(), some_history()
    predictor = Predictor(model.operator, OutdoorResponse())
    free = predictor.free_history(history)
    np.testing.assert_allclose(free + predictor.forced_history(history).sum(axis=(1, 3)), history.T_zone_C, atol=1e-12)


def warm_outdoors(house, seen):
    """The outdoor sensor reads too warm; the weather forecast is right."""
    return replace(seen, T_out_C=seen.T_out_C + 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("gain_error", [0.8, 1.2])
def test_a_wrong_gain_leaves_no_lasting_offset(gain_error):
    model = simple_model()
    wrong = replace(model, operator=model.operator.map(lambda pair: replace(pair, gains=gain_error * pair.gains)))
    # A rigid free model, which does not learn from T − F, keeps the error for ever.
    rigid = lasting_offset_K(wrong, SimpleHouse(), free=OutdoorResponse())
    assert abs(rigid) > 0.02
    assert abs(lasting_offset_K(wrong, SimpleHouse())) < min(0.015, 0.5 * abs(rigid))


@pytest.mark.slow
def test_a_biased_outdoor_sensor_leaves_no_lasting_offset():
    assert abs(lasting_offset_K(simple_model(), FaultyHouse(warm_outdoors))) < 0.01


def lasting_offset_K(model, house: SimpleHouse, free=None) -> float:
    """Mean of what one-step predictions were off on the last day of a closed loop, K."""
    # Blocks shorter than the step would add their own rounding: the level is held here.
    config = MPCConfig(
        step_s=None,
        horizon_h=24,
        actuation={"mode": "modulating", "lowest_level": 0.0},
        corrections=False,
        watch={"enabled": False},
    )
    mpc = ThermoForceMPC(model, config, free_response=free or LinearWeather())
    result = run_closed_loop(house, mpc, house.period("x"))
    pairs = zip(result.steps[-25:-1], result.steps[-24:], strict=True)
    return float(np.mean([after.T_zone_C[0] - before.plan.T_zone_C[0, 0] for before, after in pairs]))
