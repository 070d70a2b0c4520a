"""`python -m benchmarks.speed`: figures of a row from both checkouts, goals, and what it refuses."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.speed.__main__ import PEAK, PROCESSOR, ROWS, WALL, Row, compared, main
from thermoforce_mpc.errors import ConfigError

ROOT = Path(__file__).resolve().parents[3]


def test_a_row_has_figures_of_both_checkouts_and_its_goals():
    row = Row("none: starts Python", ("-S", "-c", "pass"), goals={PEAK: 1.5}, own={PROCESSOR: 1e-9})
    result = compared([row], ROOT, 1)
    assert [one["figure"] for one in result["rows"]] == [PROCESSOR, WALL, PEAK]
    assert all(one["share"] == pytest.approx(one["now"] / one["before"]) for one in result["rows"])
    assert [one["holds"] for one in result["targets"]] == [True, False]


def test_a_command_that_fails_is_told_with_its_words():
    with pytest.raises(ConfigError, match="none: failed in .*\n.*no such thing"):
        compared([Row("none", ("-S", "-c", "raise SystemExit('\\nno such thing')"))], ROOT, 1)


def test_what_is_no_checkout_or_no_row_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="no checkout"):
        compared(ROWS, tmp_path, 1)
    done = CliRunner().invoke(main, ["--against", str(ROOT), "--rows", "help,nothing"])
    assert done.exit_code == 2
    assert "--rows nothing: no row begins so; there are help, tab, names, step" in done.output
