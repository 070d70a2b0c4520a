"""`tf-mpc init` and `tf-mpc schema`: files to start from, and what editors know of them."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import jsonschema
import pytest
from click.testing import CliRunner

from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.inside.schemas import KINDS, schema_of, schema_text
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.files import configs_folder, named_configs
from thermoforce_mpc.plants.testcases import load_scenario, load_testcase
from thermoforce_mpc.scenario.settings import parse_value, read_yaml

SHIPPED = [(kind, path) for kind in KINDS for path in named_configs(f"{kind}s").values()]


@cache
def validator(kind: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(schema_of(kind))


def tf_mpc(*words: str):
    return CliRunner().invoke(cli, list(words))


def wrong(kind: str, text: str) -> list[str]:
    """Where the schema of a kind of file has something against a text."""
    return [".".join(map(str, error.absolute_path)) for error in validator(kind).iter_errors(parse_value(text, kind))]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_schemas_that_ship_are_those_of_the_models(kind):
    path = configs_folder() / "schema" / f"{kind}.json"
    assert path.read_text(encoding="utf-8") == schema_text(kind), f"tf-mpc schema {kind} --out {path}"
    jsonschema.Draft202012Validator.check_schema(json.loads(schema_text(kind)))


@pytest.mark.parametrize(("kind", "path"), SHIPPED, ids=[path.stem for _, path in SHIPPED])
def test_every_file_that_ships_names_its_schema_and_fulfils_it(kind, path):
    named = re.match(r"# yaml-language-server: \$schema=(\S+)\n", path.read_text(encoding="utf-8"))
    assert named, path
    assert (path.parent / named[1]).resolve() == configs_folder() / "schema" / f"{kind}.json"
    assert not [error.message for error in validator(kind).iter_errors(dict(read_yaml(path)))]


def test_there_are_files_of_every_kind_but_maps():
    assert {kind for kind, _ in SHIPPED} == set(KINDS) - {"map"}


@pytest.mark.parametrize(
    ("kind", "text", "places"),
    [
        ("scenario", "testcase: x\nperiod: 44", []),
        ("scenario", "testcase: x\nplant: {kind: somebodys, options: {leak: 1}}", []),
        ("scenario", "period: 44", [""]),
        ("scenario", "testcase: x\nperiods: 44", [""]),
        ("scenario", "testcase: x\nprice: free", ["price"]),
        ("scenario", "testcase: x\ncontroller: {options: {horizon_h: 36}}", []),
        ("scenario", "testcase: x\ncontroller: {options: {horizon: 36}}", ["controller.options"]),
        ("scenario", "testcase: x\ncontroller: {options: {watch: {enabled: x}}}", ["controller.options.watch.enabled"]),
        ("scenario", "testcase: x\ncontroller: {name: thermostat, options: {horizon_h: 36}}", ["controller.options"]),
        ("scenario", "testcase: x\ncontroller: {name: plugins, options: {anything: 1}}", []),
        ("scenario", "testcase: x\nidentification: {options: {oder: 2}}", ["identification.options"]),
        ("comparison", "variants: {a: {controller: pi, options: {setback: 1}}}", ["variants.a.options"]),
        ("map", "outdoor: T_out\nzones: {room: {temperature: T, lower: 20}}", []),
        ("map", "outdoor: {column: T_out, unit: furlong}\nzones: {room: {temperature: T}}", ["outdoor"]),
    ],
)  # fmt: skip
def test_a_schema_says_where_something_is_wrong(kind, text, places):
    assert wrong(kind, text) == places


def test_schema_command(tmp_path):
    assert json.loads(tf_mpc("schema", "map").output) == schema_of("map")
    assert tf_mpc("schema", "testcase", "--out", str(tmp_path / "t.json")).exit_code == 0
    assert (tmp_path / "t.json").read_text(encoding="utf-8") == schema_text("testcase")
    assert "did you mean 'scenario'" in str(tf_mpc("schema", "scenarios").exception)


@pytest.mark.slow
@pytest.mark.parametrize(
    "testcase", [*named_configs("testcases"), "energyplus:heating_chicago", "house:3rooms", "office:3rooms"]
)
def test_a_scenario_to_start_from_is_whole_and_valid(tmp_path, testcase):
    done = tf_mpc("init", str(tmp_path / "new"), "--testcase", testcase)
    assert done.exit_code == 0, done.output
    path = tmp_path / "new" / "scenario.yaml"
    scenario = load_scenario(path, {})
    assert scenario.testcase == testcase
    if "energyplus" not in testcase:  # EnergyPlus may not be installed
        Experiment.of(scenario)
    assert (scenario.plant.kind == "boptest") == ("set plant.url" in done.output)
    text = path.read_text(encoding="utf-8")
    assert not wrong("scenario", text)
    every_key = re.sub(
        r"^( *)# (\w+: \S)", r"\1\2", re.sub(r"^ *# \w+: (?!null$)[a-z ].*[^}\d\n]$", "", text, flags=re.M), flags=re.M
    )
    found = parse_value(every_key, "all keys")
    assert set(found) == set(type(scenario).model_fields)
    assert set(found["identification"]) >= {"days", "probing", "options"}
    assert not wrong("scenario", every_key)
    schema = json.loads((tmp_path / "new" / "schema" / "scenario.json").read_text(encoding="utf-8"))
    assert schema == schema_of("scenario")


@pytest.mark.slow
def test_what_init_writes_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "house.csv").write_text(
        "time,T_room,T_out,valve\n2024-01-01 00:00,20.5,3.0,10\n2024-01-01 01:00,21.0,3.1,0\n"
    )
    assert tf_mpc("init", "--copy-testcase", "--data", "house.csv").exit_code == 0
    assert load_testcase("testcase.yaml") == load_testcase("bestest_hydronic_heat_pump")
    assert tf_mpc("validate", "testcase.yaml").exit_code == 0
    assert not wrong("map", Path("map.yaml").read_text(encoding="utf-8"))
    for kind in ("scenario", "testcase", "map"):
        named = Path(f"{kind}.yaml").read_text(encoding="utf-8").splitlines()[0].rpartition("=")[2]
        assert json.loads(Path(named).read_text(encoding="utf-8")) == schema_of(kind)
    quick = ["--controller", "native", "--baselines", "", "--days", "0.25", "--quiet", "--out", "done"]
    done = tf_mpc("run", "--config", "scenario.yaml", *quick)
    assert done.exit_code == 0, done.output
    assert json.loads(Path("done/kpis.json").read_text())["testcase"] == "bestest_hydronic_heat_pump"
    before = Path("scenario.yaml").read_bytes()
    assert "never overwritten" in str(tf_mpc("init").exception)
    assert Path("scenario.yaml").read_bytes() == before


def test_what_cannot_be_begun_with(tmp_path):
    for words, told in (
        (("--testcase", "nowhere"), "unknown testcase 'nowhere'"),
        (("--testcase", "house:3rooms", "--copy-testcase"), "is made, not read from a file"),
    ):
        done = tf_mpc("init", str(tmp_path / "new"), *words)
        assert isinstance(done.exception, ConfigError)
        assert told in str(done.exception)
    assert not (tmp_path / "new").exists()
