"""What the connection does with a Home Assistant core, case by case: against a real one, or its recorded answers.

Each case gets `connect(**options)`, which makes a connection, and `act(service, **data)`, which does something in the
house; with recorded answers that has been done.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from thermoforce_mpc.errors import PlantError

HALL = {"hall": {"entity": "climate.hall", "release": 20.0}}


def sets_a_thermostat_and_gives_it_back(connect, act):
    home = connect(actuators=HALL, watchdog="timer.tf_mpc")
    home.write({"hall": 21.5}, 1020.0)
    assert act("state", "climate.hall")["attributes"]["temperature"] == 21.5
    assert act("state", "timer.tf_mpc")["attributes"]["duration"] == "0:17:00"
    home.write({"hall": None}, 0.0)
    assert act("state", "climate.hall")["attributes"]["temperature"] == 20.0
    assert act("state", "timer.tf_mpc")["state"] == "idle"


def puts_back_what_devices_held(connect, act):
    """After a trial: what they held, not what they are given back to; and the timer does not undo it."""
    pump = {
        "entity": "input_select.sg_ready",
        "release": "normal",
        "options": {1: "blocked", 2: "normal", 3: "recommended"},
    }
    home = connect(actuators=HALL | {"pump": pump}, watchdog="timer.tf_mpc")
    assert act("call", "climate.set_temperature", entity_id="climate.hall", temperature=22.5) == 200
    assert act("call", "input_select.select_option", entity_id="input_select.sg_ready", option="recommended") == 200
    held = home.present(["hall", "pump"])
    assert held == {"hall": 22.5, "pump": 3.0}
    home.write({"hall": 21.0, "pump": 2.0}, 900.0)
    home.put_back(held)
    assert act("state", "climate.hall")["attributes"]["temperature"] == 22.5
    assert act("state", "input_select.sg_ready")["state"] == "recommended"
    assert act("state", "timer.tf_mpc")["state"] == "idle"
    home.write({"hall": None, "pump": None}, 0.0)


def rounds_to_the_step_of_the_device(connect, act):
    curve = {"curve": {"entity": "number.curve", "release": 0}}
    home = connect(actuators=HALL | curve)
    home.write({"hall": 21.3, "curve": -1.3}, 900.0)
    assert act("state", "climate.hall")["attributes"]["temperature"] == 21.5
    assert float(act("state", "number.curve")["state"]) == -1.5
    home.write({"hall": None, "curve": None}, 0.0)


def sets_switches_options_and_numbers(connect, act):
    actuators = {
        "heater": {"entity": "input_boolean.contact", "release": False},
        "pump": {"entity": "input_select.sg_ready", "release": "normal",
                 "options": {1: "blocked", 2: "normal", 3: "recommended"}},
        "valve": {"entity": "input_number.power", "release": 0, "scale": 100.0},
    }  # fmt: skip
    home = connect(actuators=actuators)
    home.write({"heater": 1.0, "pump": 3.0, "valve": 0.42}, 900.0)
    assert act("state", "input_boolean.contact")["state"] == "on"
    assert act("state", "input_select.sg_ready")["state"] == "recommended"
    assert float(act("state", "input_number.power")["state"]) == 42.0
    with pytest.raises(PlantError, match="no option for 4"):
        home.write({"pump": 4.0}, 900.0)
    home.write({"heater": None, "pump": None, "valve": None}, 0.0)
    assert act("state", "input_boolean.contact")["state"] == "off"
    assert act("state", "input_select.sg_ready")["state"] == "normal"


def refuses_what_the_device_does_not_take(connect, act):
    assert act("call", "climate.set_temperature", entity_id="climate.none", temperature=21) == 200
    assert act("call", "climate.set_temperature", entity_id="climate.hall", temperature=40) in (400, 500)
    home = connect(actuators=HALL | {"none": {"entity": "climate.none", "release": 20}})
    with pytest.raises(PlantError, match=r"takes 10.0 to 26.0, not 30"):
        home.write({"hall": 30.0}, 900.0)
    with pytest.raises(PlantError, match=r"no entity 'climate.none'"):
        home.write({"none": 21.0}, 900.0)
    # What can be set is, also where another cannot.
    with pytest.raises(PlantError, match="no entity"):
        home.write({"none": 21.0, "hall": 22.0}, 900.0)
    assert act("state", "climate.hall")["attributes"]["temperature"] == 22.0
    home.write({"hall": None}, 0.0)


def says_that_a_device_did_not_take_its_value(connect, act):
    home = connect(actuators={"deaf": {"entity": "number.deaf", "release": 1}})
    with pytest.raises(PlantError, match=r"number.deaf was set to 3.0 but says 1"):
        home.write({"deaf": 3.0}, 900.0)


def sets_nothing_of_what_is_off_or_unavailable(connect, act):
    act("call", "climate.set_hvac_mode", entity_id="climate.hall", hvac_mode="off")
    act("call", "input_boolean.turn_off", entity_id="input_boolean.there")
    home = connect(actuators=HALL | {"curve": {"entity": "number.curve", "release": 0}})
    with pytest.raises(PlantError, match="is off") as problem:
        home.write({"hall": 21.0, "curve": 1.0}, 900.0)
    assert "number.curve is unavailable" in str(problem.value)
    act("call", "climate.set_hvac_mode", entity_id="climate.hall", hvac_mode="heat")
    act("call", "input_boolean.turn_on", entity_id="input_boolean.there")


def reads_states_attributes_and_words(connect, act):
    home = connect(columns=[
        "sensor.room_temperature", "climate.hall.current_temperature", "climate.hall.temperature",
        "climate.hall.hvac_action", "input_boolean.heater",
    ], days=1.0, every_s=1.0)  # fmt: skip
    act("call", "input_number.set_value", entity_id="input_number.room", value=18.25)
    act("sleep", 2.5)
    act("call", "input_boolean.turn_off", entity_id="input_boolean.there")
    act("sleep", 3.0)
    act("call", "input_boolean.turn_on", entity_id="input_boolean.there")
    act("sleep", 1.5)
    table = home.measurements()
    assert str(table.index.tz) == "UTC"
    last = table.iloc[-1]
    assert last["sensor.room_temperature"] == 18.25
    assert abs(last["climate.hall.current_temperature"] - 18.25) <= 0.051  # as its precision is
    assert last["climate.hall.temperature"] == 20.0
    assert last["climate.hall.hvac_action"] == 1.0
    assert last["input_boolean.heater"] == 1.0
    # While it was unavailable there is no reading, not the one before.
    lately = table["sensor.room_temperature"].iloc[-8:]
    assert 2 <= lately.isna().sum() <= 4
    # Once more: what came since is added.
    again = home.measurements()
    shared = table.index[10:-1].intersection(again.index)
    assert np.array_equal(table.loc[shared].to_numpy(), again.loc[shared].to_numpy(), equal_nan=True)


def names_the_entity_that_is_not_there(connect, act):
    with pytest.raises(PlantError, match=r"no entity 'sensor.room_temperatur'.*sensor.room_temperature"):
        connect(columns=["sensor.room_temperatur"]).measurements()
    with pytest.raises(PlantError, match="holds no number, but 'heat'"):
        connect(columns=["climate.hall"], days=1.0).measurements()


def does_not_say_the_token(connect, act):
    home = connect(token="not-the-token", columns=["sensor.room_temperature"], actuators=HALL)
    for ask in (home.measurements, lambda: home.write({"hall": 21.0}, 900.0)):
        with pytest.raises(PlantError, match="does not accept the token") as problem:
            ask()
        assert "not-the-token" not in repr(problem.value)


CASES = [
    sets_a_thermostat_and_gives_it_back, puts_back_what_devices_held, rounds_to_the_step_of_the_device,
    sets_switches_options_and_numbers,
    refuses_what_the_device_does_not_take, says_that_a_device_did_not_take_its_value,
    sets_nothing_of_what_is_off_or_unavailable, reads_states_attributes_and_words, names_the_entity_that_is_not_there,
    does_not_say_the_token,
]  # fmt: skip


def live_act(core):
    """`act` of a real core."""

    def act(kind, *words, **data):
        if kind == "sleep":
            time.sleep(*words)
            return None
        return core.state(*words) if kind == "state" else core.call(*words, **data)

    return act
