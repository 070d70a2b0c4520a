"""`tf-mpc plan` and `tf-mpc control` say and write commands with their units; a drawn house takes set-points."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pandas as pd
import pytest
import yaml
from click.testing import CliRunner
from home_by_setpoint import RULES, HomeBySetpoint
from pydantic import ValidationError
from simple_house import simple_model

import thermoforce_mpc as tf
from controllers.mpc.config import MPCConfig
from controllers.state_classes import controller_key
from thermoforce_mpc.cli import cli
from thermoforce_mpc.connections.files import FilesConnection
from thermoforce_mpc.errors import DataError, InputError
from thermoforce_mpc.live import LiveBuilding
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.plants.rooms import house_of_rooms


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder, home = tmp_path_factory.mktemp("home"), HomeBySetpoint(days=14)
    simple_model().save(folder / "model")
    home.measurements().to_csv(folder / "house.csv", index=False)
    home.forecast().to_csv(folder / "tomorrow.csv")
    (folder / "map.yaml").write_text(yaml.safe_dump(RULES))
    return folder


def run(files, *words):
    given = ["--model", files / "model", "--map", files / "map.yaml", "--data", files / "house.csv"]
    given += ["--forecast", files / "tomorrow.csv", "--hours", "12", *words]
    return CliRunner().invoke(cli, ["plan", *map(str, given)])


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".json", ".csv"])
def test_commands_are_printed_and_written_with_their_units(files, suffix):
    out = files / f"commands{suffix}"
    result = run(files, "--commands", out)
    assert result.exit_code == 0, result.output
    assert "Commands to set" in result.output
    assert "leaving it alone (90 % band" in result.output
    rows = json.loads(out.read_text())["commands"] if suffix == ".json" else pd.read_csv(out).to_dict("records")
    assert {row["unit"] for row in rows} == {"°C"}
    assert all(row["text"] == f"{row['value']:.10g} °C" and row["text"] in result.output for row in rows)
    assert rows[0]["from"] == "2025-01-29T00:00:00+00:00"


@pytest.mark.slow
def test_a_thermostat_in_fahrenheit_is_read_and_told_in_its_degrees(files, tmp_path):
    """The same home: what is told differs by the steps of the device alone, and saves as much."""
    rows, saved = {}, {}
    for unit, resolution in (("°C", 0.5), ("°F", 1.0)):
        rules = json.loads(json.dumps(RULES))
        own = rules["actuators"]["actuator"]["command"]
        own |= {"unit": unit, "resolution": resolution}
        table = pd.read_csv(files / "house.csv")
        if unit == "°F":
            table[own["column"]] = (1.8 * table[own["column"]] + 32.0).round()
        table.to_csv(tmp_path / "house.csv", index=False)
        (tmp_path / "map.yaml").write_text(yaml.safe_dump(rules))
        given = ["--model", files / "model", "--map", tmp_path / "map.yaml", "--data", tmp_path / "house.csv"]
        given += ["--forecast", files / "tomorrow.csv", "--hours", "12", "--commands", tmp_path / "c.json"]
        assert CliRunner().invoke(cli, ["plan", *map(str, given)]).exit_code == 0
        plan = json.loads((tmp_path / "c.json").read_text())
        rows[unit], saved[unit] = plan["commands"], plan["saving"]["saved"]
    told = rows["°F"]
    assert {row["unit"] for row in told} == {"°F"}
    assert all(abs(row["value"] - round(row["value"])) < 1e-6 and 59 < row["value"] < 86 for row in told)
    assert all(row["text"] == f"{row['value']:.0f} °F" for row in told)
    assert saved["°F"] == pytest.approx(saved["°C"], rel=0.1)
    assert saved["°C"] > 0.5


def test_what_may_not_be_acted_on_has_no_value(files):
    thermal = simple_model()
    unjudged = replace(thermal, cards=(replace(thermal.cards[0], source="a record"),))
    unjudged.save(files / "unjudged")
    result = run(files, "--commands", files / "none.json", "--model", files / "unjudged")
    assert result.exit_code == 4
    assert not (files / "none.json").exists()


def test_a_command_that_is_left_alone_has_no_value(files, tmp_path):
    """Nothing is saved where energy costs nothing and any temperature will do."""
    free = pd.read_csv(files / "tomorrow.csv").assign(price=0.0, low=10.0, high=30.0)
    free.to_csv(tmp_path / "tomorrow.csv", index=False)
    out = ["--commands", tmp_path / "commands.csv", "--out", tmp_path / "plan.json"]
    result = run(files, "--forecast", tmp_path / "tomorrow.csv", *out)
    assert result.exit_code == 0, result.output
    assert "not better than leaving the building alone" in result.output
    assert "\nNot set: the commands that were found would save 0.00 against leaving it alone" in result.output
    (row,) = json.loads((tmp_path / "plan.json").read_text())["commands"]
    assert row["value"] is None
    (line,) = pd.read_csv(tmp_path / "commands.csv", keep_default_na=False).to_dict("records")
    assert line["value"] == ""
    assert {row["text"], line["text"]} == {"its own control"}


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ({"kind": "setpoint"}, "are no set temperature between 0 and 40 °C (first 7"),
        ({"kind": "sg_ready"}, "are no command between 1 and 4 (first 7"),
        ({"kind": "enable"}, "are no command between 0 and 1 (first 7"),
        ({"kind": "setpoint", "column": "own", "usual": "set"}, "actuators.actuator.command.usual (column set): 100 %"),
    ],
)
def test_a_column_that_cannot_be_the_command_is_refused(files, command, said):
    column = RULES["actuators"]["actuator"]["command"]["column"]
    table = pd.read_csv(files / "house.csv").tail(200)
    table["set"], table["own"] = (1.8 * table[column] + 32.0).round().clip(68), table[column]
    rules = RULES | {"actuators": {"actuator": {"level": "u", "command": {"column": "set"} | command}}}
    table.to_csv(files / "odd.csv", index=False)
    with pytest.raises(DataError, match=re.escape(said)) as refused:
        tf.read_measurements(files / "odd.csv", rules)
    fahrenheit = "they look like °F: set unit: '°F'"
    assert str(refused.value).endswith(fahrenheit if command["kind"] == "setpoint" else "check column and unit")


def test_commands_that_the_map_does_not_name_are_refused(files, tmp_path):
    rules = RULES | {"actuators": {"actuator": {"level": "u"}}}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(rules))
    result = run(files, "--commands", tmp_path / "c.json", "--map", tmp_path / "map.yaml")
    assert "names no command of an actuator" in str(result.exception or result.output)


@pytest.mark.slow
def test_a_drawn_house_keeps_the_set_points_that_it_is_told():
    plant = house_of_rooms("house:2rooms:31")
    plant.reset(20 * 86400.0, 86400.0)
    for _ in range(36):
        plant.advance(None, 3600.0, (19.0, 22.0))
    record = plant.past(3600.0)
    assert record.T_zone_C[0, -6:].mean() < record.T_zone_C[1, -6:].mean() - 1.0
    assert abs(record.T_zone_C[0, -6:].mean() - 19.0) < 0.6
    assert record.u[1, -24:].mean() > record.u[0, -24:].mean()
    with pytest.raises(InputError, match="its thermostat takes a set-point from 5 to 30 °C"):
        plant.advance(None, 3600.0, (19.0, 40.0))


@pytest.mark.slow
def test_a_higher_curve_brings_hotter_water_and_more_heat_to_all_rooms():
    taken = []
    for offset_K in (0.0, 5.0):
        plant = house_of_rooms("house:2rooms:31")
        plant.reset(80 * 86400.0, 86400.0)
        plant.curve_offset_K = offset_K
        for _ in range(6):
            done = plant.advance((1.0, 1.0), 3600.0)
        taken.append((done.heat_W, done.points["T_supply_C"]))
    assert (taken[1][0] > taken[0][0]).all()
    assert taken[1][1] > taken[0][1]


@pytest.mark.slow
def test_a_torn_last_line_does_not_keep_control_from_its_commands(files, tmp_path):
    """As after a power failure, when it is started again."""
    whole = (files / "house.csv").read_text()
    house = FilesConnection(str(tmp_path / "house.csv"))
    building = LiveBuilding(house, MeasurementMap.model_validate(RULES), 3600.0)
    for torn in ("2025-01-29 00:0", "2025-01-29 00:01:00+00:00,20.", "\0\0\0\0"):
        (tmp_path / "house.csv").write_text(whole + torn)
        assert building.commands()["actuator"].last == 19.0


def test_what_was_kept_is_not_gone_on_from_with_other_commands():
    """A set-point of 21 °C is no offset of the curve."""
    model = simple_model()
    offset = RULES | {"actuators": {"actuator": {"level": "u", "command": {"kind": "curve_offset", "column": "set"}}}}
    commands = [
        {name: one.command for name, one in MeasurementMap.model_validate(rules).actuators.items()}
        for rules in (RULES, offset, offset)
    ]
    setpoint, curve, again = (controller_key(model, MPCConfig(), one) for one in commands)
    assert setpoint != curve == again
    assert controller_key(model, MPCConfig()) not in (setpoint, curve)


def test_one_command_has_one_value():
    actuators = {name: RULES["actuators"]["actuator"] | {"level": name} for name in ("one", "other")}
    with pytest.raises(ValidationError, match="column 'set' is the command of one too"):
        MeasurementMap.model_validate(RULES | {"actuators": actuators})
