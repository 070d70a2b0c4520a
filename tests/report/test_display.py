"""What a run shows of its loops: little where nothing can be overwritten, and a line of what each found."""

from __future__ import annotations

import io
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from rich.console import Console
from simple_house import SimpleHouse

from controllers.registry import build_controller
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.experiment import measured_model, run_models
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.loop.probing import ProbingProgress
from thermoforce_mpc.measurements import load
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.report import display
from thermoforce_mpc.report.display import LoopDisplay, ProbingDisplay, RunDisplay

KPIS = {"cost_tot": 0.5, "tdis_tot": 1.0}


@pytest.fixture(scope="module")
def result():
    testcase = load_testcase("bestest_hydronic_heat_pump")
    plant = SimpleHouse()
    period = replace(plant.period("x"), scored_s=9 * DAY_S)
    return run_closed_loop(plant, build_controller("native", {}, testcase), period)


def show(result, console, before=lambda: None):
    with LoopDisplay(console, "native", result.period, lambda: KPIS, "EUR", quiet=False) as shown:
        for step in result.steps:
            before()
            shown.step(step)


def test_one_day_is_a_day(result):
    day = replace(result, period=replace(result.period, scored_s=DAY_S), steps=result.steps[:24])
    (line,) = lines_of(day)
    assert line.startswith("native: 1 day in ")


def lines_of(result, *, terminal=False, seconds_a_step=0.0, monkeypatch=None):
    """What is shown of a loop whose steps each take a time on a clock of its own."""
    now = [0.0]
    if monkeypatch:
        monkeypatch.setattr(display.time, "monotonic", lambda: now[0])
    console = Console(file=io.StringIO(), width=200, force_terminal=terminal)
    show(result, console, lambda: now.__setitem__(0, now[0] + seconds_a_step))
    return console.file.getvalue().splitlines()


def test_a_loop_is_one_line_with_what_it_found(result):
    (line,) = lines_of(result)
    assert line.startswith("native: 9 days in ")
    assert line.endswith(" s  0.5000 EUR/m²  1.00 K·h")


def test_a_loop_that_takes_long_says_so_now_and_then_and_less_often(result, monkeypatch):
    lines = lines_of(result, seconds_a_step=2.0, monkeypatch=monkeypatch)
    days = [line.split("day")[1].split("/")[0].strip() for line in lines[:-1]]
    assert days[:5] == ["0.12", "0.25", "0.50", "1.00", "2.00"], "after 6, 12, 24, … s"
    assert days[5:] == ["3.25", "4.50", "5.75", "7.00", "8.25"], "and none later than a minute after the one before"

    assert lines[-1].startswith("native: 9 days in 7 min")


@pytest.mark.slow
def test_until_a_plant_has_warmed_up_it_is_said_that_it_does(monkeypatch):
    monkeypatch.setattr(display, "SAID_AFTER_S", 0.1)
    console = Console(file=io.StringIO(), width=200)
    with ProbingDisplay(console, False, "Probing for 3 days and identifying") as progress:
        time.sleep(0.35)
        progress(ProbingProgress(0.5, 3.0))
        said = console.file.getvalue()
        time.sleep(0.8)
    begins, *lines = said.splitlines()
    assert begins == "Probing for 3 days and identifying"
    assert "the plant warms up under its own control before the probing: " in lines[0]
    later = console.file.getvalue().splitlines()[1 + len(lines) :]
    assert later, "a slow step, or a look at what is known, is no silence either"
    assert all(line.startswith("probing: day  0.50/3") for line in later), "it has warmed up"
    assert later[-1].endswith(" ago")


class Gated:
    """Of a contestant that is controlled without a model where none is found."""

    has_gate = True


def slowly(*_: object, **__: object) -> None:
    """What takes a while, and finds nothing."""
    time.sleep(0.3)
    raise DataError("nothing was found")


def identified_in_a_run(monkeypatch, folder):
    def found(task, plant, on_record, **_: object) -> None:
        on_record(None)
        slowly()

    monkeypatch.setattr(run_models, "run_identification", found)
    task = SimpleNamespace(in_words=lambda keep: "Probing")
    run_models.identify_all([SimpleNamespace(name="mpc", chosen=Gated(), model_from=task)], None, RunDisplay())


def identified_from_measurements(monkeypatch, folder):
    monkeypatch.setattr(measured_model, "model_of_measurements", slowly)
    CliRunner().invoke(cli, ["identify", "--data", "a.csv", "--map", "a.yaml", "--out", str(folder / "model")])


def checked(monkeypatch, folder):
    monkeypatch.setattr(load, "read_measurements", slowly)
    (folder / "a.csv").touch()
    CliRunner().invoke(cli, ["data", "check", str(folder / "a.csv"), "--map", "a.yaml"])


@pytest.mark.parametrize(
    ("phase", "said"),
    [
        (identified_in_a_run, "a model is identified: "),
        (identified_from_measurements, "the measurements are read and a model is identified: "),
        (checked, "the measurements are read: "),
    ],
)
def test_a_phase_that_takes_long_is_said(phase, said, monkeypatch, tmp_path):
    lines: list[str] = []
    monkeypatch.setattr(display, "SAID_AFTER_S", 0.1)
    monkeypatch.setattr(Console, "print", lambda self, text, **_: lines.append(str(text)))
    phase(monkeypatch, tmp_path)
    of_phase = [line for line in lines if line.endswith(" so far")]
    assert of_phase
    assert all(line.startswith(said) for line in of_phase)


def test_a_loop_that_fails_has_no_line_of_what_it_found(result):
    broken = replace(result, steps=(result.steps[0], None))
    console = Console(file=io.StringIO(), width=200, force_terminal=False)
    with pytest.raises(AttributeError):
        show(broken, console)
    assert console.file.getvalue() == ""


def test_on_a_terminal_the_progress_gives_way_to_that_line(result):
    shown = "\n".join(lines_of(result, terminal=True))
    assert "day" in shown
    assert shown.rstrip().splitlines()[-1].split("\r")[-1].split("\x1b[2K")[-1].startswith("native: 9 days in ")
