"""The thermostat that is as comfortable as a controller, on thermostats whose discomfort is a known function."""

from __future__ import annotations

import json
import math
import re

import pytest
from click.testing import CliRunner

from controllers.registry import choose
from thermoforce_mpc.cli import cli
from thermoforce_mpc.comparison import tasks as comparison_tasks
from thermoforce_mpc.comparison.cells import Inputs, Variant, expand
from thermoforce_mpc.comparison.outcome import outcome_rows, verdicts
from thermoforce_mpc.comparison.store import Store
from thermoforce_mpc.comparison.tasks import EqualComfort, follow
from thermoforce_mpc.experiment.equal_comfort import (
    AsComfortable,
    as_comfortable,
    raised,
)
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.scenario import Scenario

TESTCASE = "bestest_hydronic_heat_pump"


class House:
    """Discomfort falls with the set-point, from `cold` K·h per K below `enough_K`; above `warm_K` it rises again."""

    def __init__(self, enough_K: float = 0.0, warm_K: float = 9.0, least_KH: float = 0.0) -> None:
        self.enough_K, self.warm_K, self.least_KH, self.runs = enough_K, warm_K, least_KH, []

    def __call__(self, shift_K: float) -> dict[str, float]:
        self.runs.append(shift_K)
        cold, warm = max(self.enough_K - shift_K, 0.0), max(shift_K - self.warm_K, 0.0)
        return {"cost_tot": 1.0 + 0.06 * shift_K, "tdis_tot": self.least_KH + 10.0 * (cold + warm)}

    def beside(self, discomfort_Kh: float) -> AsComfortable:
        return as_comfortable(self, self(0.0), discomfort_Kh)


@pytest.mark.parametrize("enough_K", [-1.0, -0.33, -0.05, 0.0, 0.12, 0.5, 1.2])
def test_it_is_the_coldest_set_point_that_is_comfortable_enough(enough_K):
    house = House(enough_K)
    found = house.beside(0.4)
    # 0.4 + 0.1 K·h are 0.05 K at 10 K·h per K.
    assert enough_K - 0.05 - 1e-6 <= found.shift_K <= enough_K + 0.02
    assert found.comparable
    assert found.kpis["tdis_tot"] <= 0.5 + 1e-9
    assert len(set(house.runs)) == len(house.runs) - 1 or len(set(house.runs)) == len(house.runs)
    assert len(house.runs) < 10


def test_a_colder_baseline_is_no_saving():
    """At its own set-point the thermostat costs less, and leaves 3 K·h more."""
    found = House(0.3).beside(0.0)
    assert House(0.3)(0.0)["cost_tot"] < 1.015
    assert found.kpis["cost_tot"] == pytest.approx(1.018, abs=0.004)
    assert found.saving(0.99) == pytest.approx(1.0 - 0.99 / found.kpis["cost_tot"])
    assert found.beaten(0.99) is True
    assert found.beaten(1.05) is False


def test_a_house_that_is_too_warm_is_searched_at_lower_set_points():
    found = House(-2.0, warm_K=-0.5).beside(0.4)
    assert found.comparable
    assert found.shift_K <= -0.45 + 1e-6, "there 0.5 K·h are left, and lower ones cost less still"


@pytest.mark.parametrize("house", [House(0.3, warm_K=0.3, least_KH=5.0), House(0.0, warm_K=0.0, least_KH=2.0)])
def test_where_no_set_point_is_as_comfortable_it_is_the_best_there_is(house):
    found = house.beside(1.0)
    assert not found.comparable
    assert abs(found.shift_K - house.enough_K) <= 0.2
    assert found.beaten(0.9) is True, "cheaper and more comfortable"
    assert found.beaten(1.5) is None, "dearer and more comfortable: neither"
    assert len(house.runs) < 12


def test_what_costs_nothing_has_no_share_to_save():
    assert math.isnan(AsComfortable(0.0, {"cost_tot": 0.0, "tdis_tot": 0.0}, True).saving(1.0))


def test_set_points_move_to_where_zones_are_more_comfortable():
    heated = load_testcase("bestest_hydronic_heat_pump")
    config = raised(choose("thermostat", {"step_s": 600.0}, heated), 0.25).config
    assert config.step_s == 600.0
    assert list(config.setpoints_C.values()) == [pytest.approx(21.3 + 0.25)]
    both = load_testcase("bestest_air")
    plain = choose("thermostat", {}, both)
    before, after = plain.config, raised(plain, 0.25).config
    assert after.cooling_setpoint_C == pytest.approx(before.cooling_setpoint_C - 0.25)
    (name,) = both.layout.names.actuators
    assert after.setpoints_C[name] == pytest.approx(before.setpoints_C.get(name, before.setpoint_C) + 0.25)


def test_it_is_searched_where_runs_take_seconds_or_where_asked_for():
    assert Experiment.of(Scenario(testcase=TESTCASE)).equal_comfort
    assert not Experiment.of(Scenario(testcase=TESTCASE, equal_comfort=False)).equal_comfort
    service = {"kind": "boptest", "url": "http://127.0.0.1:1"}
    assert not Experiment.of(Scenario(testcase=TESTCASE, plant=service)).equal_comfort
    assert Experiment.of(Scenario(testcase=TESTCASE, plant=service, equal_comfort=True)).equal_comfort


@pytest.mark.slow
def test_cells_beside_thermostats_are_searched_once(tmp_path, monkeypatch):
    """Native control stands for a controller with a model, which is identified elsewhere."""
    inputs, testcase, store = Inputs(), load_testcase(TESTCASE), Store(tmp_path)
    variants = {"thermostat": Variant(controller="thermostat"), "mine": Variant(controller="native")}
    cells = expand(Scenario(testcase=TESTCASE, days=0.5), variants, ("44",), ("constant",), inputs=inputs)
    store.create()
    records = [follow(cell).record | {"needs_model": cell.variant == "mine"} for cell in cells]
    said: list[str] = []
    search = EqualComfort(store, inputs, testcase, said.append)
    thermostat, mine = search.beside(cells, records)
    assert "equal_comfort" not in thermostat
    found = mine["equal_comfort"]
    assert found["comparable"]
    assert found["kpis"]["tdis_tot"] <= mine["kpis"]["tdis_tot"] + 0.1
    assert found["saving"] == pytest.approx(1.0 - mine["kpis"]["cost_tot"] / found["kpis"]["cost_tot"])
    assert found["in_words"] in said[0]
    rows = outcome_rows([thermostat, mine])
    assert [row["saving"] for row in rows] == [None, pytest.approx(100.0 * found["saving"])]
    assert any(found["in_words"] in line for line in verdicts(rows))
    monkeypatch.setattr(comparison_tasks, "follow", lambda cell: pytest.fail("it is stored"))
    assert search.beside(cells, records)[1]["equal_comfort"] == found


def test_a_thermostat_that_was_not_moved_is_at_its_set_point():
    moved, still = (AsComfortable(K, {"cost_tot": 0.5, "tdis_tot": 0.1}, True) for K in (-0.1, 0.0))
    assert moved.in_words(0.4, "EUR").startswith("20.0 % less than a thermostat -0.10 K from its set-point (0.5000 EUR")
    assert still.in_words(0.4, "EUR").startswith("20.0 % less than a thermostat at its set-point (0.5000 EUR")


@pytest.mark.slow
def test_a_run_says_what_it_saves_at_equal_comfort(tmp_path):
    words = ["--testcase", TESTCASE, "--days", "0.25", "--out", str(tmp_path / "r")]
    options = ("modulation=linear", "sun_on_sensor=false", "late_sensor=false")
    settings = ("days=1.5", "most_days=1.5", *(f"options.{one}" for one in options))
    words += [f"--set=identification.{one}" for one in settings]
    done = CliRunner().invoke(cli, ["run", *words])
    assert done.exit_code == 0, done.output
    said = json.loads((tmp_path / "r" / "kpis.json").read_text())["equal_comfort"]
    assert re.match(
        r"thermoforce_mpc costs [\d.]+ % (less|more) than a thermostat ([+-]\d\.\d\d K from|at) its set-point", said
    )
    assert said in done.output
    assert said in (tmp_path / "r" / "report.html").read_text()
