"""Every kind of trouble, made by the proxy or inside the controller: no run ends, no step is lost or doubled."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields

import executed_tasks as functions
import numpy as np
import pytest
from click.testing import CliRunner
from emulator_service import running_emulator_service
from here import Here
from simple_house import simple_model

from benchmarks.chaos import troubles as kinds
from benchmarks.chaos.episode import Setting, run_episode
from benchmarks.chaos.episodes import OPTIONS, TESTCASE, run_chaos
from benchmarks.chaos.files import TRIALS
from benchmarks.chaos.judging import jumps, wrong_inputs, wrong_steps
from benchmarks.chaos.troubles import Trouble, drawn
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.records.journal import JournalEntry, read_journal, read_run
from thermoforce_mpc.records.told_steps import told_loops, told_steps

ANYWHERE = (*kinds.REFUSALS, *kinds.BROKEN, *kinds.AWAY, *kinds.NOT_ITSELF, *kinds.WRONG_CLOCK)
# The model is of another house: what is tested here is that the run goes on, not how well it heats.
QUICK = dict(OPTIONS) | {"gate": {"enabled": False}, "horizon_h": 12}


@pytest.fixture(scope="module")
def setting():
    with running_emulator_service(most_tests=10) as url:
        # At the second day of the year, so that the warm-up is a day and its record short.
        yield Setting(url, load_testcase(TESTCASE), simple_model(), QUICK, "thermoforce_paper", DAY_S, 0.25)


@pytest.fixture(scope="module")
def calm(setting):
    return run_episode(setting, (), 0)


def trouble(kind: str) -> Trouble:
    """From the second hour on, some of the requests; what costs real time, or ends the test, once."""
    slow = kind in (*kinds.SILENT, "late")
    once = slow or kind.endswith("hangs") or kind in (*kinds.AWAY, kinds.RESTART)
    at = "" if kind in ANYWHERE or kind == kinds.RESTART else "advance"
    share = 1.0 if once or kind in (*kinds.INSIDE, *kinds.READINGS) else 0.6
    return Trouble(kind, HOUR_S, 5 * HOUR_S, at, share, 1 if once else 99, 840.0 if kind in kinds.AWAY else 0.2)


@pytest.mark.slow
def test_a_forecast_endpoint_that_fails_for_good_is_bridged(setting, calm, tmp_path):
    gone = Trouble(kinds.NO_FORECAST, 2 * HOUR_S, 1e9, at="forecast")
    found = run_episode(setting, [gone], seed=2, most_Kh=1.5 * calm.discomfort_Kh + 1.0, folder=tmp_path)
    assert found.ended == "done"
    assert found.faults == ()
    (loop,) = told_loops(read_run(tmp_path / "journal.jsonl").entries).values()
    steps = list(told_steps(loop))
    without = [step for step in steps if step.given is None]
    assert len(without) == len(steps) - 2
    assert all("gives no forecast" in " ".join(step.notes) and step.told["status"] == "bridged" for step in without)
    assert all("the last forecast" in step.told["why"] for step in without)
    log = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert sum("stands in, for up to 48 h" in line["message"] for line in log) == 1, "said once"
    # Once it has failed it is asked once a step, so that steps do not wait for it.
    assert found.made[kinds.NO_FORECAST] < 100, "a patient request is repeated 65 times"


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*ANYWHERE, *kinds.TWICE, *kinds.SILENT, *kinds.READINGS, *kinds.INSIDE, *kinds.UNITS])
def test_a_run_outlives(setting, calm, kind):
    found = run_episode(setting, [trouble(kind)], seed=2, most_Kh=1.5 * calm.discomfort_Kh + 1.0)
    assert found.faults == ()
    assert found.made[kind] >= 1
    assert found.ended == "done"
    assert (found.jumps > 0) == (kind in kinds.TWICE)
    assert found.steps + found.jumps >= 6


def test_a_service_that_forgot_the_test_ends_it_with_a_named_error(setting, tmp_path):
    found = run_episode(setting, [trouble(kinds.RESTART)], seed=2, folder=tmp_path / "kept")
    assert found.faults == ()
    assert found.ended == "plant failed"
    assert "Invalid testid" in found.why
    assert not read_journal(tmp_path / "kept" / "journal.jsonl").torn


def test_the_same_seed_draws_the_same_troubles():
    first, again = ([drawn(np.random.default_rng([7, n]), 2.0) for n in range(200)] for _ in range(2))
    assert first == again
    met = {trouble.kind for troubles in first for trouble in troubles}
    assert met == {kind for group in kinds.CLASSES.values() for kind in group}, "two hundred episodes meet every kind"


def journal(*ends_s: float, note: str = "") -> list[JournalEntry]:
    """A run of steps of 900 s from 0, that ended when told."""
    entries = [JournalEntry(1, "reset", {"answer": {"time_s": 0.0}})]
    for i, end_s in enumerate(ends_s):
        advance = {"asked": {"duration_s": 900.0}, "answer": {"time_s": end_s}}
        entries.append(JournalEntry(2, "done", {"index": i, "advances": [advance], "notes": [note] if note else []}))
    return entries


@pytest.mark.parametrize(
    ("ends_s", "simulated_s", "doubled", "note", "words"),
    [
        ((900, 1800), (900, 1800), False, "", None),
        ((900, 1800), (900, 1800, 2700), False, "", "not in the journal"),
        ((900, 1800, 2700), (900, 1800), False, "", "never simulated"),
        ((900, 2700), (900, 1800, 2700), False, "", "nothing was doubled"),
        ((900, 2700), (900, 1800, 2700), True, "", "no note says so"),
        ((900, 2700), (900, 1800, 2700), True, "the plant's clock ran ahead by 900 s", None),
        ((900, 900), (900,), False, "", "falls behind"),
    ],
)
def test_lost_and_doubled_steps_are_found(ends_s, simulated_s, doubled, note, words):
    entries = journal(*ends_s, note=note)
    made = [Trouble("doubled", 0.0, 1.0)] if doubled else []
    wrong = wrong_steps(entries, simulated_s, made, done=True)
    assert wrong == [] if words is None else any(words in line for line in wrong)
    assert len(jumps(entries)) == (2700 in ends_s and 1800 not in ends_s) + (ends_s == (900, 900))


@pytest.mark.parametrize("value", [math.nan, math.inf, -0.1, 1.01, None, "1"])
def test_an_action_out_of_range_is_found(value):
    assert wrong_inputs([{"oveHeaPumY_u": 0.5, "oveHeaPumY_activate": 1.0}]) == []
    assert "oveHeaPumY_u" in wrong_inputs([{"oveHeaPumY_u": value, "oveHeaPumY_activate": 1.0}])[0]


@pytest.fixture
def one_kind_of_trial(monkeypatch):
    """Without those that need a finished run and an FMU, which take most of the time and are tested beside."""
    monkeypatch.setattr("benchmarks.chaos.episodes.prepared", lambda folder: folder)
    for kind in set(TRIALS) - {"foreign folder"}:
        monkeypatch.delitem(TRIALS, kind)


@pytest.mark.slow
@pytest.mark.usefixtures("one_kind_of_trial")
def test_the_command_prints_its_table_in_one_process_and_in_two_others(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.chaos.episodes.LocalEngine", lambda n: Here() if n == 1 else LocalEngine(n))
    simple_model().save(tmp_path / "model")
    words = ["--episodes", "2", "--days", "0.125", "--controller", "thermoforce_paper", "--seed", "3"]
    words += ["--model", str(tmp_path / "model")]
    rows = []
    for workers in ("1", "2"):
        files = ["--keep", str(tmp_path / workers), "--json", str(tmp_path / f"{workers}.json")]
        done = CliRunner().invoke(cli, ["chaos", *words, *files, "--workers", workers])
        assert done.exit_code in (0, 1), done.output
        assert "episodes with an action out of range: 0" in done.output
        assert (tmp_path / workers / "0001" / "journal.jsonl").exists()
        rows.append(json.loads((tmp_path / f"{workers}.json").read_text())["rows"])
    assert rows[0] == rows[1]


@pytest.mark.slow
def test_an_interrupt_leaves_the_table_of_the_episodes_until_then(monkeypatch):
    # Where episodes are computed is tested beside.
    monkeypatch.setattr("benchmarks.chaos.episodes.LocalEngine", lambda processes: Here())
    told = []

    def progress(line: str) -> None:
        told.append(line)
        if line.lstrip().startswith("1:"):
            raise KeyboardInterrupt

    found = run_chaos(
        episodes=3, seed=3, days=0.125, controller="thermoforce_paper", model=simple_model(), progress=progress
    )
    assert found["rows"][-1]["episodes"] == 1
    assert told[-1] == "interrupted after 1 of 3 episodes"


@dataclass(frozen=True)
class Deadly(ThermalModel):
    """Kills by SIGKILL the first process that it is sent to."""

    grave: str = ""

    def __reduce__(self):
        model = ThermalModel(**{field.name: getattr(self, field.name) for field in fields(ThermalModel)})
        return functions.die_once_for, (model, self.grave)


@pytest.mark.slow
@pytest.mark.usefixtures("one_kind_of_trial")
def test_an_episode_whose_process_dies_is_lost_and_the_others_go_on(tmp_path):
    told: list[str] = []
    model = Deadly(**vars(simple_model()), grave=str(tmp_path / "grave"))
    options = {"episodes": 4, "seed": 3, "days": 0.125, "controller": "thermoforce_paper"}
    found = run_chaos(**options, model=model, progress=told.append)
    lost = [line for line in told if "process died" in line]
    assert len(lost) == 1
    assert "WRONG: ended with its process" in lost[0]
    assert found["rows"][-1]["episodes"] == 4 + len(TRIALS), "one trial of each kind follows"
    assert found["rows"][-1]["done"] >= 2
    assert not all(target["holds"] for target in found["targets"]), "so that the command's exit code is 1"
