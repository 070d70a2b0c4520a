"""`tf-mpc commission`: points checked against one another, trials that are put back however they end, what is next."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner
from connected_home import SENSORS, TimedHome, rules_of
from home_by_curve import ENABLE_RULES, FLOW_RULES, RULES, SG_RULES, HomeByCurve
from waiting import wait_for

from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.live import LiveBuilding
from thermoforce_mpc.live.commissioning import CommissioningBook, CommissioningFiles, read_house, rows_of, stages
from thermoforce_mpc.live.trial import planned_trials, tried
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.points import read_points
from thermoforce_mpc.model.thermal_model import load_model

COMMAND = {"kind": "setpoint", "resolution": 0.5, "minimum": 17, "maximum": 24, "hold_min": 0}
TWO_ROOMS = {
    "time": {"zone": "UTC"},
    "step": "15min",
    "outdoor": "out",
    "zones": {
        "living": {"temperature": "T_living", "lower": 20.0, "upper": 23.0, "floor_area_m2": 30.0},
        "bath": {"temperature": "T_bath", "lower": 20.0, "upper": 25.0, "floor_area_m2": 8.0},
    },
    "actuators": {
        room: {"zone": room, "level": f"u_{room}", "command": COMMAND | {"column": f"set_{room}"}}
        for room in ("living", "bath")
    },
    "machines": {"boiler": {"power": "P", "price": 0.1}},
}


def table() -> pd.DataFrame:
    """Two days of two rooms until now, a row in 5 min: rooms near their set-points, a boiler that heats them."""
    now = pd.Timestamp.now("UTC").floor("1min")
    time = pd.date_range(now - pd.Timedelta("2D"), now, freq="5min", name="time")
    k = np.arange(time.size)
    u = {"living": 0.5 + 0.3 * np.sin(k / 40.0), "bath": 0.4 + 0.2 * np.cos(k / 31.0)}
    columns = {"out": 2.0 + 3.0 * np.sin(k / 46.0), "P": 4000.0 * (u["living"] + u["bath"])}
    for room, own_C in (("living", 21.0), ("bath", 24.0)):
        columns[f"T_{room}"] = np.round(own_C + 0.2 * np.sin(k / 25.0), 2)
        columns[f"set_{room}"] = np.where(k % 288 < 200, own_C, own_C - 1.5)
        columns[f"u_{room}"] = u[room]
    return pd.DataFrame(columns, index=time)


def written(folder: Path, rows: pd.DataFrame, rules=None) -> Path:
    """A house of files in a folder; its connection."""
    rows.to_csv(folder / "house.csv")
    ahead = pd.date_range(rows.index[-1].floor("1h"), periods=30, freq="1h", name="time")
    pd.DataFrame({"out": 2.0 + np.sin(np.arange(30) / 4.0)}, index=ahead).to_csv(folder / "tomorrow.csv")
    (folder / "map.yaml").write_text(yaml.safe_dump(TWO_ROOMS if rules is None else rules, sort_keys=False))
    names = {"measurements": "house.csv", "forecast": "tomorrow.csv", "levels": "levels.json"}
    options = {key: str(folder / name) for key, name in names.items()}
    (folder / "connection.yaml").write_text(yaml.safe_dump({"name": "files", "options": options}))
    return folder / "connection.yaml"


def told(folder: Path, *words: str):
    """The command's result, and what it wrote as JSON."""
    every = ["commission", str(folder / "connection.yaml"), "--out", str(folder / "out"), "--model", str(folder / "m")]
    result = CliRunner().invoke(cli, [*every, "--json", str(folder / "said.json"), *words])
    said = folder / "said.json"
    return result, json.loads(said.read_text()) if said.exists() else {}


def test_a_house_as_it_should_be_has_no_remark(tmp_path):
    written(tmp_path, table())
    result, said = told(tmp_path, "--dry-run")
    assert (result.exit_code, said["problems"], said["doubts"]) == (0, [], [])
    assert [stage["status"] for stage in said["stages"]] == ["done", "next", "later", "later", "later", "later"]
    point = next(one for one in said["points"] if one["key"] == "zones.living.temperature")
    assert (point["unit"], 20.7 < point["value"] < 21.3, point["age_s"] < 120, point["every_s"]) == (
        "°C", True, True, 300.0
    )  # fmt: skip
    assert said["stages"][2]["command"].startswith("tf-mpc commission"), "files record nothing by themselves"
    assert [plan["key"] for plan in said["planned"]] == ["living", "bath"]
    assert not (tmp_path / "levels.json").exists()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("home", "doubted"), [("Europe/Dublin", True), ("UTC", False), ("Atlantic/Reykjavik", False), ("", False)]
)
def test_a_map_by_another_clock_than_the_home_s_is_doubted(home, doubted):
    """Home Assistant knows its zone; by another one of the map, comfort is warm at the wrong hours."""
    building = SimpleNamespace(table=table, connection=SimpleNamespace(time_zone=lambda: home), step_s=900.0)
    rules = MeasurementMap.model_validate({**TWO_ROOMS, "outdoor": "missing"})  # it is not read as a whole
    rows = table().assign(missing=np.nan)
    building.table = lambda: rows
    doubts = read_house(building, rules, pd.Timestamp.now("UTC")).doubts
    said = f"time.zone of the map is UTC, the home's is {home}: hours of comfort and of prices are by the map's"
    assert (said in doubts) is doubted
    assert bool(doubts) is doubted


def test_a_counter_is_shown_as_it_counts_and_judged_by_its_power():
    """In J and called W a meter of 18,570 kWh stood there as 6.685e+10 W, and well."""
    rows = table()
    rules = TWO_ROOMS | {"machines": {"boiler": {"power": {"column": "meter", "unit": "Wh counter"}, "price": 0.3}}}
    for per_h, wrong in ((600.0, ""), (-600.0, "its rise of a day is a power of -600 W"), (6e9, "6e+09 W")):
        rows["meter"] = 18_570_123.0 + per_h * np.arange(len(rows)) / 12.0
        now = rows.index[-1] if rows.index.tz is not None else rows.index[-1].tz_localize("Europe/Berlin")
        found = read_points(rows, MeasurementMap.model_validate(rules), now)
        point = next(one for one in found if one.key == "machines.boiler.power")
        assert point.unit == "kWh"
        assert point.last == pytest.approx(rows["meter"].iloc[-1] / 1000.0)
        assert point.mean(-7200.0, 0.0) == pytest.approx(per_h)
        assert wrong in point.problem
        assert bool(wrong) is bool(point.problem)
    rows["meter"] = 18_570_123.0
    found = read_points(rows, MeasurementMap.model_validate(rules), now)
    assert {key: value for key, _, value, *_ in rows_of(found)}["machines.boiler.power"] == "18570 kWh"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "set_to", "unit", "value"),
    [
        ({"kind": "tank_target"}, 48.0, "°C", 48.0),
        ({"kind": "tank_target", "unit": "°F"}, 118.4, "°C", 48.0),
        ({"kind": "tank_charge"}, 0.0, "", 0.0),
    ],
)
def test_a_tank_of_hot_water_and_what_is_set_there_are_points(command, set_to, unit, value, tmp_path):
    k = np.arange(len(table()))
    rows = table().assign(T_tank=48.0 - (k % 200) / 40.0, tank_set=set_to, charges=1.0 * (k % 200 < 8), mode=0.0)
    tank = {"temperature": "T_tank", "comfort": "6:00-9:00 44-58, else 38-58"}
    rules = TWO_ROOMS | {"hot_water": tank | {"charging": "charges", "command": command | {"column": "tank_set"}}}
    written(tmp_path, rows, rules)
    result, said = told(tmp_path, "--dry-run")
    assert (result.exit_code, said["problems"], said["doubts"]) == (0, [], []), result.output
    point = {one["key"]: one for one in said["points"]}
    said_of = point["hot_water.command"]
    assert (said_of["unit"], said_of["value"]) == (unit, pytest.approx(value))
    assert point["hot_water.temperature"]["value"] > 40.0
    machine = TWO_ROOMS["machines"]["boiler"] | {"hot_water": "mode"}
    written(tmp_path, rows, TWO_ROOMS | {"machines": {"boiler": machine}})
    result, said = told(tmp_path, "--dry-run")
    assert (result.exit_code, said["problems"], said["doubts"]) == (0, [], []), result.output


def fahrenheit(rows):
    return rows.assign(T_living=1.8 * rows["T_living"] + 32.0)


def setpoint_fahrenheit(rows):
    return rows.assign(set_bath=1.8 * rows["set_bath"] + 32.0)


def swapped(rows):
    return rows.assign(T_living=rows["T_bath"], T_bath=rows["T_living"])


def measured_setpoint(rows):
    return rows.assign(set_living=rows["T_living"])


def gone(rows):
    return rows.drop(columns="T_bath")


def unavailable(rows):
    late = rows.index > rows.index[-1] - pd.Timedelta("40min")
    return rows.assign(T_bath=rows["T_bath"].where(~late))


def stopped(rows):
    return rows[rows.index < rows.index[-1] - pd.Timedelta("26h")]


def kilowatts(rows):
    return rows.assign(P=rows["P"] / 1000.0)


def outdoor_fahrenheit(rows):
    return rows.assign(out=1.8 * rows["out"] + 32.0)


def of_another_zone(rows):
    return rows.shift(freq="3h")


def of_winter_time_in_summer(rows):
    return rows.shift(freq="-1h")


def by_another_wall(rows):
    return rows.assign(out=rows["out"] + 12.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "where", "text"),
    [
        (fahrenheit, "problems", "zones.living.temperature (column T_living): 6"),
        (fahrenheit, "problems", "unit: '°F'"),
        (setpoint_fahrenheit, "problems", "in °F it were one: unit: '°F'"),
        (swapped, "problems", "rooms swapped: living and bath"),
        (measured_setpoint, "problems", "command is no command: command of living (column set_living)"),
        (gone, "problems", "zones.bath.temperature (column T_bath): nothing came of it"),
        (unavailable, "problems", "zones.bath.temperature (column T_bath): not available, for 4"),
        (stopped, "problems", "the last reading is 26"),
        (of_another_zone, "problems", "h after the clock"),
        (
            of_winter_time_in_summer,
            "doubts",
            "min old, and they come more often: is time.zone of the map, UTC, that of",
        ),
        (kilowatts, "doubts", "kW is likelier than W"),
        (outdoor_fahrenheit, "problems", "°F is likelier, a median of"),
        (by_another_wall, "doubts", "in the sun, at a warm wall"),
    ],
)
def test_what_is_wrong_is_said_and_then_nothing_is_tried(spoil, where, text, tmp_path):
    written(tmp_path, spoil(table()))
    result, said = told(tmp_path, "--dry-run")
    assert any(text in one for one in said[where]), (said["problems"], said["doubts"])
    assert result.exit_code == (1 if where == "problems" else 0)
    if where == "problems":
        assert "Would try" not in result.output
        assert said["stages"][0]["status"] == "mend"


def test_columns_named_as_another_room_and_used_twice_are_said(tmp_path):
    rows = table().rename(columns={"T_living": "Bath temperature", "T_bath": "Living temperature"})
    rules = json.loads(json.dumps(TWO_ROOMS))
    rules["zones"]["living"]["temperature"], rules["zones"]["bath"]["temperature"] = rows.columns[[2, 5]]
    written(tmp_path, rows, rules)
    _, said = told(tmp_path, "--dry-run")
    assert sum("is named as room" in one for one in said["doubts"]) == 2
    rules["zones"]["bath"]["temperature"] = rules["zones"]["living"]["temperature"]
    written(tmp_path, rows, rules)
    _, said = told(tmp_path, "--dry-run")
    assert any("the same column as zones.living.temperature" in one for one in said["doubts"])


def test_what_is_wrong_is_said_once_and_counted(tmp_path):
    written(tmp_path, stopped(table()))
    _, said = told(tmp_path, "--dry-run")
    assert not any("h old" in one for one in said["doubts"]), "what is wrong is not to be looked at besides"
    assert said["stages"][0]["words"].startswith(f"{len(said['problems'])} faults in 8 points")


def test_a_record_that_begins_now_is_no_fault(tmp_path):
    """The first start over MQTT, which has no history: steps that are not there yet were to be looked at."""
    written(tmp_path, table().tail(2))
    result, said = told(tmp_path, "--dry-run")
    assert (result.exit_code, said["problems"], said["doubts"]) == (0, [], [])
    assert said["stages"][2]["words"] == "nothing is recorded yet: let it run for days"


def test_what_is_only_heard_is_waited_for_also_where_it_was_heard_before(tmp_path, monkeypatch):
    """A second start over MQTT planned its trials from what the record held of minutes before."""
    from thermoforce_mpc.connections.registry import build_connection

    class Heard:
        def __init__(self, *named):
            self.files, self.looks = build_connection(*named), 0

        def __getattr__(self, name):
            return getattr(self.files, name)

        def begin(self):
            pass

        def measurements(self):
            self.looks += 1
            rows = table()
            rows.index = pd.date_range(end=pd.Timestamp.now("UTC"), periods=len(rows), freq="1s", name="time")
            return rows.iloc[: -20 if self.looks < 3 else None]

    monkeypatch.setattr("thermoforce_mpc.connections.registry.build_connection", Heard)
    monkeypatch.setattr("thermoforce_mpc.cli.live.commission.LOOK_S", 0.01)
    written(tmp_path, table())
    result, said = told(tmp_path, "--dry-run")
    assert "Waits up to 60 s for outdoor" in result.output
    assert all(point["age_s"] < 120 for point in said["points"])


def test_names_with_spaces_are_found_and_said_as_a_shell_takes_them(tmp_path):
    written(tmp_path, table())
    folder = tmp_path / "our house"
    folder.mkdir()
    _, said = told(tmp_path, "--dry-run", "--model", str(folder))
    assert said["stages"][3]["words"].startswith(f"{folder}: "), "it looked into the folder"
    assert f"--out '{folder}'" in said["stages"][3]["command"]


def test_the_one_model_that_is_here_is_looked_at_without_a_word(tmp_path, monkeypatch):
    """The tutorial calls it my_export: the next commands named another one, which was not there."""
    from simple_house import simple_model

    written(tmp_path, table())
    monkeypatch.chdir(tmp_path)
    for models, named in (([], "my_house"), (["my_export"], "my_export"), (["other"], "my_house")):
        for name in models:
            simple_model().save(tmp_path / name)
        said = tmp_path / "said.json"
        CliRunner().invoke(cli, ["commission", "connection.yaml", "--dry-run", "--json", str(said)])
        model, shadow = json.loads(said.read_text())["stages"][3:5]
        assert named in model["words"], models
        assert f"--model {named} " in shadow["command"]


def test_days_of_a_shadow_count_for_their_own_model(tmp_path):
    from simple_house import simple_model

    from controllers.state_classes import model_key

    model = simple_model()
    model.save(tmp_path / "m")
    control = tmp_path / "control"
    control.mkdir()
    home, rules = by_setpoint()
    every = MeasurementMap.model_validate(rules)
    found = replace(read_house(LiveBuilding(home, every, 900.0), every, home.now()), measured=None)
    book = CommissioningBook(tmp_path / "none.json", {})
    files = CommissioningFiles("c.yaml", "map.yaml", "out", str(tmp_path / "m"), str(control), "house.csv")
    told_days = {"said": "would have saved 3.2", "days": [{}] * 7, "of": "k"}
    seen = {}
    for of in (model_key(load_model(tmp_path / "m")), "another", None):
        (control / "shadow.json").write_text(json.dumps(told_days | ({} if of is None else {"model": of})))
        seen[of] = stages(found, [], book, files)[4]
    assert [(one.status, one.words.partition(";")[0]) for one in seen.values()] == [
        ("done", "7 days"), ("later", "7 days in which nothing is set"), ("later", "7 days in which nothing is set"),
    ]  # fmt: skip
    assert "another model" in seen["another"].words


def test_without_a_terminal_it_stops_with_what_to_do(tmp_path):
    written(tmp_path, table())
    result, said = told(tmp_path)
    assert isinstance(result.exception, ConfigError)
    assert "--yes" in str(result.exception)
    assert said["trials"] == {}
    assert not (tmp_path / "levels.json").exists()


@pytest.mark.slow
def test_trials_are_kept_shown_and_not_repeated(tmp_path, monkeypatch):
    monkeypatch.setattr("thermoforce_mpc.live.trial.LEAST_S", 0.3)
    monkeypatch.setattr("thermoforce_mpc.live.trial.LOOK_S", 0.1)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    written(tmp_path, table())
    result, said = told(tmp_path, "--yes")
    assert result.exit_code == 0, result.output
    # What reads these files would set the house; nobody does, so nothing is read back.
    assert {one["status"] for one in said["trials"].values()} == {"not read back"}
    assert all("given back" in one["back"] for one in said["trials"].values())
    assert json.loads((tmp_path / "levels.json").read_text())["levels"] == {"bath": None}
    assert [stage["status"] for stage in said["stages"]][:3] == ["done", "done", "next"]
    report = (tmp_path / "out" / "report.md").read_text()
    assert "| zones.bath.temperature | T_bath |" in report
    assert "**record**: next" in report
    before = (tmp_path / "levels.json").stat().st_mtime_ns
    again, said = told(tmp_path, "--yes")
    assert (again.exit_code, again.output.count("Tried before")) == (0, 2)
    assert (tmp_path / "levels.json").stat().st_mtime_ns == before
    written(tmp_path, table(), TWO_ROOMS | {"step": "30min"})
    anew, said = told(tmp_path, "--yes")
    assert "tried anew" in anew.output
    assert (tmp_path / "levels.json").stat().st_mtime_ns > before
    _, said = told(tmp_path, "--dry-run")
    assert len(said["trials"]) == 2


class Held:
    """A home whose devices say what they hold and can be put back to it."""

    def __init__(self, home) -> None:
        self.home, self.put, self.left, self.deaf = home, [], 0, False

    def __getattr__(self, name):
        return getattr(self.home, name)

    def present(self, names):
        return {} if self.deaf else dict.fromkeys(names, float(self.home.rows[-1][COLUMN_OF[type(self.home)]]))

    def put_back(self, held) -> None:
        self.put.append(dict(held))
        self.home.told = None

    def leave(self) -> None:
        self.left += 1


COLUMN_OF = {TimedHome: "set", HomeByCurve: "offset"}


def of(home, rules):
    """Building, plans and the reading of points."""
    rules = MeasurementMap.model_validate(rules)
    building = LiveBuilding(home, rules, 900.0)
    found = read_house(building, rules, home.now())
    assert not found.problems
    plans = planned_trials(building, found.points, found.bounds_C, {})

    def read(now):
        return read_points(building.table(), rules, now)

    return building, plans, read


def by_setpoint():
    return TimedHome(3), rules_of({name: name for name in SENSORS})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "words"),
    [
        (by_setpoint, "its set-point from 19 °C to 22 °C for 30 min"),
        (lambda: (HomeByCurve(5, 3), RULES), "the offset of the heating curve from +2 K to +3 K for 30 min"),
        (
            lambda: (HomeByCurve(5, 3, set_by="sg_ready"), SG_RULES),
            "SG-Ready from 2 (normal) to 3 (recommended) for 10 min",
        ),
        (
            lambda: (HomeByCurve(5, 3, set_by="flow_temperature"), FLOW_RULES),
            "the flow temperature from 41 °C flow to 43 °C flow for 30 min",
        ),
        (
            lambda: (HomeByCurve(5, 3, set_by="enable"), ENABLE_RULES),
            "an enable contact from enabled to off for 30 min",
        ),
    ],
)
def test_a_command_is_moved_answered_and_put_back(made, words, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    home, rules = made()
    building, (plan,), read = of(home, rules)
    assert words in plan.in_words
    outcome = tried(building, plan, read=read, clock=home, sets="home")
    assert outcome.status == "answered", outcome.words
    assert not outcome.doubts
    assert [value for *_, value in home.written] == [plan.value, None]
    assert home.told is None


def test_a_command_of_another_room_is_noticed(tmp_path, monkeypatch):
    """What moves the room is not what the map says moves it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    home, rules = by_setpoint()
    rules = json.loads(json.dumps(rules))
    rules["zones"] = {"other": {"temperature": "still", "lower": 20.0, "upper": 23.0}, **rules["zones"]}
    rules["actuators"]["actuator"] |= {"zone": "other", "level": "idle"}
    rules["actuators"]["second"] = {"zone": "zone", "level": "u"}
    measurements = home.measurements

    def with_another():
        rows = measurements()
        k = np.arange(len(rows))
        return rows.assign(still=21.0 + 0.1 * np.sin(k / 9.0), idle=np.where(k % 40 < 20, 0.3, 0.31))

    home.measurements = with_another
    building, plans, read = of(home, rules)
    outcome = tried(building, plans[0], read=read, clock=home, sets="home")
    assert any("actuators.second.level answered in its place" in one for one in outcome.doubts), outcome


@pytest.mark.parametrize("how", [KeyboardInterrupt, SystemExit])
def test_an_interrupt_puts_it_back(how, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    home, rules = by_setpoint()
    held = Held(home)
    building, (plan,), read = of(held, rules)

    def stop(row):
        if row["set"] == plan.value:
            raise how

    home.on_row = stop
    with pytest.raises(how):
        tried(building, plan, read=read, clock=home, sets="home")
    assert held.put == [{"actuator": 19.0}]


def test_what_somebody_sets_meanwhile_stays(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    home, rules = by_setpoint()
    held = Held(home)
    building, (plan,), read = of(held, rules)
    home.on_row = lambda row: setattr(home, "told", 23.5)
    outcome = tried(building, plan, read=read, clock=home, sets="home")
    assert (held.put, held.left, home.told) == ([], 1, 23.5)
    assert "23.5 °C was set by hand meanwhile" in outcome.back
    assert any("somebody set it" in one for one in outcome.doubts)


def test_what_the_device_makes_of_a_command_is_put_back_and_said(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    home, rules = by_setpoint()
    held = Held(home)
    building, (plan,), read = of(held, rules)
    held.write = lambda levels, seconds: home.write(dict.fromkeys(levels, plan.value - 1.0), seconds)
    held.present = lambda names: dict.fromkeys(names, home.rows[-1]["set"] if home.told is None else home.told)
    outcome = tried(building, plan, read=read, clock=home, sets="home")
    assert held.put == [{"actuator": 19.0}]
    assert any("it made that of the command" in one for one in outcome.doubts)


def test_one_that_is_not_taken_is_said_and_put_back(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    home, rules = by_setpoint()
    building, (plan,), read = of(home, rules)
    write, failed = home.write, []

    def fails_once(levels, seconds):
        if not failed:
            failed.append(levels)
            raise PlantError("climate.hall is off")
        write(levels, seconds)

    home.write = fails_once
    outcome = tried(building, plan, read=read, clock=home, sets="home")
    assert (outcome.status, outcome.is_done) == ("not taken", False)
    assert "climate.hall is off" in outcome.words
    assert [value for _, value in home.written] == [None]


def test_one_that_cannot_be_put_back_is_said_with_what_to_set(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    home, rules = by_setpoint()
    building, (plan,), read = of(home, rules)

    def fails(levels, seconds):
        raise PlantError("no route")

    home.write = fails
    with pytest.raises(PlantError, match="set it back to 19 °C by hand"):
        tried(building, plan, read=read, clock=home, sets="home")


def test_an_interrupt_between_two_attempts_to_put_it_back_costs_one(tmp_path, monkeypatch):
    """The pause after an attempt that failed is no place where a command stays set."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    home, rules = by_setpoint()
    building, (plan,), read = of(home, rules)
    write, wait, failed = home.write, home.wait_until, []

    def fails_to_give_back_once(levels, seconds):
        if seconds == 0.0 and not failed:
            failed.append(home.now())
            raise PlantError("no route")
        write(levels, seconds)

    def interrupted_then(at):
        if len(failed) == 1:
            failed.append(at)
            raise KeyboardInterrupt
        wait(at)

    home.write, home.wait_until = fails_to_give_back_once, interrupted_then
    with pytest.raises(KeyboardInterrupt):
        tried(building, plan, read=read, clock=home, sets="home")
    assert len(failed) == 2
    assert [value for *_, value in home.written] == [plan.value, None]


_TRIES = """
import sys
sys.argv = ["tf-mpc", "commission", "connection.yaml", "--yes", "--out", "out", "--watchdog", "1"]
import thermoforce_mpc.live.trial as trial
trial.LEAST_S, trial.BEYOND_S = float({seconds}), 0.5
from thermoforce_mpc.cli import main
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGTERM])
def test_killed_in_a_trial_the_command_is_given_back_and_the_next_start_says_so(sent, tmp_path):
    written(tmp_path, table())
    levels = tmp_path / "levels.json"
    seconds = 2 if sent is signal.SIGKILL else 60
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    with subprocess.Popen(
        [sys.executable, "-c", _TRIES.format(seconds=seconds)], cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL
    ) as process:
        wait_for("the trial", levels.exists)
        assert 17.0 <= json.loads(levels.read_text())["levels"]["living"] <= 24.0
        assert "is under way, by another process" in told(tmp_path, "--dry-run")[0].output
        process.send_signal(sent)
    wait_for("it is given back", lambda: json.loads(levels.read_text())["levels"]["living"] is None)
    under_way = json.loads((tmp_path / "out" / "commission.json").read_text())["under_way"]
    assert bool(under_way) == (sent is signal.SIGKILL)
    if under_way:
        levels.unlink()
        result, _ = told(tmp_path)
        assert "was not ended: given back to its own control" in result.output
        assert json.loads(levels.read_text())["levels"] == {"living": None}
        assert json.loads((tmp_path / "out" / "commission.json").read_text())["under_way"] == {}
