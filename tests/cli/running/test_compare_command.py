"""`tf-mpc compare` end to end: parallel processes, results kept, failures told apart, nothing run twice."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner
from emulator_service import running_emulator_service

from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.running.comparing import Axes, axes_from
from thermoforce_mpc.comparison.cells import ComparisonFile, Variant, expand
from thermoforce_mpc.comparison.store import Ran, Store
from thermoforce_mpc.comparison.tasks import failure
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.testcases import load_scenario
from thermoforce_mpc.scenario.scenario import Scenario

TESTCASE = "bestest_hydronic_heat_pump"


def tf_mpc(*words: str):
    return CliRunner().invoke(cli, list(words))


@pytest.mark.slow
def test_cells_run_once_failed_ones_again_and_the_rest_goes_on(tmp_path, request):
    out, model = tmp_path / "comparison", tmp_path / "model"
    model.mkdir()
    (model / "manifest.json").write_text("not a model", encoding="utf-8")
    contestants = {
        "native": {"controller": "native"},
        "thermostat": {"controller": "thermostat"},
        "broken": {"controller": "rc_mpc", "identification": {"model": str(model)}},
    }
    variants = tmp_path / "mine.yaml"
    variants.write_text(json.dumps({"variants": contestants, "windows": [44]}), encoding="utf-8")
    call = ("compare", "--testcase", TESTCASE, "--variants", str(variants), "--days", "0.125", "--jobs", "2")
    done = tf_mpc(*call, "--out", str(out))
    assert done.exit_code == 3, done.output
    assert done.output.count("FAILED  [") == 1
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    by_name = {row["controller"]: row for row in results["rows"]}
    assert by_name["native"]["cost_tot"] > 0
    assert by_name["thermostat"]["cost_tot"] > 0
    assert by_name["broken"]["status"] == "failed"
    assert str(model) in by_name["broken"]["reason"]
    request.getfixturevalue("computed_here")  # what is left; the first were cells in two processes
    again = tf_mpc(*call, "--out", str(out))
    assert again.exit_code == 3, again.output
    assert "3 cells: 2 already done, 1 to run" in again.output
    del contestants["broken"]
    variants.write_text(json.dumps({"variants": contestants, "windows": [44]}), encoding="utf-8")
    without = tf_mpc(*call, "--out", str(out))
    assert without.exit_code == 0, without.output
    assert (out / "comparison.html").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_controllers_are_compared_on_a_service(tmp_path):
    words = ("--controllers", "thermostat", "--windows", "44", "--days", "0.25", "--jobs", "1", "--out", str(tmp_path))
    with running_emulator_service() as url:
        done = tf_mpc("compare", "--testcase", TESTCASE, "--url", url, *words)
    assert done.exit_code == 0, done.output
    (row,) = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["rows"]
    assert row["cost_tot"] > 0
    gone = tf_mpc("compare", "--testcase", TESTCASE, "--url", url, *words)
    assert "1 already done" in gone.output


def test_only_whole_and_finished_files_count_as_done(tmp_path):
    (cell,) = expand(Scenario(testcase=TESTCASE), {"n": Variant(controller="native")}, ["44"], ["constant"])
    store = Store(tmp_path)
    store.create()
    assert store.finished(cell) is None
    store.write(cell, Ran(failure(cell, "because")))
    assert store.finished(cell) is None
    store.record_path(cell.key).write_text('{"format": 1, "key": "', encoding="utf-8")
    assert store.finished(cell) is None
    store.write(cell, Ran(failure(cell, "") | {"status": "done"}))
    assert store.finished(cell) is not None
    (renamed,) = expand(Scenario(testcase=TESTCASE), {"m": Variant(controller="native")}, ["44"], ["constant"])
    found = store.finished(renamed)
    assert found is not None
    assert found["variant"] == "m", "the same run under another name is the same run"
    assert not [path for path in (tmp_path / "runs").rglob("*") if path.name.startswith(".")]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--windows", "someday"), "someday"),
        (("--prices", "cheap"), "unknown 'cheap'"),
        (("--controllers", "thermostat,thermostat"), "given twice"),
        (("--forecast-uncertainty", "huge"), "unknown 'huge'"),
        (("--variants", "ablatio"), "ablatio"),
    ],
)
def test_bad_input_is_refused_before_anything_is_made(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    done = tf_mpc("compare", "--testcase", TESTCASE, *words)
    assert message in str(done.exception)
    assert not list(tmp_path.iterdir())


GIVEN_NONE = {"windows": None, "tariffs": None, "forecast_uncertainty": None}


@pytest.mark.parametrize(
    ("scenario", "axes"),
    [
        ({}, Axes(("peak_heat_day", "typical_heat_day"), ("constant",), ("none",))),
        (
            {"period": 44, "price": "dynamic", "plant": {"forecast_uncertainty": "high"}},
            Axes(("44",), ("dynamic",), ("high",)),
        ),
        (
            {"testcase": "energyplus:cooling_phoenix"},
            Axes(("peak_cool_day", "typical_cool_day"), ("constant",), ("none",)),
        ),
    ],
)
def test_what_the_scenario_says_is_compared(scenario, axes):
    base = load_scenario(None, {"testcase": TESTCASE} | scenario)
    assert axes_from(GIVEN_NONE, base) == axes
    given = {"windows": "58", "tariffs": "constant,dynamic", "forecast_uncertainty": "low"}
    assert axes_from(given, base) == Axes(("58",), ("constant", "dynamic"), ("low",))


def test_a_file_of_variants_does_not_replace_what_the_scenario_says():
    file = ComparisonFile(variants={"n": Variant(controller="native")}, windows=(44, 58), prices=("constant",))
    assert axes_from(GIVEN_NONE, Scenario(testcase=TESTCASE), file) == Axes(("44", "58"), ("constant",), ("none",))
    base = Scenario(testcase=TESTCASE, price="dynamic")
    with pytest.raises(ConfigError, match=r"price: the scenario has dynamic.*prices: constant; say with --prices"):
        axes_from(GIVEN_NONE, base, file)
    assert axes_from(GIVEN_NONE | {"tariffs": "dynamic"}, base, file).prices == ("dynamic",)


def test_a_sweep_refuses_what_it_cannot_vary(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words, message in (
        (("--over", "colour"), "no such numeric option"),
        (("--over", "fallback.safe_C"), "no such numeric option"),
        (("--values", "1,x"), "'x' is not a number"),
        (("--values", ","), "--values"),
        (("--over", "horizon_h"), "--values: missing; give values of horizon_h"),
    ):
        done = tf_mpc("sweep", "--testcase", TESTCASE, *words)
        assert message in str(done.exception), words
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(("option", "searched"), [((), True), (("--no-equal-comfort",), False)])
def test_a_thermostat_as_comfortable_is_searched_unless_it_is_refused(option, searched, tmp_path, monkeypatch):
    asked = []

    class Search:
        def __init__(self, *_):
            asked.append(True)

        def beside(self, cells, records):
            return records

    monkeypatch.setattr("thermoforce_mpc.cli.running.comparing.EqualComfort", Search)
    words = ("--controllers", "thermostat", "--windows", "44", "--days", "0.1", "--jobs", "1", "--quiet")
    done = tf_mpc("compare", "--testcase", TESTCASE, *words, "--out", str(tmp_path / "c"), *option)
    assert done.exit_code == 0, done.output
    assert bool(asked) is searched
