"""The bench of spoiled records: its draws, its faults and what it counts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.records.bench import CLEAN, Answer, run_records_bench, summary, targets
from benchmarks.records.drawing import drawn
from benchmarks.records.spoiling import faults
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.execution import LocalEngine


def answer(fault: str, kinds: tuple[str, ...], size: str = "", emitter: str = "air") -> Answer:
    return Answer("house", "thermostat", emitter, fault, size, kinds)


def test_a_fault_is_rightly_named_where_its_name_alone_is_said() -> None:
    answers = [
        answer(CLEAN, ()),
        answer(CLEAN, ("stamps late",)),
        answer("stamps late", ("stamps late",), "15 min"),
        answer("stamps late", ("stamps late", "unit of power"), "15 min"),
        answer("stamps late", (), "15 min", emitter="floor"),
        answer("unit of power", ("stamps early",), "kW", emitter="floor"),
    ]
    rows = summary(answers)
    assert [(row["fault"], row["of"], row["records"]) for row in rows] == [
        (CLEAN, "all", 2), ("stamps late", "air", 2), ("stamps late", "floor", 1), ("unit of power", "all", 1),
    ]  # fmt: skip
    assert [(row["found_percent"], row["right_percent"]) for row in rows] == [(50, None), (100, 50), (0, 0), (100, 0)]
    assert [target.value for target in targets(answers)] == [0.5, pytest.approx(1 / 3), 0.0]
    assert not any(target.holds for target in targets(answers))


@pytest.mark.slow
def test_the_same_seed_draws_the_same_record_and_every_fault_changes_it() -> None:
    clean, again, other = drawn("thermostat", 3, 0), drawn("thermostat", 3, 0), drawn("thermostat", 3, 1)
    np.testing.assert_array_equal(clean.record.T_zone_C, again.record.T_zone_C)
    assert not np.array_equal(clean.record.T_out_C, other.record.T_out_C)
    assert np.unique(clean.setpoint_C).size == 2
    metered = replace(clean, record=replace(clean.record, heat_W=clean.record.power_W))
    for fault in faults():
        spoiled = fault.spoil(metered, np.random.default_rng(1))
        assert spoiled is not None
        signals = ("T_out_C", "u", "power_W", "heat_W")
        assert any(
            not np.array_equal(getattr(spoiled, name), getattr(metered.record, name), equal_nan=True)
            for name in signals
        ), fault
        np.testing.assert_array_equal(spoiled.T_zone_C, clean.record.T_zone_C)


def test_no_houses_are_refused() -> None:
    with pytest.raises(InputError, match="0 houses: expected at least one"):
        run_records_bench(houses=0, engine=LocalEngine(1))


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_the_command_runs_and_writes_its_answers(tmp_path: Path) -> None:
    file = tmp_path / "records.json"
    words = ["bench", "records", "--houses", "1", "--seed", "5", "--jobs", "1", "--json", str(file)]
    done = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    result = json.loads(file.read_text(encoding="utf-8"))
    assert {a["operation"] for a in result["answers"]} == {"probing", "thermostat", "rooms"}
    assert "share of" in done.output
    named = [a["right"] for a in result["answers"] if a["fault"] == "unit of temperature"]
    assert named == [True, True, True]
