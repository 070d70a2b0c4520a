"""Who is best, who is beaten by nobody, and where a baseline wins: on figures worked out by hand."""

from __future__ import annotations

import csv
import io

import pytest
from comparison_records import record

from thermoforce_mpc.comparison.files import FORMS, formatted, write_outcome
from thermoforce_mpc.comparison.outcome import cost_targets, outcome_rows, ranked, verdicts

RECORDS = [
    record("ours", 0.60, 0.10, needs_model=True),
    record("other mpc", 0.66, 0.30, needs_model=True),
    record("thermostat", 0.65, 0.20, needs_model=False),
    record("native", 0.90, 0.00, needs_model=False),
]
FAILED = record("broken", 0, 0, needs_model=True) | {"status": "failed", "reason": "no such file"}


def test_best_front_and_fallbacks():
    rows = {row["controller"]: row for row in outcome_rows([*RECORDS, FAILED])}
    assert [name for name, row in rows.items() if row["best_cost"]] == ["ours"]
    assert [name for name, row in rows.items() if row["best_discomfort"]] == ["native"]
    assert [name for name, row in rows.items() if row["pareto"]] == ["ours", "native"]
    assert rows["ours"]["fallbacks"] == 3
    assert rows["broken"]["cost_tot"] is None


def test_levels_of_a_trained_policy_are_no_fallback():
    """Every plan of `dpc` is checked, and none is shown to be the best: a table said of all of them '96 fallbacks'."""
    policy = record("dpc", 0.6, 0.1, needs_model=True) | {
        "fallback_levels": {"acceptable": 90, "shifted": 2, "solved": 4}
    }
    assert outcome_rows([policy])[0]["fallbacks"] == 2


def test_windows_are_judged_apart():
    rows = outcome_rows([*RECORDS, record("thermostat", 0.1, 0.0, needs_model=False, window="58")])
    assert sum(row["best_cost"] for row in rows) == 2


def test_it_says_where_a_baseline_wins():
    says = "\n".join(verdicts(outcome_rows(RECORDS)))
    assert "baseline thermostat beats other mpc (0.6500 / 0.20 K·h against 0.6600 / 0.30 K·h)" in says
    assert "baseline native is more comfortable than ours" in says
    assert "beats ours" not in says


def test_targets_compare_with_the_thermostat():
    targets = {t.name.split("cost of ")[1]: t for t in cost_targets(outcome_rows(RECORDS))}
    assert targets["ours over thermostat"].value == pytest.approx(0.60 / 0.65)
    assert targets["ours over thermostat"].holds
    assert not targets["other mpc over thermostat"].holds


@pytest.mark.parametrize(
    ("ours", "thermostat", "cheapest"), [(0.0, 0.0, "both"), (-0.02, -0.01, "ours"), (0.1, 0.0, "thermostat")]
)
def test_a_baseline_that_costs_nothing_or_earns_is_compared_without_a_ratio(ours, thermostat, cheapest):
    rows = outcome_rows(
        [record("ours", ours, 0, needs_model=True), record("thermostat", thermostat, 0, needs_model=False)]
    )
    best = [row["controller"] for row in rows if row["best_cost"]]
    assert best == (["ours", "thermostat"] if cheapest == "both" else [cheapest])
    assert [row["controller"] for row in rows if row["pareto"]] == best
    assert f"cheapest at comparable comfort (at most 0.50 K·h) {', '.join(best)}" in verdicts(rows)[0]
    assert cost_targets(rows) == []


def test_the_files_tell_the_same(tmp_path):
    result = write_outcome(tmp_path, [*RECORDS, FAILED], name="compare", title="A <title>", currency="EUR")
    assert result["bench"] == "compare"
    rows = list(csv.DictReader(io.StringIO((tmp_path / "table.csv").read_text(encoding="utf-8"))))
    assert [row["controller"] for row in rows] == [row["controller"] for row in result["rows"]]
    assert rows[-1]["controller"] == "broken"
    costs = [float(row["cost_tot"]) for row in rows if row["comparable"] == "True"]
    assert costs == sorted(costs)
    assert float(rows[0]["cost_tot"]) == 0.60
    table = (tmp_path / "table.md").read_text(encoding="utf-8")
    assert "| ours (front) | 0.6000* | 0.10 |" in table
    assert "failed: broken, 44, constant: no such file" in table
    page = (tmp_path / "comparison.html").read_text(encoding="utf-8")
    assert "A &lt;title&gt;" in page
    assert "emulator" in page.lower()
    assert "no such file" in page
    write_outcome(tmp_path, [*RECORDS, FAILED], name="compare", title="A <title>", currency="EUR")
    assert (tmp_path / "comparison.html").read_text(encoding="utf-8") == page


def test_the_cheapest_is_not_called_best_where_it_leaves_many_times_the_discomfort():
    rows = outcome_rows(
        [
            record("cold", 0.4, 9.2, needs_model=False),
            record("ours", 0.6, 0.3, needs_model=True),
            record("thermostat", 0.7, 0.0, needs_model=False),
        ]
    )
    assert [row["controller"] for row in rows if row["best_cost"]] == ["ours"]
    assert [row["controller"] for row in ranked(rows)] == ["ours", "thermostat", "cold"]
    assert any("cold costs less (0.4000) with 9.20 K·h" in text for text in verdicts(rows))


@pytest.mark.parametrize("form", FORMS)
def test_the_figures_can_be_taken_elsewhere(form):
    rows = outcome_rows([*RECORDS, FAILED])
    text = formatted(rows, form, "title", "EUR")
    for row in rows:
        assert row["controller"].replace("_", "\\_" if form == "latex" else "_") in text
    assert {"csv": "window,price", "latex": "\\toprule", "markdown": "| controller |"}[form] in text


def test_the_discomfort_of_every_zone_is_shown(tmp_path):
    def with_zones(name: str, bath: float, hall: float) -> dict:
        found = record(name, 0.6, (bath + hall) / 2, needs_model=False)
        return found | {"kpis": found["kpis"] | {"tdis_tot[bath]": bath, "tdis_tot[hall]": hall}}

    records = [with_zones("native", 1.25, 0.25), with_zones("thermostat", 0.0, 3.5)]
    write_outcome(tmp_path, records, name="compare", title="t", currency="EUR")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "table.csv").read_text())))
    assert [row["tdis_tot[hall]"] for row in rows] == ["0.25", "3.5"]
    assert "| native | 1.25 | 0.25 |" in (tmp_path / "table.md").read_text()
    page = (tmp_path / "comparison.html").read_text()
    assert "<th>bath</th><th>hall</th>" in page
    assert "<td>3.50</td>" in page
