"""Every example is run as a user would run it."""

from __future__ import annotations

import re
import runpy
import sys
from dataclasses import replace

import pytest
from pages import PAGES, blocks
from places import ROOT
from remembered import remember_probing

from thermoforce_mpc.data import HOUR_S, Period
from thermoforce_mpc.experiment import identifying
from thermoforce_mpc.loop import closed_loop

# Arguments with which an example that trains for long is quick.
QUICK = {"train_agent": ["--steps", "600", "--days", "0.25", "--without-mpc"]}
# Hours at most of which an example controls a building: each plans, acts and prints as in days.
CONTROLLED_H = 3.0
# As a user's Python has it: warnings of packages do not end an example.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]

FOLLOWED = "".join(block.text for page in PAGES for block in blocks(page) if block.run_by == "tests/test_docs_code.py")
EXAMPLES = sorted(path for path in (ROOT / "examples").glob("*.py") if f"examples/{path.name}" not in FOLLOWED)


def test_there_are_examples():
    assert len(EXAMPLES) > 8
    assert {path.name for path in (ROOT / "examples").glob("*.py")} - {path.name for path in EXAMPLES} == {
        "practice_export.py", "practice_house.py",
    }, "the tutorial's, which tests/test_docs_code.py runs in processes of their own"  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def hurried():
    """The same house is probed once, for three days, and controlled for hours."""
    run = closed_loop.run_closed_loop

    def for_hours(plant, controller, period: Period, *args, **options):
        return run(
            plant, controller, replace(period, scored_s=min(period.scored_s, CONTROLLED_H * HOUR_S)), *args, **options
        )

    with pytest.MonkeyPatch.context() as patch:
        remember_probing(patch)
        patch.setattr(
            identifying,
            "model_for",
            lambda source, plant: identifying.identify_on(plant, before=plant.period(source.period), days=3),
        )
        patch.setattr(closed_loop, "run_closed_loop", for_hours)
        yield


@pytest.fixture
def printed(monkeypatch, tmp_path, capsys):
    """What an example prints that is run in an empty folder: as the main module, in this process."""
    monkeypatch.chdir(tmp_path)

    def run(path, *words: object) -> str:
        monkeypatch.setattr(sys, "argv", [str(path), *map(str, words)])
        runpy.run_path(str(path), run_name="__main__")
        return capsys.readouterr().out

    return run


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_and_prints_something(path, printed):
    assert len(printed(path, *QUICK.get(path.stem, [])).splitlines()) >= 2


def test_figures_on_a_recorded_run(shared, printed, tmp_path):
    script = next(path for path in EXAMPLES if path.stem == "interventions_figures")
    told = printed(script, shared / "boptest_hp", "--out", tmp_path / "figures")
    with_actions, without = (float(word) for word in re.findall(r"(\d+\.\d+) K", told)[:2])
    assert with_actions < 0.7 * without
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"decomposition.png", "counterfactuals.png"}
