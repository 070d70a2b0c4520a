"""Every state that a controller of this package has can be kept, and those that the last release kept are read."""

from __future__ import annotations

import dataclasses
import sys
import typing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from simple_house import SimpleHouse, simple_model

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from controllers.mpc.no_model import NoModelState
from controllers.registry import REGISTRY, build_controller
from controllers.rules.pi import PIState
from controllers.rules.thermostat import ThermostatState
from controllers.state_classes import STATE_CLASSES, controller_key
from thermoforce_mpc.data import DAY_S, HOUR_S, Observation
from thermoforce_mpc.live import KeptState
from thermoforce_mpc.live.building import Applied
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.free_response.registry import REGISTRY as FREE_RESPONSES
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.simulation.closed_loop import run_closed_loop
from thermoforce_mpc.state_file import StateFormat

FORMAT = StateFormat(STATE_CLASSES)
STORED = Path(__file__).parent / "stored_states"
# The controller that stored_states/control.npz is of, and its key in that release.
OPTIONS = {
    "step_s": HOUR_S,
    "horizon_h": 3.0,
    "watch": {"enabled": True},
    "gate": {"enabled": False},
    "free_response": {"name": "residual", "options": {"backbone": "shipped"}},
}
KEY = "c56e67eb951da01b"


def told(value) -> str:
    """All of a value, to the last digit."""
    with np.printoptions(precision=17, threshold=sys.maxsize):
        return repr(value)


def state_after(controller, hours):
    house = SimpleHouse()
    return run_closed_loop(house, controller, replace(house.period("x"), scored_s=hours * HOUR_S)).state


def check_kept(state, tmp_path):
    FORMAT.write(tmp_path / "state.npz", state)
    assert told(FORMAT.read(tmp_path / "state.npz")) == told(state)


def model():
    """The exact model of the house, with a linear free part."""
    rc = RcParameters(np.array([0.99]), np.full((1, 8), 0.01), HOUR_S, np.array([0.05]), 0.02)
    return replace(simple_model(), free=(rc,))


@pytest.mark.parametrize("name", REGISTRY.own)
def test_the_state_of_every_controller_is_kept(name, tmp_path):
    testcase = load_testcase("bestest_hydronic_heat_pump")
    plans = REGISTRY.find(name).needs_model
    options = {"step_s": HOUR_S, "gate": {"enabled": False}, "watch": {"enabled": True}} if plans else {}
    check_kept(state_after(build_controller(name, options, testcase, model() if plans else None), 3), tmp_path)
    if plans:
        check_kept(state_after(build_controller(name, options, testcase, "too few data"), 3), tmp_path)


@pytest.mark.parametrize("name", FREE_RESPONSES.own)
def test_what_every_free_response_keeps_is_kept(name, tmp_path):
    options = OPTIONS | {"free_response": {"name": name}}
    check_kept(state_after(ThermoForceMPC(model(), MPCConfig.model_validate(options)), 3), tmp_path)


def classes_in(kind) -> set[type]:
    """Classes with fields that a type hint names."""
    inside = {one for part in typing.get_args(kind) for one in classes_in(part)}
    return inside | ({kind} if dataclasses.is_dataclass(kind) or hasattr(kind, "_fields") else set())


def test_every_class_that_a_field_may_hold_is_in_the_table():
    kept = {stored.of for stored in STATE_CLASSES.values()}
    for kind in kept:
        for name, hint in typing.get_type_hints(kind).items():
            assert classes_in(hint) <= kept, f"{kind.__name__}.{name}"


def test_the_state_that_the_last_release_kept_is_gone_on_from():
    controller = ThermoForceMPC(simple_model(), MPCConfig.model_validate(OPTIONS))
    now = pd.Timestamp("2025-01-12T01:00Z")
    assert KeptState(STORED / "control.npz", controller_key(controller.model, controller.config)).load(now) is None, (
        "its options had a comfort weight for all zones"
    )
    kept = KeptState(STORED / "control.npz", KEY).load(now)
    assert kept.applied == (Applied(DAY_S, HOUR_S, (0.5,)), Applied(DAY_S + HOUR_S, HOUR_S, (None,)))
    state = kept.after
    assert (state.first_s, state.last_s, state.peak_W) == (10 * DAY_S, 10 * DAY_S + 11 * HOUR_S, 2508.3333333333335)
    np.testing.assert_allclose(state.good.T_zone_C, [[20.14765197, 20.00462304, 19.87023229]], rtol=1e-9)
    np.testing.assert_allclose(state.sensors[0].anchor.free_C, [2.63821162, 2.67028484, 2.70924523], rtol=1e-8)
    (adaptation,) = state.adaptation
    assert adaptation.factors == (1.0, 1.0)
    assert adaptation.model.operator.gains == [0.4]
    calibrated = state.predictor.free[0].inner
    assert (calibrated.issued.raw.shape, calibrated.inner.time_s) == ((3, 3, 3), 10 * DAY_S)
    np.testing.assert_allclose(calibrated.inner.share.sum(axis=0), 1.0)
    (track,) = state.watch[0].tracks
    np.testing.assert_allclose(track.judged[0], [867600.0, 0.0, -0.00347295769, 0.100057464, 0.1], rtol=1e-8)
    assert track.pending[0].time_s == state.last_s
    assert state.boundary.n_steps == 3
    house = SimpleHouse()
    house.reset(state.last_s + HOUR_S, 2 * DAY_S)
    plan = controller.plan(Observation(house.past(HOUR_S), house.forecast(3 * HOUR_S, HOUR_S)), state)
    assert (plan.state.first_s, plan.state.last_s) == (state.first_s, state.last_s + HOUR_S)


def test_states_of_rules_and_parts_of_a_model_of_the_last_release_are_read():
    rules = FORMAT.read(STORED / "rules.npz")
    assert rules["thermostat"] == ThermostatState(on=(True,))
    assert isinstance(rules["pi"], PIState)
    assert (rules["pi"].integral, rules["pi"].actuation[0].owed_s) == ((0.5255376389930271,), 42.38344063725651)
    assert isinstance(rules["no_model"], NoModelState)
    assert (rules["no_model"].actuation[0].native, rules["no_model"].last_s) == (True, 882000.0)
    zone = FORMAT.read(STORED / "zone_model.npz")
    np.testing.assert_array_equal(zone.free.poles, [0.5, 0.98])
    assert (zone.power.water.above_zone_K, zone.card.sun_on_sensor.full_K) == (12.0, 3.1)
    assert zone.card.competence.horizons[0].weather_K == 0.4


def test_every_class_of_the_table_is_read_from_a_file_of_the_last_release():
    structures = [bytes(np.load(path)["structure"]).decode() for path in STORED.glob("*.npz")]
    for name, stored in STATE_CLASSES.items():
        assert any(f'"{stored.former}"' in structure for structure in structures), name
