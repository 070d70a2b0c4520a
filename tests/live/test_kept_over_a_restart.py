"""What a controller that was stopped or killed left behind: what it serves for, and where it begins anew."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from simple_house import simple_model
from simulated_building import RULES, START, SimulatedBuilding, mpc

from thermoforce_mpc.data import Block
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.live import KeptState, LiveBuilding, People, control
from thermoforce_mpc.live.shadow import ShadowBook
from thermoforce_mpc.measurements.map.mapping import MeasurementMap

HOUR = pd.Timedelta("1h")


class KilledError(BaseException):
    """The process is killed: nothing more is done."""


class Thermostat(SimulatedBuilding):
    """The house with a thermostat that is told a set-point, or SG-Ready's contacts; what heats it is its own affair."""

    usual, held, killed = 20.0, None, False
    kill_at: pd.Timestamp | None = None

    def measurements(self) -> pd.DataFrame:
        return super().measurements().assign(set=self.usual if self.held is None else self.held)

    def wait_until(self, at: pd.Timestamp) -> None:
        if self.killed:
            raise KilledError
        if self.kill_at is not None and at >= self.kill_at:
            at, self.kill_at = self.kill_at, None
            super().wait_until(at)
            self.killed = True
            raise KilledError
        super().wait_until(at)

    def write(self, levels, seconds) -> None:
        if self.killed:
            raise KilledError
        self.written.append((self.at, dict(levels), seconds))
        (self.held,) = levels.values()


def controlled(house, folder: Path, value, command, steps=1, kill_at_h=None, **settings):
    """Decisions of a controller that tells the thermostat always the same."""
    controller = mpc()
    plan = controller.plan
    controller.plan = lambda observation, state=None: replace(
        plan(observation, state), blocks=(Block(0.4, 3600.0, (value,)),)
    )
    house.kill_at = None if kill_at_h is None else START + kill_at_h * HOUR
    rules = RULES | {"actuators": {"actuator": {"level": "u", "command": command}}}
    building = LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0, people=People(folder / "people.json"))
    told = []
    kept = KeptState(folder / "state.npz", "k")
    try:
        control(building, controller, clock=house, steps=steps, delay_s=0.0, kept=kept, told=told.append, **settings)
    except BaseException as error:
        if KilledError not in (type(error), type(error.__cause__)):
            raise
        house.killed = False
    return told


SETPOINT = {"kind": "setpoint", "column": "set", "minimum": 18, "maximum": 26}
CONTACT = {"kind": "sg_ready", "column": "set", "usual": 2}


def test_what_somebody_set_while_a_killed_controller_was_away_is_left_alone(tmp_path):
    house = Thermostat()
    controlled(house, tmp_path, 21.0, SETPOINT, steps=9, kill_at_h=1.6)
    assert house.held == 21.0
    house.held, before = 24.0, len(house.written)
    told = controlled(house, tmp_path, 21.0, SETPOINT, steps=3)
    assert "24 °C was set by hand" in str(told[0].notes)
    assert house.held == 24.0
    assert house.written[before:] == []


@pytest.mark.slow
@pytest.mark.parametrize("later_h", [0.0, 3.0])
def test_what_is_held_yet_when_it_is_started_again_is_nobody_at_the_wall(tmp_path, later_h):
    """Also where the device went back by itself, once the time was over for which it was set."""
    house = Thermostat()
    controlled(house, tmp_path, 21.0, SETPOINT, steps=9, kill_at_h=1.6)
    house.held = 21.0 if later_h == 0.0 else None
    house.wait_until(house.at + later_h * HOUR)
    told = controlled(house, tmp_path, 21.0, SETPOINT, steps=2)
    assert [one.notes for one in told] == [(), ()]
    assert house.written[-2][1] == {"actuator": 21.0}


@pytest.mark.parametrize("killed", [False, True])
def test_what_was_given_back_is_not_counted_as_held_when_it_is_started_again(tmp_path, killed):
    """A contact may be closed for two hours: closed again the next morning it has been so for none."""
    house = Thermostat()
    house.usual = 2.0
    controlled(house, tmp_path, 1.0, CONTACT, steps=9 if killed else 1, kill_at_h=0.5 if killed else None)
    house.held = None  # by the controller, or by what looks after the device
    house.wait_until(START + 6 * HOUR)
    before = len(house.written)
    controlled(house, tmp_path, 1.0, CONTACT)
    assert [levels["actuator"] for _, levels, _ in house.written[before:]] == [1.0, None]


def kept_with(path: Path, **changes):
    """The file of a state, with other values at the keys of the controller's state after the decision."""
    with np.load(path) as stored:
        text = json.loads(bytes(stored["structure"]))
        arrays = {name: stored[name] for name in stored.files if name != "structure"}
    for key, value in changes.items():
        of, key = (text["of"], key[5:]) if key.startswith("kept_") else (text["of"]["after"]["of"], key)
        assert key in of
        of[key] = value
    content = io.BytesIO()
    np.savez(content, structure=np.frombuffer(json.dumps(text).encode(), np.uint8), **arrays)
    path.write_bytes(content.getvalue())


WRONG = [
    {"failures": None},
    {"peak_W": "high"},
    {"sensors": {"tuple": [None]}},
    {"watch": {"tuple": [None]}},
    {"margins": None},
    {"kept_instant": "yesterday"},
    {"kept_instant": "2025-01-12T01:00:00"},
    {"kept_origin": ""},
    {"kept_applied": {"tuple": [None]}},
    {"kept_commands": {"tuple": [{"is": "SetCommand", "of": dict.fromkeys(("name", "value", "since", "until"), "")}]}},
]


def test_a_state_that_makes_no_sense_keeps_no_building_from_being_controlled(tmp_path, caplog):
    """It is not taken up; and where what is wrong shows in the first decision alone, that is made once more without."""
    house, path = Thermostat(), tmp_path / "state.npz"
    controlled(house, tmp_path, 21.0, SETPOINT)
    written = path.read_bytes()
    for changes in WRONG:
        path.write_bytes(written)
        kept_with(path, **changes)
        assert KeptState(path, "k").load(house.at) is None, changes
    path.write_bytes(written)
    kept_with(path, last_s=1e12)
    assert KeptState(path, "k").load(house.at) is not None
    told = controlled(house, tmp_path, 21.0, SETPOINT)
    assert [one.plan.status for one in told] == ["solved"]
    assert "no decision with the state that was kept" in caplog.text


def test_readings_that_are_missing_at_the_start_are_no_fault_of_what_was_kept(tmp_path):
    house = Thermostat()
    controlled(house, tmp_path, 21.0, SETPOINT)

    def down(what, now):
        raise OSError("gateway is down")

    house.failing = down
    with pytest.raises(PlantError, match="gateway is down"):
        controlled(house, tmp_path, 21.0, SETPOINT)


SHADOW_DAY = {
    "day": "2025-01-11", "energy_was_kWh": 9.0, "energy_kWh": 8.0, "cost_was": 2.0, "cost": 1.8, "saved": [0.2] * 5,
    "outside_was_Kh": 0.0, "outside_Kh": 0.1, "warmer_K": 0.0, "planned": 1.0, "goes_on": False,
}  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        {"cost": float("nan")},
        {"cost_was": "2"},
        {"saved": []},
        {"saved": [0.2, None]},
        {"tank_below_Kh": [1.0, float("nan")]},
        {"day": "yesterday"},
        {"day": 3},
    ],
)
def test_an_account_of_a_shadow_that_makes_no_sense_is_begun_anew(tmp_path, change, caplog):
    """Else every day that comes could not be added up with it."""
    days = [SHADOW_DAY, SHADOW_DAY | {"day": "2025-01-12"} | change]
    (tmp_path / "shadow.json").write_text(json.dumps({"said": "", "of": "k", "days": days[:1]}))
    assert len(ShadowBook(tmp_path, simple_model(), mpc(), key="k").days) == 1
    (tmp_path / "shadow.json").write_text(json.dumps({"said": "", "of": "k", "days": days}))
    assert ShadowBook(tmp_path, simple_model(), mpc(), key="k").days == []
    assert f"{tmp_path}/shadow.json: begun anew" in caplog.text


def test_a_shadow_says_whether_hot_water_is_in_its_days(tmp_path):
    controller = mpc()
    (tmp_path / "shadow.json").write_text(json.dumps({"said": "", "of": "k", "days": [SHADOW_DAY]}))
    assert "hot water" not in ShadowBook(tmp_path, simple_model(), controller, key="k").in_words
    controller.hot_water = SimpleNamespace(machine="heat pump")
    told = ShadowBook(tmp_path, simple_model(), controller, key="k").in_words
    assert told.startswith("shadow: 1 day of")
    without = "hot water of heat pump as it was, since the house is lived through without its tank"
    assert f"; {without}" in told
    days = [SHADOW_DAY, SHADOW_DAY | {"day": "2025-01-12", "tank_below_Kh": [2.0, 0.5]}]
    (tmp_path / "shadow.json").write_text(json.dumps({"said": "", "of": "k", "days": days}))
    told = ShadowBook(tmp_path, simple_model(), controller, key="k").in_words
    assert "; hot water 0.5 instead of 2.0 K·h below what is wanted; in 1 day hot water of heat pump as it was" in told


def test_days_of_another_model_are_not_added_up_and_stay(tmp_path, caplog):
    path = tmp_path / "shadow.json"
    path.write_text(json.dumps({"said": "", "of": "k", "days": [SHADOW_DAY]}))
    assert len(ShadowBook(tmp_path, simple_model(), mpc(), key="k").days) == 1
    assert ShadowBook(tmp_path, simple_model(), mpc(), key="another").days == []
    assert "its days are of another model" in caplog.text
    assert not path.exists()
    assert json.loads((tmp_path / "shadow-before.json").read_text())["of"] == "k"


@pytest.mark.parametrize("cause", ["the state", "the controller"])
def test_a_controller_that_its_state_makes_fail_begins_anew_after_a_step(cause, caplog):
    house, controller, seen = SimulatedBuilding(), mpc(), []
    plan = controller.plan

    def fails(observation, state=None):
        seen.append(state is not None)
        if (len(seen) > 2 and state is not None) if cause == "the state" else (3 <= len(seen) <= 5):
            raise IndexError("well typed, and wrong")
        return plan(observation, state)

    controller.plan, told = fails, []
    building = LiveBuilding(house, MeasurementMap.model_validate(RULES), 3600.0)
    control(building, controller, clock=house, steps=5 if cause == "the controller" else 4, told=told.append)
    status = [decision.plan.status for decision in told]
    if cause == "the state":
        assert status == ["solved", "solved", "native", "solved"]
        assert seen == [False, True, True, True, False]
    else:  # it goes on from what it knew
        assert status == ["solved", "solved", "native", "native", "solved"]
        assert seen == [False, True, True, True, False, True]
    assert "begins anew" in caplog.text
