"""The bench of constants: which there are, what a third more is, and what is said of it."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from benchmarks.constants import by_a_third, constants, in_words, keep, moved


@pytest.mark.slow
def test_constants_are_numbers_at_the_top_of_modules():
    places = {constant.place: constant for constant in constants()}
    assert len(places) > 300
    assert places["controllers.optimisation.problem.POWER_UNIT_W"].value() == 1000.0
    assert "controllers.mpc.margins.OF_LOOPS" not in places


@pytest.mark.parametrize(
    ("value", "changed"), [(3, 4), (1, 2), (0.3, 0.4), (0.7, 0.6), (-3.0, -4.0), ((0.9, 6), (13 / 15, 8))]
)
def test_a_third_more(value, changed):
    assert by_a_third(value) == pytest.approx(changed)


def test_a_third_more_of_an_array_leaves_the_array():
    values = np.array([3.0, 6.0])
    assert by_a_third(values) == pytest.approx([4.0, 8.0])
    assert values == pytest.approx([3.0, 6.0])


def test_what_moved_is_said():
    before = {
        "cost": 2.0,
        "discomfort": 1.0,
        "effect 0 step_response_8h_K": 2.0,
        "model 0 score": 1.0,
        "level u 0": 1.0,
    }
    after = before | {"cost": 1.9, "effect 0 step_response_8h_K": 2.2}
    assert in_words({"house": moved(before, before)}) == "moves nothing"
    assert in_words({"house": moved(before, after)}) == (
        "house: effect 0.091, model 0, levels 0, cost -0.05, discomfort_Kh 0"
    )
    assert in_words({"house": moved(before, "KeyError: 4")}) == "house: KeyError: 4"


@pytest.mark.slow
def test_a_table_keeps_the_last_run_of_each_constant(tmp_path):
    file, nothing = (
        tmp_path / "constants.csv",
        moved({"cost": 1.0, "discomfort": 0.0}, {"cost": 1.0, "discomfort": 0.0}),
    )
    unit, step = "controllers.optimisation.problem.POWER_UNIT_W", "thermoforce_mpc.model.card.FAR_K"
    row = {"constant": unit, "value": "900.0", "line": 1, "house": nothing}
    keep([row, row | {"constant": "controllers.gone.NAME"}], ["house"], file)
    keep([row | {"value": "1000.0"}, row | {"constant": step, "value": "1.0"}], ["house"], file)
    with file.open(newline="") as lines:
        found = {line["constant"]: line for line in csv.DictReader(lines)}
    assert {name: line["value"] for name, line in found.items()} == {unit: "1000.0", step: "1.0"}
    assert found[unit]["a third more"] == "moves nothing"
    assert found[unit]["buildings"] == "house"
