"""Progress of many tasks as it is read."""

from __future__ import annotations

import io
import time

from rich.console import Console

from thermoforce_mpc.execution import Task, TaskOutcome, TaskProgress

TASKS = [Task(f"k{n}", f"task {n}", print, None) for n in range(3)]


def shown(**console) -> str:
    out = io.StringIO()
    with TaskProgress(Console(file=out, width=100, **console)) as progress:
        progress.planned(3)
        for task in TASKS:
            progress.begun(task)
        progress.told(TASKS[0], 0.5)
        if console:
            time.sleep(0.25)  # bars are drawn ten times a second
        progress.ended(TaskOutcome(TASKS[0], 1, "", 12.0, 1))
        progress.ended(TaskOutcome(TASKS[1], None, "no [heat]", 1.0, 1))
        progress.ended(TaskOutcome(TASKS[2], 1, "", 3.0, 1))
    return out.getvalue()


def test_a_log_has_a_line_for_each_start_and_end():
    lines = shown().splitlines()
    assert lines[:3] == ["started task 0", "started task 1", "started task 2"]
    assert lines[3].startswith("done    [1/3] task 0 (12 s); about ")
    assert lines[4].startswith("FAILED  [2/3] task 1: no [heat]; about ")
    assert lines[5] == "done    [3/3] task 2 (3 s)"


def test_a_task_that_is_begun_again_is_one_task():
    def shown_again(**console) -> str:
        out = io.StringIO()
        with TaskProgress(Console(file=out, width=100, **console)) as progress:
            progress.planned(1)
            progress.begun(TASKS[0])
            progress.begun(TASKS[0])
            progress.ended(TaskOutcome(TASKS[0], 1, "", 12.0, 2))
        return out.getvalue()

    assert shown_again().splitlines() == ["started task 0", "started task 0 again", "done    [1/1] task 0 (12 s)"]
    last = shown_again(force_terminal=True).rsplit("1 of 1 done", 1)[-1]
    assert "task 0" not in last, "no bar of it is left"


def test_a_terminal_has_bars_with_time_left():
    text = shown(force_terminal=True)
    assert "0 of 3 done" in text
    assert " left" in text
    assert "started" not in text


def test_quiet_shows_nothing():
    out = io.StringIO()
    with TaskProgress(Console(file=out), quiet=True) as progress:
        progress.planned(1)
        progress.begun(TASKS[0])
        progress.ended(TaskOutcome(TASKS[0], 1, "", 12.0, 1))
    assert out.getvalue() == ""
