"""The bench on generated houses: one short window for real, and rows, targets and command line on made-up outcomes."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest
from click.testing import CliRunner

from benchmarks.closed_loop import buildings, offices
from benchmarks.closed_loop.buildings import (
    Case,
    Outcome,
    identify_by_default,
    run_buildings_bench,
    run_case,
    targets,
)
from benchmarks.closed_loop.offices import OfficeCase, OfficeOutcome
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import DataError, InputError
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.experiment.equal_comfort import AsComfortable

SHORT = {"scored_days": 0.125, "probed_days": 1.0}


def outcome(mpc=(0.9, 1.0), thermostat=(1.0, 1.0), energy=1.0, native=(1.1, 0.0), **changes) -> Outcome:
    kpis = {
        "thermoforce_mpc": {"cost_tot": mpc[0], "tdis_tot": mpc[1], "ener_tot": energy},
        "thermostat": {"cost_tot": thermostat[0], "tdis_tot": thermostat[1], "ener_tot": energy},
        "native": {"cost_tot": native[0], "tdis_tot": native[1], "ener_tot": energy},
    }
    equal = AsComfortable(0.1, {"cost_tot": 1.02 * thermostat[0], "tdis_tot": mpc[1]}, True)
    values = {
        "case": Case(1, 0, "cold_week"),
        "house": "a house",
        "kpis": kpis,
        "equal": equal,
        "at_will": replace(equal, kpis=equal.kpis | {"cost_tot": thermostat[0]}),
        "statuses": {"solved": 600, "guard": 3, "gate": 0, "refused": 0},
        "model": {},
        "refused": "",
        "failed": "",
        "seconds": 1.0,
    }
    return Outcome(**(values | changes))


def by_name(outcomes: list[Outcome]) -> list[tuple[float, bool]]:
    return [(target.value, target.holds) for target in targets(outcomes)]


@pytest.mark.slow
def test_one_short_window_for_real():
    models = []

    def identified(*given):
        models.append(identify_by_default(*given))
        return models[0]

    first = run_case(Case(7, 3, "cold_week", draw=True, **SHORT), identified)
    assert first.failed == ""
    assert first.refused == ""
    assert set(first.kpis) == {"thermoforce_mpc", "thermostat", "native"}
    for kpis in first.kpis.values():
        assert kpis["too_cold"] + kpis["too_warm"] == pytest.approx(kpis["tdis_tot"])
    assert sum(first.statuses.values()) == 12  # plans of 15 min in 3 h
    assert "acts_log_odds" in first.model
    assert first.equal.comparable
    assert first.at_will.comparable
    assert first.equal.kpis["tdis_tot"] <= first.kpis["thermoforce_mpc"]["tdis_tot"] + 0.1
    assert first.plot.startswith(b"\x89PNG")
    assert len(first.plot) > 10_000
    again = run_case(Case(7, 3, "cold_week", **SHORT), lambda *given: models[0])
    assert (again.kpis, again.statuses, again.model) == (first.kpis, first.statuses, first.model)


def test_a_refused_record_leaves_the_house_to_its_own_control():
    def refuse(*args):
        raise DataError("no effect of the actuator")

    found = run_case(Case(7, 3, "sunny_week", **SHORT), refuse)
    assert found.failed == ""
    assert found.kpis["thermoforce_mpc"] == found.kpis["native"]
    assert found.row()["plans"] == "refused: no effect of the actuator"
    assert found.statuses == {}


def test_a_failed_window_is_named_and_misses_its_targets():
    def fail(*args):
        raise RuntimeError("the solver is broken")

    found = run_case(Case(7, 3, "sunny_week", **SHORT), fail)
    assert found.failed == "RuntimeError: the solver is broken"
    assert found.row()["plans"] == found.failed
    failed, above, *_ = targets([outcome(), found])
    assert (failed.value, failed.holds) == (1.0, False)
    assert (above.value, above.holds) == (1.0, False)


def test_targets_that_hold():
    good = outcome()
    assert by_name([good] * 3) == [
        (0.0, True), (0.0, True), (0.0, True), (1.0, True), (pytest.approx(1 - 0.9 / 1.02), True), (1.0, True),
        (pytest.approx(0.1), True), (0.0, True), (pytest.approx(0.1), True),
    ]  # fmt: skip


def test_discomfort_is_judged_in_the_worst_window_and_per_week():
    (_, above, worst, *_) = by_name([outcome()] * 9 + [outcome(mpc=(0.9, 1.6))])
    assert above == (1.0, False)
    assert worst == (pytest.approx(0.6), False)
    half = outcome(mpc=(0.9, 1.4), case=Case(1, 0, "cold_week", scored_days=3.5))
    assert by_name([half])[2] == (pytest.approx(0.8), False)


def test_savings_count_where_there_is_heating():
    dear, idle = outcome(mpc=(1.1, 1.0)), outcome(mpc=(0.0, 1.0), thermostat=(0.0, 1.0), energy=0.001)
    assert math.isnan(idle.saving)
    share, median, share_at_its_own, median_at_its_own = by_name([outcome()] * 7 + [dear] * 3 + [idle])[3:7]
    assert share == share_at_its_own == (0.7, False)
    assert median == (pytest.approx(1 - 0.9 / 1.02), True)
    assert median_at_its_own == (pytest.approx(0.1), True)
    assert by_name([outcome(mpc=(0.97, 1.0))])[4] == (pytest.approx(1 - 0.97 / 1.02), False)


def test_a_window_counts_as_cheaper_at_equal_comfort_only():
    warm = AsComfortable(0.4, {"cost_tot": 1.1, "tdis_tot": 0.2}, True)
    none = AsComfortable(1.0, {"cost_tot": 1.1, "tdis_tot": 5.0}, False)
    assert outcome(mpc=(1.05, 0.1), equal=warm).saving_at_equal_comfort == pytest.approx(1 - 1.05 / 1.1)
    assert outcome(mpc=(1.05, 0.1), equal=warm).saving < 0.0
    assert outcome(mpc=(1.05, 0.1), equal=none).saving_at_equal_comfort > 0.0, "better in both"
    assert math.isnan(outcome(mpc=(1.15, 0.1), equal=none).saving_at_equal_comfort)
    row = outcome(mpc=(1.15, 0.1), equal=none).row()
    assert row["as comfortable"] == "1.100 / 5.00 at +1.00 K, not as comfortable"


def test_native_control_is_a_yardstick_where_it_is_as_comfortable():
    dear, colder = outcome(native=(0.8, 1.0)), outcome(native=(0.8, 1.2))
    assert by_name([outcome(), dear, colder])[-2] == (1.0, False)


def test_command_line_prints_every_window_and_says_what_is_missed(monkeypatch, tmp_path):
    asked = []

    def cases_run(cases, engine, progress, keep):
        asked.append((len(cases), engine.width, cases[0].seed))
        kinds = [outcome(plot=b"png"), outcome(mpc=(1.2, 9.0)), outcome(refused="it explains 2 %", statuses={})]
        return [kinds[i % 3] for i, _ in enumerate(cases)]

    def no_office(n, seed, engine, progress, keep):
        asked.append((n, engine.width, seed))
        office = OfficeCase("office:3rooms:500", "cold_week")
        return [OfficeOutcome(office, "an office", {}, {}, {}, {}, "RuntimeError: broken")]

    monkeypatch.setattr(buildings, "run_cases", cases_run)
    monkeypatch.setattr(buildings, "run_offices", no_office)
    out = tmp_path / "plots"
    options = [
        "--houses",
        "3",
        "--offices",
        "2",
        "--seed",
        "5",
        "--jobs",
        "1",
        "--out",
        str(out),
        "--json",
        str(tmp_path / "r.json"),
    ]
    shown = CliRunner().invoke(cli, ["bench", "buildings", *options])
    assert shown.exit_code == 0, shown.output
    assert asked == [(6, 1, 5), (2, 1, 5)]
    for text in (
        "solved 600, guard 3",
        "DOES NOT HOLD",
        "it explains 2 %",
        "plans: guard",
        "1.200 / 9.00",
        "office:3rooms:500",
    ):
        assert text in shown.output
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["bench"] == "buildings"
    refused = next(row for row in result["rows"] if row.get("what", "").startswith("identification refused"))
    assert refused["windows"] == 2
    assert len(json.loads((out / "outcomes.json").read_text())["cases"]) == 6


@pytest.mark.parametrize("changes", [{}, {"plot": b"\x89PNG"}, {"equal": None, "failed": "RuntimeError: broken"}])
def test_what_is_kept_of_a_window_is_all_of_it(monkeypatch, changes):
    found = outcome(**changes)
    monkeypatch.setattr(buildings, "run_case", lambda case: found)
    assert buildings.outcome_of(json.loads(json.dumps(buildings.run_as_json(found.case)))) == found


def test_what_is_kept_of_an_office_is_all_of_it(monkeypatch):
    kpis = {"cost_tot": 1.0, "tdis_tot": 0.2}
    found = OfficeOutcome(
        OfficeCase("office:3rooms:500", "cold_week"), "", kpis, kpis, {0: kpis, 2: kpis}, {"solved": 3}
    )
    monkeypatch.setattr(offices, "run_office", lambda case: found)
    assert offices.outcome_of(json.loads(json.dumps(offices.run_as_json(found.case)))) == found


def test_the_shown_default_is_the_reported_population():
    command = cli.get_command(None, "bench").commands["buildings"]
    (seed,) = [option.default for option in command.params if option.name == "seed"]
    assert seed == buildings.REPORTED_SEED


def test_quick_runs_a_few_houses_and_none_is_refused(monkeypatch):
    seen: list[Case] = []

    def cases_run(cases, engine, progress, keep):
        seen.extend(cases)
        return [outcome() for _ in cases]

    asked: list[int] = []
    monkeypatch.setattr(buildings, "run_cases", cases_run)
    monkeypatch.setattr(buildings, "run_offices", lambda n, *others: asked.append(n) or [])
    result = run_buildings_bench(quick=True, engine=LocalEngine(1))
    assert (len(seen), asked) == (8, [1])
    assert not any("office" in target["name"] for target in result["targets"]), "none was run"
    assert not seen[0].draw
    with pytest.raises(InputError, match="0 houses"):
        run_buildings_bench(houses=0, engine=LocalEngine(1))
