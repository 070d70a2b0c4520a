"""`tf-mpc explain`: what a run decided at an instant, from its journal."""

from __future__ import annotations

import gc
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import two_houses
from click.testing import CliRunner
from simple_house import SimpleHouse, simple_model

from thermoforce_mpc import report
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary
from thermoforce_mpc.data.clock import seconds_of, words_of
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.experiment.explaining import decision_at
from thermoforce_mpc.loop.loop import KeptSteps
from thermoforce_mpc.plants.registry import ChosenPlant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.records.journal import Journal, JournalError, read_run
from thermoforce_mpc.records.run_folder import sole_use
from thermoforce_mpc.records.told_steps import told_run


def call(*words: object):
    return CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Half a day of the MPC and the thermostat on the simple house, from day 10."""
    root = tmp_path_factory.mktemp("explained")
    simple_model().save(root / "model")
    words = ["--model", root / "model", "--baselines", "thermostat", "--days", "0.5", "--out", root / "run"]
    settings = ["--set", "controller.options.gate.enabled=false", "--set", "step_s=3600"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ChosenPlant, "build", lambda *_: SimpleHouse())
        patch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())
        done = call("run", "--testcase", "bestest_hydronic_heat_pump", *words, *settings)
    assert done.exit_code == 0, done.output
    return root / "run"


@pytest.mark.slow
def test_a_step_is_explained_as_it_was_recorded(folder, tmp_path):
    steps = (folder / "steps.csv").read_text().splitlines()
    done = call("explain", folder, "--at", "10 04:30", "--hours", "3", "--json", tmp_path / "told.json")
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "told.json").read_text())
    assert told["index"] == 4
    assert told["time_s"] == 10 * DAY_S + 4 * HOUR_S
    assert told["why"] in steps[5]
    assert f"why: {told['why']}" in done.output
    assert "step 4: day 10 04:00 (878400 s)" in done.output
    assert "acted: solved" in done.output
    table = done.output.split("\nPlan", 1)[1].split("Alternatives", 1)[0]
    assert table.count("day 10 0") == 3, "three hours of the plan"
    assert "…" not in done.output, "no figure is cut off in a narrow terminal"
    last = json.loads((folder / "kpis.json").read_text())
    assert last["controller"] in done.output


def test_the_plan_and_what_came_of_it_are_those_of_the_run(folder):
    decision = decision_at(folder, "10 03:00")
    later = decision_at(folder, "10 04:00")
    assert decision.step.after[-1].time_s == later.step.time_s
    assert decision.step.after[-1].T_zone_C == later.step.before.T_zone_C
    # The house is the model's own, so the plan comes true where the block is a whole step.
    assert decision.T_zone_C[0, 0] == pytest.approx(decision.step.after[-1].T_zone_C[0], abs=0.05)
    assert any("comfort bound" in line for line in decision.bounds())
    assert decision.boundary.time_s[0] == decision.step.time_s


def test_the_reason_and_the_bounds_say_the_same(folder):
    """A plan that keeps its margin binds at the margin, not at the comfort bound; both are told with their values."""
    (bound,) = decision_at(folder, "10 03:00").bounds()
    why = decision_at(folder, "10 03:00").step.told["why"]
    assert "bound with its margin, 2" in why
    assert "is touched" not in bound
    assert "bound, 2" in bound


def test_alternatives_stand_beside_the_plan(folder, tmp_path):
    done = call("explain", folder, "--at", "10 04:30", "--json", tmp_path / "told.json")
    assert "Alternatives over 48 h" in done.output
    told = json.loads((tmp_path / "told.json").read_text())
    courses = {course["name"]: course for course in told["alternatives"]["courses"]}
    assert {"plan", "off", "full", "levels of the step before", "thermostat rule"} < set(courses)
    assert all(name in done.output for name in courses)
    free_C, forced_K = (np.array(told["plan"][name]) for name in ("T_free_C", "T_forced_K"))
    assert courses["plan"]["T_zone_C"] == pytest.approx(free_C + forced_K, abs=0.015)
    energy = {name: course["parts"]["energy"] for name, course in courses.items()}
    assert energy["off"] == 0.0 < energy["plan"] < energy["full"]
    assert courses["off"]["discomfort_Kh"] > courses["plan"]["discomfort_Kh"]


def test_the_rows_add_up_and_the_chosen_has_the_least_total(folder, tmp_path):
    """In a running plant, with what the run had learned until then."""
    for at in ("10 01:30", "10 04:30", "10 11:00"):
        done = call("explain", folder, "--at", at, "--json", tmp_path / "told.json")
        courses = json.loads((tmp_path / "told.json").read_text())["alternatives"]["courses"]
        plan, *others = courses
        for course in courses:
            assert course["total"] == pytest.approx(sum(course["parts"].values()))
        assert plan["total"] <= min(course["total"] for course in others) + 0.01
        row = next(line.split() for line in done.output.splitlines() if line.strip().startswith("plan "))
        figures = [float(word) for word in row[1 : len(plan["parts"]) + 2]]
        assert sum(figures[:-1]) == pytest.approx(figures[-1], abs=0.03)
        assert "action: the plan's first step, of the least total; next is" in done.output


def test_a_step_that_was_not_the_plans_says_whose(folder, tmp_path):
    kept = Journal(tmp_path / "journal.jsonl")
    for entry in read_run(folder / "journal.jsonl").entries:
        of_a_step = {"status": "guard", "acting": ["guard"]} if "status" in entry.content else {}
        kept.write(entry.kind, {**entry.content, **of_a_step})
    kept.close()
    shutil.copytree(folder / "model", tmp_path / "model")
    assert (
        "action: not that of a plan: the comfort guard"
        in call("explain", tmp_path, "--controller", "thermoforce_mpc").output
    )


def test_what_the_model_found_and_the_run_learned_until_then_is_said(folder, tmp_path):
    kept = Journal(tmp_path / "journal.jsonl")
    for entry in read_run(folder / "journal.jsonl").entries:
        hour = entry.content.get("index") if "status" in entry.content else None
        kept.write(entry.kind, entry.content | ({"news": f"news of hour {hour}"} if hour in (2, 9) else {}))
    kept.close()
    model = simple_model()
    believing = replace(model, cards=tuple(replace(card, blocked_hours=(2, 3)) for card in model.cards))
    believing.save(tmp_path / "model")
    done = call("explain", tmp_path, "--at", "10 04:30", "--json", tmp_path / "told.json")
    assert done.exit_code == 0, done.output
    claims = believing.claims
    for claim in claims:
        assert f"found before the run: {claim}\n" in done.output
    assert "learned: day 10 02:00: news of hour 2\n" in done.output
    assert "news of hour 9" not in done.output, "that came later"
    told = json.loads((tmp_path / "told.json").read_text())
    assert (told["claims"], told["learned"]) == (list(claims), ["day 10 02:00: news of hour 2"])


def test_where_there_is_no_model_it_is_said(folder, tmp_path):
    other = call("explain", folder, "--controller", "thermostat")
    assert "alternatives: none are known, thermostat acts without a model" in other.output
    shutil.copy(folder / "journal.jsonl", tmp_path / "journal.jsonl")
    done = call("explain", tmp_path, "--json", tmp_path / "told.json")
    assert done.exit_code == 0, done.output
    assert "alternatives: none are known" in done.output
    assert str(tmp_path / "model") in json.loads((tmp_path / "told.json").read_text())["alternatives"]["none"]


def test_a_journal_of_another_format_is_refused_by_its_release(folder, tmp_path):
    journal = Journal(tmp_path / "journal.jsonl")
    journal.write("run", {"format": 1, "version": "0.3.0", "command": [], "scenario": {}})
    journal.close()
    for command in ("explain", "resume"):
        error = call(command, tmp_path).exception
        assert isinstance(error, JournalError)
        assert "format 1, written by thermoforce-mpc 0.3.0" in str(error)


def test_the_last_step_and_other_controllers(folder):
    assert "step 11" in call("explain", folder).output
    done = call("explain", folder, "--controller", "thermostat", "--at", "10.25")
    assert done.exit_code == 0
    assert "acted: rule" in done.output
    error = call("explain", folder, "--controller", "pi").exception
    assert isinstance(error, InputError)
    assert "there are thermoforce_mpc, thermostat" in str(error)


def test_a_run_that_was_killed_is_explained(folder, tmp_path):
    """After a decision and before it acted."""
    lines = (folder / "journal.jsonl").read_bytes().split(b"\n")
    at = [i for i, line in enumerate(lines) if b'"kind":"step"' in line][6]
    (tmp_path / "journal.jsonl").write_bytes(b"\n".join(lines[: at + 1]) + b'\n{"n": 99, "ki')
    done = call("explain", tmp_path)
    assert done.exit_code == 0, done.output
    assert "step 6" in done.output
    assert "the run ended here" in done.output
    with sole_use(tmp_path):  # as a run that is under way has it
        assert "came: nothing is recorded yet" in call("explain", tmp_path).output
    shutil.copytree(folder / "model", tmp_path / "model")
    assert "Alternatives over 48 h" in call("explain", tmp_path).output


def test_a_run_that_is_read_keeps_the_forecasts_of_its_latest_steps_only(folder, monkeypatch):
    """Those of a year would not fit in memory."""
    alive = []

    class Kept(KeptSteps):
        def append(self, step):
            super().append(step)
            alive.append(sum(type(one) is Boundary for one in gc.get_objects()))

    monkeypatch.setattr("thermoforce_mpc.records.told_steps.KeptSteps", lambda: Kept(in_memory=2))
    told = told_run(folder)
    assert len(told.results["thermoforce_mpc"].steps) == 12
    assert max(alive[:12]) - alive[0] <= 4


def test_several_zones_on_one_machine(tmp_path, monkeypatch):
    names = load_testcase("twozone_apartment_hydronic").layout.names
    monkeypatch.setattr(two_houses, "SHARED", names)
    model = two_houses.two_model(shared=True)
    operator = replace(model.operator, zones=names.zones, actuators=names.actuators)
    replace(model, operator=operator, machines=names.machines).save(tmp_path / "model")
    monkeypatch.setattr(ChosenPlant, "build", lambda *_: two_houses.TwoHouses(shared=True))
    monkeypatch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())
    words = ["--model", tmp_path / "model", "--baselines", "", "--days", "0.2", "--out", tmp_path / "run"]
    settings = [
        "--set",
        "controller.options.gate.enabled=false",
        "--set",
        "step_s=3600",
        "--period",
        "10",
        "--url",
        "http://x",
    ]
    done = call("run", "--testcase", "twozone_apartment_hydronic", *words, *settings)
    assert done.exit_code == 0, done.output
    done = call("explain", tmp_path / "run", "--json", tmp_path / "told.json")
    assert done.exit_code == 0, done.output
    for word in (*names.zones, *names.actuators, "Alternatives over 48 h"):
        assert word in done.output
    told = json.loads((tmp_path / "told.json").read_text())["alternatives"]
    courses = {course["name"]: course for course in told["courses"]}
    assert np.shape(courses["full"]["u"]) == np.shape(courses["plan"]["T_zone_C"]) == (2, 48)
    energy = {name: course["parts"]["energy"] for name, course in courses.items()}
    assert energy["off"] == 0.0 < energy["plan"] < energy["full"]


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("16 06:30", 16 * DAY_S + 6.5 * HOUR_S),
        ("16.5", 16.5 * DAY_S),
        ("16d 06:30", 16 * DAY_S + 6.5 * HOUR_S),
        ("01-17 06:30", 16 * DAY_S + 6.5 * HOUR_S),
        ("17 Jan 06:30", 16 * DAY_S + 6.5 * HOUR_S),
        ("1405800s", 1405800.0),
    ],
)
def test_times_as_people_write_them(text, seconds):
    assert seconds_of(text) == seconds
    assert seconds_of(words_of(seconds).removeprefix("day ")) == seconds
    assert words_of(DAY_S - 0.4) == "day 1 00:00", "a clock that is off by a little"


@pytest.mark.parametrize("text", ["", "noon", "16:30", "13-40 06:30", "-1"])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(InputError, match="not a time"):
        seconds_of(text)


def test_times_outside_the_run_and_folders_without_one_are_refused(folder, tmp_path):
    assert "ran from day 10 00:00 to day 10 12:00" in str(call("explain", folder, "--at", "44").exception)
    assert isinstance(call("explain", tmp_path).exception, JournalError)
    shutil.copy(folder / "journal.jsonl", tmp_path / "journal.jsonl")
    (tmp_path / "journal.jsonl").write_bytes((folder / "journal.jsonl").read_bytes()[:200])
    assert "holds no run" in str(call("explain", tmp_path).exception)
    lines = (folder / "journal.jsonl").read_bytes().split(b"\n")
    (tmp_path / "journal.jsonl").write_bytes(b"\n".join(lines[:2]) + b"\n")
    assert "no step was decided yet" in str(call("explain", tmp_path).exception)


def test_the_margins_of_a_plan_are_told_and_add_up(folder):
    decision = decision_at(folder, "10 04:00")
    assert set(decision.margins) == {"comfort", "backoff", "reserve", "learned", "offset", "unused_capacity"}
    inside_K = sum(decision.margins[name] for name in ("comfort", "backoff", "reserve", "learned"))
    assert inside_K.shape == (2, 1)
    (line,) = decision.margins_in_words()
    assert f"{inside_K[0, 0]:.2f} K inside the lower bound (comfort 0.02" in line
    assert f"{inside_K[1, 0]:.2f} K inside the upper bound" in line
    assert f"margin: {line}" in call("explain", folder, "--at", "10 04:00").output
    assert not decision_at(folder, "10 04:00", "thermostat").margins_in_words()
