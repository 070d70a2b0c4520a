"""Differences over windows, and how sure they are: against figures worked out by hand and by SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from comparison_records import record
from report_page import data_of
from scipy import stats

from thermoforce_mpc.comparison.files import formatted, write_outcome
from thermoforce_mpc.comparison.outcome import in_words, outcome_rows, pairs, reference_of

COSTS = {"16": (0.55, 0.65), "44": (0.50, 0.58), "108": (0.27, 0.30)}


def records(windows=COSTS):
    return [
        record(name, cost, 0.1 * k, needs_model=name == "ours", window=window)
        for k, (window, both) in enumerate(windows.items())
        for name, cost in zip(("ours", "thermostat"), both, strict=True)
    ]


def test_differences_are_of_the_same_windows_with_students_interval():
    (pair,) = pairs(outcome_rows(records()), "thermostat")
    percent = np.array([100 * (ours / theirs - 1) for ours, theirs in COSTS.values()])
    low, high = stats.t.interval(0.95, 2, percent.mean(), stats.sem(percent))
    assert pair.windows == ("16", "44", "108")
    np.testing.assert_allclose(pair.cost_percent.values, percent)
    assert pair.cost_percent.mean - pair.cost_percent.half == pytest.approx(low)
    assert pair.cost_percent.mean + pair.cost_percent.half == pytest.approx(high)
    assert in_words(pair.cost_percent, 1) == f"{percent.mean():+.1f} ({low:+.1f} to {high:+.1f})"
    assert pair.discomfort_Kh.mean == 0


def test_windows_that_one_of_them_did_not_finish_are_left_out():
    broken = [*records(), record("ours", 0, 0, needs_model=True, window="72") | {"status": "failed"}]
    broken.append(record("thermostat", 0.4, 0.1, needs_model=False, window="72"))
    (pair,) = pairs(outcome_rows(broken), "thermostat")
    assert pair.windows == ("16", "44", "108")


def test_one_window_has_no_interval_and_no_table(tmp_path):
    one = records({"16": COSTS["16"]})
    (pair,) = pairs(outcome_rows(one), "thermostat")
    assert pair.cost_percent.half is None
    write_outcome(tmp_path, one, name="compare", title="t", currency="EUR")
    assert "95 % interval" not in (tmp_path / "table.md").read_text()


def test_seeds_that_change_nothing_are_one_window():
    """A rule beside a rule is the same with each seed: three copies would be an interval of no width."""
    costs = {"44": (0.50, 0.58), "16": (0.55, 0.65)}
    copies = {f"{window}, seed {seed}": both for window, both in costs.items() for seed in (1, 2, 3)}
    (pair,) = pairs(outcome_rows(same_comfort(copies)), "thermostat")
    assert pair.windows == ("44, seed 1", "16, seed 1")
    assert pair.cost_percent.half is None
    copies["44, seed 3"] = (0.51, 0.58)
    (pair,) = pairs(outcome_rows(same_comfort(copies)), "thermostat")
    assert pair.windows == ("44, seed 1", "44, seed 3", "16, seed 1")


def same_comfort(windows):
    return [found | {"kpis": {**found["kpis"], "tdis_tot": 0.1}} for found in records(windows)]


def test_tariffs_are_not_taken_for_windows():
    both = [*records(), *(found | {"price": "dynamic"} for found in records())]
    assert [(pair.price, len(pair.windows)) for pair in pairs(outcome_rows(both), "thermostat")] == [
        ("constant", 3),
        ("dynamic", 3),
    ]


def test_the_reference_is_the_thermostat_else_the_cheapest_rule_else_the_first():
    rows = outcome_rows(records())
    assert reference_of(rows) == "thermostat"
    rules = [record("pi", 0.5, 0, needs_model=False), record("native", 0.9, 0, needs_model=False)]
    assert reference_of(outcome_rows([record("ours", 0.1, 0, needs_model=True), *rules])) == "pi"
    assert reference_of(outcome_rows([record("ours", 0.1, 0, needs_model=True)])) == "ours"
    assert reference_of([]) is None


def test_table_and_page_tell_the_same(tmp_path):
    write_outcome(tmp_path, records(), name="compare", title="t", currency="EUR")
    (pair,) = pairs(outcome_rows(records()), "thermostat")
    table = (tmp_path / "table.md").read_text()
    assert f"| ours | constant | 3 | {in_words(pair.cost_percent, 1)} | +0.00 (+0.00 to +0.00) |" in table
    data = data_of((tmp_path / "comparison.html").read_text())
    (difference,) = (one for one in data["paired"][0]["differences"] if one["reference"] == "thermostat")
    assert difference["cost"]["mean"] == pytest.approx(pair.cost_percent.mean)
    assert difference["cost"]["half"] == pytest.approx(pair.cost_percent.half)
    assert data["reference"] == "thermostat"
    assert {point["name"] for point in data["groups"][0]["points"]} == {"ours", "thermostat"}


def test_two_windows_have_no_interval(tmp_path):
    """Student's t of two has one degree of freedom: ± 12.7 standard errors say nothing."""
    two = records({"16": COSTS["16"], "44": COSTS["44"]})
    (pair,) = pairs(outcome_rows(two), "thermostat")
    assert pair.cost_percent.half is None
    write_outcome(tmp_path, two, name="compare", title="t", currency="EUR")
    assert "| ours | constant | 2 | -14.6 | +0.00 |" in (tmp_path / "table.md").read_text()


def test_latex_holds_the_differences_too():
    text = formatted(outcome_rows(records()), "latex", "t", "EUR")
    assert text.count(r"\begin{tabular}") == 2
    assert "% Difference to thermostat, mean over windows (95 % interval, from three on)" in text
    assert r"ours & constant & 3 & -13.1 (" in text
    seeds = records({"44, seed 1": COSTS["16"], "44, seed 2": COSTS["44"], "44, seed 3": COSTS["108"]})
    assert "mean over windows and seeds" in formatted(outcome_rows(seeds), "latex", "t", "EUR")
