"""Every example is run as a user would run it."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from places import ROOT

# Arguments with which an example that trains or controls for long is quick.
QUICK = {
    "train_agent": ["--steps", "2048", "--days", "0.5", "--without-mpc"],
    "tariff_worth": ["", "", "peak_heat_day", "0.5"],
    "perfect_forecast": ["synthetic", "peak_heat_day", "0.25"],
}
pytestmark = pytest.mark.slow

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def test_there_are_examples():
    assert EXAMPLES


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_and_prints_something(path, tmp_path):
    command = [sys.executable, str(path), *QUICK.get(path.stem, [])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) >= 2


def test_figures_on_a_recorded_run(shared, tmp_path):
    script = next(path for path in EXAMPLES if path.stem == "interventions_figures")
    done = subprocess.run(
        [sys.executable, str(script), str(shared / "boptest_hp"), "--out", str(tmp_path / "figures")],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    with_actions, without = (float(word) for word in re.findall(r"(\d+\.\d+) K", done.stdout)[:2])
    assert with_actions < 0.7 * without
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"decomposition.png", "counterfactuals.png"}
