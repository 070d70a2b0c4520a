"""A probing outlives its plant and its process: it is gone on with, or taken by another run, to the same bytes."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from hands_on import HandsOn
from places import ROOT
from simple_house import SimpleHouse
from waiting import LONG_S, wait_for

from thermoforce_mpc import report
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.model.thermal_model import load_model
from thermoforce_mpc.plants.registry import ChosenPlant
from thermoforce_mpc.protocols import OutlivingPlant
from thermoforce_mpc.records.journal import JournalError, read_journal

pytestmark = pytest.mark.usefixtures("identified_once")

TESTCASE = "bestest_hydronic_heat_pump"
# Probing of the simple house: two days that end where its warm-up of two days before day 10 begins.
SETTINGS = (
    "--days", "0.0625", "--baselines", "thermostat", "--no-equal-comfort", "--set", "identification.days=2",
    "--set", "identification.most_days=2", "--set", "identification.end_early=false",
    "--set", "identification.options.modulation=linear", "--set", "identification.probing.candidates=4",
    "--set", "identification.options.sun_on_sensor=false", "--set", "identification.options.late_sensor=false",
)  # fmt: skip
ON_DAY_2_S = 7.4 * DAY_S
PROBING = Path("probing/thermoforce_mpc.jsonl")


class House(SimpleHouse):
    """Counts its resets."""

    resets = 0

    def reset(self, start_s, warmup_s, price="constant"):
        self.resets += 1
        return super().reset(start_s, warmup_s, price)


class Served(House):
    """A house that outlives the process, as a service."""

    taken_up = 0

    def leave(self):
        """It goes on existing anyway."""

    def go_on(self, last, *, start_s, warmup_s, price, periods, anywhere=False):
        self.taken_up += 1
        assert last.time_s == self.now_s, "it is taken up where it stands"


def call(*words: object):
    return CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=True)


def run(house: SimpleHouse, out: Path, *words: object):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ChosenPlant, "build", lambda *_: house)
        patch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())
        return call("run", "--testcase", TESTCASE, *SETTINGS, "--out", out, *words)


def resumed(house: SimpleHouse, folder: Path):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ChosenPlant, "build", lambda *_: house)
        patch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())
        return call("resume", folder)


def results(folder: Path) -> dict[str, bytes]:
    """What must be the same: the model and all trajectories."""
    files = [*(folder / "model").iterdir(), *folder.glob("trajectory*.csv")]
    return {path.name: path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A run that nothing disturbed."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    done = run(House(), folder)
    assert done.exit_code == 0, done.output
    assert "may act\nprobing ended after 2 days: enough is known" not in done.output, "a look is in the log only"
    assert "probing ended after 2 days: enough is known\nModel: order 3" in done.output
    return folder


@pytest.mark.slow
def test_why_probing_ended_is_in_the_log_the_manifest_and_on_the_card(whole):
    log = [json.loads(line)["message"] for line in (whole / "log.jsonl").read_text(encoding="utf-8").splitlines()]
    assert log[:2] == ["after 2 days of probing the model may act", "probing ended after 2 days: enough is known"]
    manifest = json.loads((whole / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["identification"]["notes"][-1] == log[1]
    assert load_model(whole / "model").only.card.notes[-1] == log[1]


def killed_while_probing(whole: Path, share: float, folder: Path) -> Path:
    """What a run leaves that was killed when `share` of its probing was recorded."""
    (folder / PROBING).parent.mkdir(parents=True)
    lines = (whole / "journal.jsonl").read_bytes().splitlines(keepends=True)
    assert b'"kind":"models"' in lines[3]
    (folder / "journal.jsonl").write_bytes(b"".join(lines[:3]))
    content = (whole / PROBING).read_bytes()
    (folder / PROBING).write_bytes(content[: int(share * len(content))])
    return folder


@pytest.mark.slow
def test_a_plant_that_failed_on_day_2_is_probed_on_from_there(whole, tmp_path):
    folder = tmp_path / "run"
    failed = run(House(fail_at_s=ON_DAY_2_S), folder)
    assert isinstance(failed.exception, PlantError)
    assert f"`tf-mpc resume {folder}` goes on from there" in str(failed.exception)
    recorded = (folder / PROBING).read_bytes()
    assert (whole / PROBING).read_bytes().startswith(recorded)
    done = resumed(House(), folder)
    assert done.exit_code == 0, done.output
    assert "Probing goes on after 1.4 recorded days" in done.output
    assert results(folder) == results(whole)
    assert (folder / PROBING).read_bytes() == (whole / PROBING).read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.0005, 0.37, 0.9, 0.9999])
def test_a_run_killed_while_probing_goes_on_to_the_same_bytes(whole, tmp_path, share):
    folder = killed_while_probing(whole, share, tmp_path / "killed")
    done = resumed(House(), folder)
    assert done.exit_code == 0, done.output
    assert results(folder) == results(whole)


@pytest.mark.slow
def test_a_probing_that_is_whole_is_not_made_again(whole, tmp_path):
    house, folder = House(), killed_while_probing(whole, 1.0, tmp_path / "killed")
    done = resumed(house, folder)
    assert done.exit_code == 0, done.output
    assert results(folder) == results(whole)
    assert house.resets == 2, "of the two loops"


@pytest.mark.slow
@pytest.mark.parametrize("seen_as", [lambda house: house, HandsOn])
def test_a_service_is_taken_up_where_it_stands(whole, tmp_path, seen_as):
    house, folder = Served(fail_at_s=ON_DAY_2_S), tmp_path / "run"
    assert isinstance(house, OutlivingPlant)
    assert isinstance(run(seen_as(house), folder).exception, PlantError)
    house.fail_at_s, n_before = float("inf"), len(house.applied)
    assert n_before > 96
    done = resumed(seen_as(house), folder)
    assert done.exit_code == 0, done.output
    assert (house.taken_up, house.resets) == (1, 3), "no probing step is made twice"
    assert results(folder)["arrays.safetensors"] == results(whole)["arrays.safetensors"]


@pytest.mark.slow
@pytest.mark.parametrize("place", [".", "probing", PROBING])
def test_the_probing_of_an_earlier_run_gives_the_same_model_without_a_probing(whole, tmp_path, place):
    house, folder = House(), tmp_path / "run"
    done = run(house, folder, "--probing", whole / place)
    assert done.exit_code == 0, done.output
    assert results(folder) == results(whole)
    assert house.resets == 2, "of the two loops"
    assert not (folder / "probing").exists()


@pytest.mark.slow
def test_the_probing_of_an_earlier_run_is_identified_with_other_options(whole, tmp_path):
    done = call(
        "identify", "--testcase", TESTCASE, "--probing", whole, "--out", tmp_path / "model",
        "--set", "identification.options.order=1", "--set", "identification.options.modulation=linear",
        "--set", "identification.options.sun_on_sensor=false", "--set", "identification.options.late_sensor=false",
    )  # fmt: skip
    assert done.exit_code in (0, 4), done.output
    card = json.loads((tmp_path / "model" / "model.json").read_text(encoding="utf-8"))
    assert "2 days of probing (days 6 to 8) on simple simple_house" in json.dumps(card)


@pytest.mark.slow
def test_a_comparison_takes_the_probing_of_an_earlier_run(whole, tmp_path, computed_here):
    words = (
        "compare",
        "--testcase",
        TESTCASE,
        "--controllers",
        "thermoforce_mpc",
        "--windows",
        "20",
        "--days",
        "0.0625",
    )
    options = ("modulation=linear", "sun_on_sensor=false", "late_sensor=false")
    settings = ("--no-equal-comfort", *(f"--set=identification.options.{one}" for one in options), "--jobs", "1")
    done = call(*words, *settings, "--probing", whole, "--out", tmp_path / "compared")
    assert done.exit_code == 0, done.output
    (model,) = (tmp_path / "compared").rglob("model.json")
    assert "2 days of probing (days 6 to 8) on simple simple_house" in model.read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_probing_that_did_not_end_is_taken_as_far_as_it_came(whole, tmp_path):
    done = run(House(), tmp_path / "run", "--probing", killed_while_probing(whole, 0.8, tmp_path / "killed"))
    assert done.exit_code == 0, done.output
    assert re.search(r"probing ended after 1\.\d+ days: its run was ended before its time", done.output)


def refused(folder: Path, testcase: str = TESTCASE) -> BaseException:
    """The refusal of `--probing folder`; the run leaves nothing behind."""
    out = folder.parent / "refused"
    error = call("run", "--testcase", testcase, "--probing", folder, "--out", out).exception
    assert error is not None
    assert not out.exists()
    return error


@pytest.mark.slow
def test_a_probing_that_cannot_be_used_is_refused_with_file_and_reason(whole, tmp_path):
    other = refused(whole, "house:3rooms")
    assert isinstance(other, JournalError)
    assert f"{whole / PROBING}: is a probing of {TESTCASE}, not of house:3rooms" in str(other)
    assert "was ended before its first step" in str(refused(killed_while_probing(whole, 0.008, tmp_path / "begun")))
    without = tmp_path / "without"
    without.mkdir()
    assert isinstance(refused(without), ConfigError)
    assert "holds no probing" in str(refused(without))


@pytest.mark.slow
def test_a_damaged_probing_is_refused_by_its_line(whole, tmp_path):
    folder = killed_while_probing(whole, 0.8, tmp_path / "damaged")
    lines = (folder / PROBING).read_bytes().split(b"\n")
    lines[40] = lines[40].replace(b'"n":40', b'"n":41', 1)
    (folder / PROBING).write_bytes(b"\n".join(lines))
    for error in (resumed(House(), folder).exception, refused(folder)):
        assert isinstance(error, JournalError)
        assert f"{folder / PROBING}, line 41: the record is damaged" in str(error)


@pytest.mark.slow
def test_several_probings_are_told_apart_by_their_settings(whole, tmp_path):
    folder = tmp_path / "several"
    shutil.copytree(whole / "probing", folder / "probing")
    other = run(House(), tmp_path / "other", "--seed", "2")
    assert other.exit_code == 0, other.output
    shutil.copy(tmp_path / "other" / PROBING, folder / "probing" / "rc_mpc.jsonl")
    done = run(House(), tmp_path / "run", "--probing", folder)
    assert done.exit_code == 0, done.output
    assert results(tmp_path / "run") == results(whole)
    error = run(House(), tmp_path / "unclear", "--probing", folder, "--seed", "3").exception
    assert isinstance(error, ConfigError)
    assert f"name one of {folder / 'probing' / 'rc_mpc.jsonl'}, {folder / PROBING}" in str(error)


def test_a_run_has_one_source_of_its_model(tmp_path):
    error = call("run", "--testcase", TESTCASE, "--probing", tmp_path, "--model", tmp_path).exception
    assert "model and probed each take the place of probing" in str(error)


@pytest.mark.slow
def test_sigkill_while_probing_in_earnest(tmp_path):
    """The embedded plant: an undisturbed run, and one killed while probing in a process of its own and resumed here."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    words = ["run", "--testcase", TESTCASE, "--period", "20", *SETTINGS, "--quiet", "--out"]

    assert call(*words, tmp_path / "whole").exit_code == 0
    folder = tmp_path / "killed"
    tf_mpc = [sys.executable, "-m", "thermoforce_mpc", *words, str(folder)]
    process = subprocess.Popen(tf_mpc, env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    journal = folder / PROBING
    long = lambda: journal.exists() and journal.stat().st_size > 120_000  # noqa: E731
    wait_for("day 2 is probed", lambda: process.poll() is not None or long())
    process.kill()
    print(process.communicate(timeout=LONG_S))
    assert process.returncode == -signal.SIGKILL
    assert read_journal(journal).entries[-1].kind != "end"
    done = call("resume", folder, "--quiet")
    assert done.exit_code == 0, done.output
    assert results(folder) == results(tmp_path / "whole")
