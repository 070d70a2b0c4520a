"""Every state that a controller of this package has can be kept."""

from __future__ import annotations

import dataclasses
import sys
import typing
from dataclasses import replace

import numpy as np
import pytest
from simple_house import SimpleHouse, simple_model

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from controllers.registry import REGISTRY, build_controller
from controllers.state_classes import STATE_CLASSES
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.free_response.registry import REGISTRY as FREE_RESPONSES
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.state_file import StateFormat

FORMAT = StateFormat(STATE_CLASSES)
OPTIONS = {
    "step_s": HOUR_S,
    "horizon_h": 3.0,
    "watch": {"enabled": True},
    "gate": {"enabled": False},
    "free_response": {"name": "residual", "options": {"backbone": "shipped"}},
}


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
    rc = RcParameters(np.array([0.99]), np.full((1, 8), 0.01), HOUR_S, np.array([[0.0025]]), np.eye(1), 0.02)
    return replace(simple_model(), free=(rc,))


@pytest.mark.slow
@pytest.mark.parametrize("name", REGISTRY.own)
def test_the_state_of_every_controller_is_kept(name, tmp_path):
    testcase = load_testcase("bestest_hydronic_heat_pump")
    plans = REGISTRY.find(name).needs_model
    options = {"step_s": HOUR_S, "gate": {"enabled": False}, "watch": {"enabled": True}} if plans else {}
    if name == "dpc":
        options["policy"] = {"instances": 64, "epochs": 1}
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
    kept = set(STATE_CLASSES)
    for kind in kept:
        for name, hint in typing.get_type_hints(kind).items():
            assert classes_in(hint) <= kept, f"{kind.__name__}.{name}"
