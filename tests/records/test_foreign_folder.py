"""The folder of a run that comes from somebody else: it sends no token, runs no code and writes nowhere else."""

from __future__ import annotations

import json
import os
import stat
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from click.testing import CliRunner
from simple_house import SimpleHouse, simple_model

from thermoforce_mpc import files, report
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import ArtifactError, ConfigError
from thermoforce_mpc.experiment import outside
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.experiment.explaining import alternatives_of, decision_at
from thermoforce_mpc.experiment.run_book import RunBook
from thermoforce_mpc.files import open_plain
from thermoforce_mpc.plants.registry import ChosenPlant
from thermoforce_mpc.plants.testcases import load_scenario
from thermoforce_mpc.records.run_folder import kept_model

TESTCASE = "bestest_hydronic_heat_pump"
TOKEN = "kept-in-a-drawer-0123456789"
WORDS = ("run", "--testcase", TESTCASE, "--baselines", "", "--days", "0.25", "--no-equal-comfort")


@pytest.fixture(autouse=True)
def another_user(monkeypatch, tmp_path):
    """Who has given nothing here so far."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def call(*words: object):
    return CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=True)


def sent(folder: Path, **settings: object) -> Path:
    """A folder whose run was killed before its plant was there."""
    folder.mkdir()
    scenario = load_scenario(None, {"testcase": TESTCASE, "baselines": [], "days": 0.25, **settings})
    # What it names is not looked up here.
    theirs = replace(Experiment.of(load_scenario(None, {"testcase": TESTCASE})), written=scenario)
    RunBook.begin(folder, theirs, ["tf-mpc", "run"]).journal.close()
    return folder


@pytest.fixture
def run(monkeypatch, tmp_path) -> Path:
    """A whole run of the simple house."""
    monkeypatch.setattr(ChosenPlant, "build", lambda *_: SimpleHouse())
    done = call(*WORDS, "--controller", "thermostat", "--out", tmp_path / "run")
    assert done.exit_code == 0, done.output
    return tmp_path / "run"


@pytest.fixture
def listener() -> Iterator[list[tuple[str, str | None]]]:
    """Requests that came in: path and Authorization; the first entry is the address."""
    came: list[tuple[str, str | None]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            came.append((self.path, self.headers.get("Authorization")))
            self.send_error(500)

        do_POST = do_PUT = do_GET

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        came.append((f"http://127.0.0.1:{server.server_port}", None))
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield came
        server.shutdown()
        thread.join()


@pytest.mark.slow
def test_an_address_in_a_journal_gets_no_request_and_no_token_until_it_is_given(monkeypatch, tmp_path, listener):
    (url, _), *_ = listener
    monkeypatch.setenv("BOPTEST_TOKEN", TOKEN)
    folder = sent(tmp_path / "sent", plant={"kind": "boptest", "url": url})
    error = call("resume", folder).exception
    assert isinstance(error, ConfigError)
    assert f"plant.url: {url} (requests and BOPTEST_TOKEN go there)" in str(error)
    assert f"tf-mpc resume {folder} --url {url}" in str(error)
    assert len(listener) == 1
    call("resume", folder, "--url", url)
    assert ("/version", f"Bearer {TOKEN}") in listener
    n, again = len(listener), sent(tmp_path / "again", plant={"kind": "boptest", "url": url})
    assert "not given it here before" not in str(call("resume", again).exception)
    assert len(listener) > n, "it was given once"


def test_an_fmu_in_a_journal_is_not_opened_until_it_is_given_or_the_one_of_before(monkeypatch, tmp_path):
    opened: list[str] = []

    def build(chosen, *_: object) -> SimpleHouse:
        opened.append(chosen.spec.path)
        return SimpleHouse()

    monkeypatch.setattr(ChosenPlant, "build", build)
    monkeypatch.setattr(report, "write_report", lambda folder, **_: (folder / "report.html").touch())
    fmu, settings = tmp_path / "wrapped.fmu", {"controller": {"name": "thermostat"}}
    fmu.write_bytes(b"mine")
    assert call(*WORDS, "--controller", "thermostat", "--fmu", fmu, "--out", tmp_path / "own").exit_code == 0
    opened.clear()
    folder = sent(tmp_path / "sent", plant={"kind": "fmu", "path": str(tmp_path / "sent" / "theirs.fmu")}, **settings)
    (folder / "theirs.fmu").write_bytes(b"theirs")
    error = call("resume", folder).exception
    assert "an FMU runs native code" in str(error)
    assert opened == []
    again = call("resume", folder, "--fmu", fmu)
    assert again.exit_code == 0, again.output
    assert opened == [str(fmu)]
    same = sent(tmp_path / "same", plant={"kind": "fmu", "path": str(fmu)}, **settings)
    assert call("resume", same).exit_code == 0, "what this user gave before, unchanged"
    changed = sent(tmp_path / "changed", plant={"kind": "fmu", "path": str(fmu)}, **settings)
    fmu.write_bytes(b"changed since")
    assert "not given it here before" in str(call("resume", changed).exception)


@pytest.mark.slow
def test_python_in_a_journal_is_not_run_by_resume_or_explain(monkeypatch, tmp_path):
    monkeypatch.setattr(ChosenPlant, "build", lambda *_: SimpleHouse())
    mark, terms = tmp_path / "was here", tmp_path / "terms.py"
    terms.write_text(
        f"open({str(mark)!r}, 'w').close()\ndef cheap(plan):\n    plan.add_cost(1e-9 * plan.u)\n", encoding="utf-8"
    )
    simple_model().save(tmp_path / "model")
    done = call(
        *WORDS, "--model", tmp_path / "model", "--set", "step_s=3600", "--out", tmp_path / "run",
        "--set", f"controller.options.terms={terms}:cheap", "--set", "controller.options.gate.enabled=false",
        "--set", "controller.options.free_response.name=linear_weather",
    )  # fmt: skip
    assert done.exit_code == 0, done.output + str(done.exception)
    assert mark.exists()
    mark.unlink()
    (tmp_path / "cache" / "thermoforce-mpc" / files.GIVEN).unlink()
    (tmp_path / "run" / "report.html").unlink()
    terms.touch()  # a module that was loaded before is not loaded again
    error = call("resume", tmp_path / "run").exception
    assert f"file of Python: {terms} (it is run)" in str(error)
    assert f"--code {terms}" in str(error)
    explained = call("explain", tmp_path / "run")
    assert explained.exit_code == 0, explained.output
    assert "they need what you have not given here before" in explained.output
    assert not mark.exists()
    assert call("resume", tmp_path / "run", "--code", terms).exit_code == 0
    assert mark.exists()


@pytest.mark.parametrize(
    "settings",
    [
        {"controller": {"name": "{}:Theirs"}},
        {"controller": {"name": "thermostat"}, "baselines": ["native", "{}:Theirs"]},
        {"controller": {"name": "thermostat"}, "kpis": ["{}:theirs"]},
        {"controller": {"options": {"terms": "{}:theirs"}}},
    ],
)
def test_no_setting_of_a_journal_runs_python(tmp_path, settings):
    mark, code = tmp_path / "was here", tmp_path / "code.py"
    code.write_text(f"open({str(mark)!r}, 'w').close()\n", encoding="utf-8")
    folder = sent(tmp_path / "sent", **json.loads(json.dumps(settings).replace("{}", str(code))))
    assert f"--code {code}" in str(call("resume", folder).exception)
    for command in ("explain", "report", "watch"):
        assert call(command, folder).exit_code != 0
    assert not mark.exists()


@pytest.mark.parametrize("name", ["somebody/chronos-new", "chronos-2"])
def test_a_hub_is_not_asked_for_the_forecaster_of_a_journal_until_it_is_given(monkeypatch, tmp_path, name):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")  # the message says when it would have been asked
    folder = sent(tmp_path / "sent", controller={"options": {"free_response": {"options": {"backbone": name}}}})
    error = str(call("resume", folder).exception)
    assert f"backbone: {name} (a model hub is asked for it)" in error
    assert f"--forecaster {name}" in error
    assert "HF_HUB_OFFLINE" in str(call("resume", folder, "--forecaster", name).exception)
    assert "HF_HUB_OFFLINE" in str(call("resume", folder).exception), "it was given once"
    assert f"its run has the forecaster '{name}', not 'other/one'" in str(
        call("resume", folder, "--forecaster", "other/one").exception
    )


def test_a_controller_that_only_a_step_names_is_not_loaded_by_explain(run, tmp_path):
    mark, code = tmp_path / "was here", tmp_path / "code.py"
    code.write_text(f"open({str(mark)!r}, 'w').close()\n", encoding="utf-8")
    decision = decision_at(run)
    assert "they need" in str(alternatives_of(run, replace(decision, controller=f"{code}:Theirs")))
    assert not mark.exists()


def test_what_a_run_does_not_have_cannot_be_given(tmp_path):
    folder = sent(tmp_path / "sent")
    assert "its run has no plant.path" in str(call("resume", folder, "--fmu", "wrapped.fmu").exception)
    assert "its run has no my.py" in str(call("resume", folder, "--code", "my.py").exception)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["a link", "a pipe", "a device", "a folder elsewhere"])
@pytest.mark.parametrize("name", ["log.jsonl", "journal.jsonl", "kpis.json", ".lock", "model/model.json"])
def test_links_pipes_and_devices_are_refused_and_what_they_point_to_is_left(run, tmp_path, what, name):
    (run / "report.html").unlink()
    path, target = run / name, tmp_path / "theirs"
    target.mkdir() if what == "a folder elsewhere" else target.write_bytes(b"as it was")
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    if what == "a pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero" if what == "a device" else target)
    for words in (("resume", run), ("report", run), ("explain", run), ("watch", run, "--once")):
        error = call(*words).exception
        assert isinstance(error, ConfigError), words
        assert f"{path}: is a {'pipe' if what == 'a pipe' else 'link'}" in str(error)
    assert list(target.iterdir()) == [] if target.is_dir() else target.read_bytes() == b"as it was"


def test_a_folder_that_is_named_by_a_link_is_taken(run, tmp_path):
    (tmp_path / "latest").symlink_to(run)
    assert call("explain", tmp_path / "latest").exit_code == 0


def test_what_is_exchanged_after_the_look_is_not_followed_either(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "target")
    os.mkfifo(tmp_path / "pipe")
    for name, kind in (("link", "a link"), ("pipe", "a pipe")):
        with pytest.raises(OSError, match=f"is {kind}, not a plain file"):
            open_plain(tmp_path / name, os.O_WRONLY | os.O_CREAT)
    assert not (tmp_path / "target").exists()


@pytest.mark.parametrize("what", ["a link", "a pipe"])
def test_what_is_exchanged_during_a_run_is_not_written_through(monkeypatch, tmp_path, what):
    """Kept files, report and notes of a run take the place of it."""
    folder, victim = tmp_path / "run", tmp_path / "victim"
    victim.write_bytes(b"as it was")
    names = ("kpis.json", "trajectory.csv", "report.html", "manifest.json")

    def exchanged(*_: object) -> SimpleHouse:
        for name in names:
            os.mkfifo(folder / name) if what == "a pipe" else (folder / name).symlink_to(victim)
        return SimpleHouse()

    monkeypatch.setattr(ChosenPlant, "build", exchanged)
    done = call(*WORDS, "--controller", "thermostat", "--out", folder)
    assert done.exit_code == 0, done.output
    assert victim.read_bytes() == b"as it was"
    assert all(stat.S_ISREG((folder / name).lstat().st_mode) for name in names)


@pytest.mark.parametrize("name", ["../model", "/etc", "..", None, 3])
def test_a_model_elsewhere_is_refused(tmp_path, name):
    with pytest.raises(ArtifactError, match="names a model that is not in the folder"):
        kept_model(tmp_path, name)
    assert kept_model(tmp_path, "model") == tmp_path / "model"


def test_a_test_whose_name_leads_elsewhere_is_refused(tmp_path, listener):
    (url, _), *_ = listener
    folder = sent(tmp_path / "sent", plant={"kind": "boptest", "url": url})
    book = RunBook.reopen(folder)
    book.journal.write("plant", {"info": {"details": {"testid": "../../admin"}}})
    book.journal.close()
    error = call("resume", folder, "--url", url).exception
    assert "is not the name of a test" in str(error)
    assert len(listener) == 1


def test_what_was_given_is_noted_once_and_needs_no_home(tmp_path, monkeypatch):
    scenario = load_scenario(None, {"testcase": TESTCASE, "plant": {"kind": "boptest", "url": "http://[::1]:5000/"}})
    for _ in range(2):
        outside.note_given(scenario)
    notes = (tmp_path / "cache" / "thermoforce-mpc" / files.GIVEN).read_text().splitlines()
    assert [json.loads(line) for line in notes] == [["plant.url", "http://[::1]:5000"]]
    assert outside.unknown(scenario) == []
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    outside.note_given(scenario)
    assert [one.key for one in outside.unknown(scenario)] == ["plant.url"]


def test_a_trained_policy_is_code(tmp_path):
    """It is unpickled, which runs what is in it."""
    policy = tmp_path / "policy.zip"
    policy.write_bytes(b"one")
    keys = {"testcase": "bestest_hydronic_heat_pump", "controller": {"name": str(policy)}}
    (found,) = outside.outside(load_scenario(None, keys))
    assert (found.key, found.value, found.option) == (outside.CODE, str(policy), "--code")
