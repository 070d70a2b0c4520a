"""Home Assistant's answers, recorded of a real core (tests/with_home_assistant/check.py --record), served again."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("websockets")

import home_assistant_cases
from home_assistant_cases import CASES, HALL
from recorded_core import served, shifted

from thermoforce_mpc.connections.home_assistant import whole_hours
from thermoforce_mpc.connections.registry import build_connection
from thermoforce_mpc.errors import ConfigError, PlantError

CONTRACT = json.loads((Path(__file__).parent / "home_assistant.json").read_text())["cases"]


@pytest.fixture
def connect(monkeypatch):
    def made(url, *, columns=(), token=None, **options):
        monkeypatch.setenv("HOME_ASSISTANT_TOKEN", token or "TOKEN")
        home = build_connection("home-assistant", {"url": url, **options})
        home.reads(columns)
        return home

    return made


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_case(case, connect, monkeypatch):
    monkeypatch.setattr("thermoforce_mpc.connections.home_assistant.TAKEN_S", 0.3)
    recorded = CONTRACT[case.__name__]
    acts = iter(recorded["acts"])
    with served(recorded["exchanges"], "TOKEN") as url:
        case(lambda **options: connect(url, **options), lambda *words, **data: next(acts))


def test_a_core_that_is_away_is_said_without_the_token(connect):
    home = connect("http://127.0.0.1:9", actuators=HALL, columns=["sensor.room"], token="very-secret")
    for ask in (home.measurements, lambda: home.write({"hall": 21.0}, 900.0)):
        with pytest.raises(PlantError, match="refuses the connection") as problem:
            ask()
        assert "very-secret" not in repr(problem.value)


def test_the_token_stands_in_a_file_that_others_cannot_read(tmp_path, monkeypatch):
    monkeypatch.delenv("HOME_ASSISTANT_TOKEN", raising=False)
    monkeypatch.delenv("SUPERVISOR_TOKEN", raising=False)
    with pytest.raises(ConfigError, match="HOME_ASSISTANT_TOKEN"):
        build_connection("home-assistant", {})
    file = tmp_path / "token"
    file.write_text("abc\n")
    file.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        build_connection("home-assistant", {"token_file": str(file)})
    file.chmod(0o600)
    build_connection("home-assistant", {"token_file": str(file)})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"url": "homeassistant.local"}, "expected http"),
        ({"actuators": {"hall": {"entity": "light.hall", "release": 1}}}, "cannot be set"),
        ({"actuators": {"hall": {"entity": "climate.hall", "release": "warm"}}}, "expected a number"),
        ({"actuators": {"hall": {"entity": "climate.hall"}}}, "release"),
        ({"actuators": {"hall": {"entity": "switch.hall", "release": 1}}}, "true or false"),
        ({"actuators": {"hall": {"entity": "select.hall", "release": "normal"}}}, "options"),
        ({"watchdog": "input_boolean.x"}, "no timer"),
        ({"token": "secret"}, "token"),
    ],
)
def test_wrong_options_are_refused_with_their_key(options, said, monkeypatch):
    monkeypatch.setenv("HOME_ASSISTANT_TOKEN", "TOKEN")
    with pytest.raises(ConfigError, match=said):
        build_connection("home-assistant", options)


def test_hours_beside_an_outage_are_not_measured():
    """Home Assistant's hourly mean holds the value before an outage through the rest of the hour."""
    hours = [0, 1, 2, 6, 7, 8, 9]  # nothing in 3 to 5: the outage began in hour 2 and ended in hour 6
    middle_s, values = whole_hours([{"start": 3.6e6 * h, "end": 3.6e6 * (h + 1), "mean": float(h)} for h in hours])
    assert values.tolist() == [0.0, 1.0, 7.0, 8.0, 9.0]
    assert middle_s.tolist() == [3600.0 * h + 1800.0 for h in (0, 1, 7, 8, 9)]
    _, counted = whole_hours([{"start": 3.6e6 * h, "end": 0, "state": 10.0 * h, "sum": 0.0} for h in (0, 1, 2)])
    assert counted.tolist() == [0.0, 10.0, 20.0]


def days_of_states(now_s: float, silent_h: tuple[float, float], days: float = 2.0) -> list[list[dict]]:
    """States of two sensors every minute, in pieces of a day, without any in hours before now of `silent_h`."""
    pieces, at = [], now_s - days * 86400.0
    while at < now_s:
        end = min(at + 86400.0, now_s)
        rows = [
            {"s": str(20.0 + 0.001 * k), "a": {}, "lu": at + 60.0 * k}
            for k in range(int((end - at) / 60.0))
            if not silent_h[1] * 3600.0 < now_s - (at + 60.0 * k) < silent_h[0] * 3600.0
        ]
        pieces.append(rows)
        at = end
    return pieces


@pytest.mark.parametrize("house", ["°C", "°F"])
def test_attributes_of_a_climate_have_the_unit_of_the_house(connect, house):
    """They carry none, and its API tells all temperatures of a climate in the unit of its system of units."""
    now_s = time.time()
    columns = ["climate.hall.current_temperature", "climate.hall.temperature", "climate.hall.hvac_action"]
    columns += ["climate.hall.current_humidity", "weather.home.temperature", "sensor.gas"]
    begun = datetime.fromtimestamp(now_s - 3600.0, UTC).isoformat()
    hall = {"current_temperature": 68.0, "temperature": 70.0, "hvac_action": "heating", "current_humidity": 40}
    of = {"climate.hall": hall, "weather.home": {"temperature": 4.0, "temperature_unit": "°C"}}
    of["sensor.gas"] = {"unit_of_measurement": "ft³"}
    states = [{"entity_id": n, "state": "1", "attributes": a, "last_updated": begun} for n, a in of.items()]
    asked = {
        "type": "history/history_during_period", "entity_ids": list(of), "significant_changes_only": False,
        "minimal_response": False, "no_attributes": False,
    }  # fmt: skip
    rows = {name: [{"s": "1", "a": a, "lu": now_s - 3600.0 * h} for h in (2, 1)] for name, a in of.items()}
    told = {"/api/states": states, "/api/config": {"unit_system": {"temperature": house}}}
    exchanges = [{"at": now_s, "asked": f"GET {at}", "status": 200, "text": json.dumps(x)} for at, x in told.items()]
    answer = {"type": "result", "success": True, "result": rows}
    exchanges.append({"at": now_s, "asked": json.dumps(asked, sort_keys=True), "answer": answer})
    with served(exchanges, "TOKEN") as url:
        table = connect(url, columns=columns, days=0.1).measurements()
    assert table.attrs["units"] == {
        "climate.hall.current_temperature": house, "climate.hall.temperature": house, "sensor.gas": "ft³",
        "climate.hall.current_humidity": "%", "weather.home.temperature": "°C",
    }  # fmt: skip


def test_what_was_not_stored_while_the_core_was_down_is_not_measured(connect):
    now_s = time.time()
    names = ["sensor.room", "sensor.hall"]
    pieces = days_of_states(now_s, (7.0, 5.5))
    stamp = datetime.fromtimestamp(now_s - 60.0, UTC).isoformat()
    states = [{"entity_id": n, "state": "20.5", "attributes": {}, "last_updated": stamp} for n in names]
    states[0]["attributes"] = {"unit_of_measurement": "°F"}
    asked = {
        "type": "history/history_during_period", "entity_ids": names, "significant_changes_only": False,
        "minimal_response": False, "no_attributes": False,
    }  # fmt: skip
    exchanges = [{"at": now_s, "asked": "GET /api/states", "status": 200, "text": json.dumps(states)}]
    for rows in pieces:
        answer = {"type": "result", "success": True, "result": dict.fromkeys(names, rows)}
        exchanges.append({"at": now_s, "asked": json.dumps(asked, sort_keys=True), "answer": answer})
    with served(exchanges, "TOKEN") as url:
        table = connect(url, columns=names, days=2.0).measurements()
    assert table.attrs["units"] == {"sensor.room": "°F"}
    ago_h = (table.index[-1] - table.index) / np.timedelta64(1, "h")
    missing = table["sensor.room"].isna().to_numpy()
    assert missing[(ago_h < 6.9) & (ago_h > 5.6)].all()
    assert not missing[(ago_h < 5.4)].any()


def test_an_entity_that_is_away_costs_what_it_measures_and_is_said_once(connect, caplog):
    """As after a restart of Home Assistant, until its integration has started, or where it was renamed."""
    now_s, names = time.time(), ["sensor.room", "sensor.hall"]
    stamp = datetime.fromtimestamp(now_s - 60.0, UTC).isoformat()
    unit = {"unit_of_measurement": "°C"}
    both = [{"entity_id": n, "state": "20.5", "attributes": unit, "last_updated": stamp} for n in names]
    asked = {
        "type": "history/history_during_period", "entity_ids": names, "significant_changes_only": False,
        "minimal_response": False, "no_attributes": False,
    }  # fmt: skip
    rows = [{"s": "20.5", "a": {}, "lu": now_s - 3600.0 + 60.0 * k} for k in range(60)]
    answer = {"type": "result", "success": True, "result": dict.fromkeys(names, rows)}
    exchanges = [{"at": now_s, "asked": json.dumps(asked, sort_keys=True), "answer": answer}]
    for states in (both, both[:1], both[:1], both):
        exchanges.append({"at": now_s, "asked": "GET /api/states", "status": 200, "text": json.dumps(states)})
    with served(exchanges, "TOKEN") as url:
        home = connect(url, columns=names, days=0.04)
        tables = [home.measurements() for _ in range(4)]
    assert [table["sensor.room"].iloc[-1] for table in tables] == [20.5] * 4
    assert [bool(np.isnan(table["sensor.hall"].iloc[-1])) for table in tables] == [False, True, True, False]
    assert tables[2]["sensor.hall"].iloc[:-3].notna().all()
    assert tables[2].attrs["units"] == dict.fromkeys(names, "°C")
    (said,) = [text for text in caplog.messages if "no entity" in text]
    assert said.startswith("Home Assistant has no entity 'sensor.hall' any more")


def test_times_of_recorded_answers_are_moved():
    assert shifted({"lu": 1.0, "a": ["2026-01-01T00:00:00.500000+00:00"]}, 1.0) == {
        "lu": 2.0, "a": ["2026-01-01T00:00:01.500000+00:00"]
    }  # fmt: skip


def test_every_case_was_recorded():
    assert set(CONTRACT) == {case.__name__ for case in home_assistant_cases.CASES}


def test_an_entity_that_the_recorder_leaves_out_is_named(connect):
    now_s = time.time()
    stamp = datetime.fromtimestamp(now_s - 600.0, UTC).isoformat()
    states = [{"entity_id": "sensor.room", "state": "20.5", "attributes": {}, "last_updated": stamp}]
    asked = {
        "type": "history/history_during_period", "entity_ids": ["sensor.room"], "significant_changes_only": False,
        "minimal_response": False, "no_attributes": False,
    }  # fmt: skip
    answer = {"type": "result", "success": True, "result": {}}
    exchanges = [
        {"at": now_s, "asked": "GET /api/states", "status": 200, "text": json.dumps(states)},
        {"at": now_s, "asked": json.dumps(asked, sort_keys=True), "answer": answer},
    ]
    with served(exchanges, "TOKEN") as url, pytest.raises(PlantError, match=r"no history of 'sensor.room'"):
        connect(url, columns=["sensor.room"], days=1.0).measurements()


@pytest.mark.parametrize(("config", "zone"), [({"time_zone": "America/Denver"}, "America/Denver"), ({}, "")])
def test_the_home_s_time_zone_is_that_of_its_core(connect, config, zone):
    exchange = {"asked": "GET /api/config", "status": 200, "text": json.dumps(config), "at": time.time()}
    with served([exchange], "TOKEN") as url:
        assert connect(url, actuators=HALL).time_zone() == zone


def test_a_command_between_two_steps_of_a_device_is_said_once_with_what_to_set(connect, caplog):
    def hall(holds):
        attributes = {"temperature": holds, "min_temp": 7, "max_temp": 30, "target_temp_step": 1.0}
        state = {"entity_id": "climate.hall", "state": "heat", "attributes": attributes}
        return {"asked": "GET /api/states/climate.hall", "status": 200, "text": json.dumps(state), "at": time.time()}

    told, path = {"entity_id": "climate.hall", "temperature": 20.0}, "/api/services/climate/set_temperature"
    config = {"unit_system": {"temperature": "°C"}}
    exchanges = [
        hall(19.0),
        {"asked": "GET /api/config", "status": 200, "text": json.dumps(config), "at": time.time()},
        {"asked": f"POST {path} {json.dumps(told)}", "status": 200, "text": "[]", "at": time.time()},
        hall(20.0),
    ]  # fmt: skip
    with served([*exchanges, *exchanges], "TOKEN") as url:
        home = connect(url, actuators=HALL)
        for _ in range(2):
            home.write({"hall": 20.5}, 900.0)
    (said,) = caplog.messages
    assert said == "climate.hall takes steps of 1: 20.5 is set as 20: see resolution of its command in the map"


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        ("°F", "is in °F, with a least value of None: a temperature, or a change of one?"),
        ("%", "is in %, and 0.5 is a share: set sc"),
    ],
)
def test_a_number_of_another_unit_is_set_nothing_and_says_what_to_do(connect, unit, said):
    """20 of °F is no set-point, and 0.5 of % stands still; HA refuses neither where the number has no least value."""
    state = {"entity_id": "number.pump", "state": "40", "attributes": {"unit_of_measurement": unit, "max": 100}}
    asked = {"asked": "GET /api/states/number.pump", "status": 200, "text": json.dumps(state), "at": time.time()}
    with served([asked], "TOKEN") as url, pytest.raises(PlantError, match=said):
        connect(url, actuators={"pump": {"entity": "number.pump", "release": 60}}).write({"pump": 0.5}, 900.0)


def test_a_number_in_fahrenheit_is_set_and_read_as_a_climate_is(connect):
    """Its least value of 45 tells a temperature from a change of one; what is given back is written as it has it."""
    path = "/api/services/number/set_value"

    def pump(holds):
        attributes = {"unit_of_measurement": "°F", "min": 45, "max": 95, "step": 1}
        state = {"entity_id": "number.pump", "state": f"{holds}", "attributes": attributes}
        return {"asked": "GET /api/states/number.pump", "status": 200, "text": json.dumps(state), "at": time.time()}

    def told(value):
        asked = f"POST {path} {json.dumps({'entity_id': 'number.pump', 'value': value})}"
        return {"asked": asked, "status": 200, "text": "[]", "at": time.time()}

    with served([pump(68.0), told(70.0), pump(70.0), pump(70.0), pump(70.0), told(60.0), pump(60.0)], "TOKEN") as url:
        home = connect(url, actuators={"pump": {"entity": "number.pump", "release": 60}})
        home.write({"pump": 21.0}, 900.0)
        assert home.present(["pump"]) == pytest.approx({"pump": 21.11}, abs=0.01)
        home.write({"pump": None}, 0.0)


def test_a_thermostat_of_two_set_points_is_set_nothing_and_says_what_to_do(connect):
    attributes = {"temperature": None, "target_temp_low": 19.0, "target_temp_high": 24.0, "target_temp_step": 0.5}
    state = {"entity_id": "climate.hall", "state": "heat_cool", "attributes": attributes}
    asked = {"asked": "GET /api/states/climate.hall", "status": 200, "text": json.dumps(state), "at": time.time()}
    with served([asked], "TOKEN") as url, pytest.raises(PlantError, match="is in heat_cool, of two set-points: switch"):
        connect(url, actuators=HALL).write({"hall": 21.0}, 900.0)
