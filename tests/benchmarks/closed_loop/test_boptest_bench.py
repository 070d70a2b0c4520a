"""The bench on FMUs: what it refuses, what its targets are, and what a failed case counts as."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.closed_loop.boptest import Case, Outcome, run_boptest_bench, targets
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.execution import LocalEngine


def outcome(testcase: str, cost: float, discomfort: float) -> Outcome:
    kpis = {
        "thermoforce_mpc": {"cost_tot": cost, "tdis_tot": discomfort},
        "native": {"cost_tot": 1.0, "tdis_tot": 10.0},
    }
    return Outcome(Case(Path("x.fmu"), testcase, "peak_heat_day", "constant", 14.0), kpis, {"solved": 1344})


@pytest.mark.parametrize(
    ("testcase", "cost", "discomfort", "holds"),
    [
        ("bestest_air", 1.0, 2.0, [True, True]),
        ("bestest_air", 1.001, 2.1, [False, False]),
        ("bestest_hydronic", 1.01, 1.0, [True, True]),
        ("bestest_hydronic", 1.02, 1.1, [False, False]),
        ("another", 1.0, 10.0, [True, True]),
    ],
)
def test_targets_are_those_of_the_test_case(testcase, cost, discomfort, holds):
    assert [target.holds for target in targets([outcome(testcase, cost, discomfort)])] == holds


def test_a_failed_case_meets_no_target_and_says_why():
    case = Case(Path("x.fmu"), "bestest_air", "mix_day", "constant", 14.0)
    failed = Outcome(case, failed="PlantError: the FMU stopped")
    assert [target.holds for target in targets([failed])] == [False, False]
    assert failed.row()["plans"] == "PlantError: the FMU stopped"


def test_a_folder_without_an_fmu_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"no file ends in \.fmu"):
        run_boptest_bench(tmp_path, engine=LocalEngine(1))
