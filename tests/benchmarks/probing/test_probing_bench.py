"""The probing bench tells rows and targets that can be read and that fit together."""

from __future__ import annotations

import json

import pytest

from benchmarks.probing.bench import run_probing_bench

pytestmark = pytest.mark.slow


def test_bench_of_probing_and_adaptation():
    result = run_probing_bench(quick=True)
    json.dumps(result)
    rows = {(r["part"], r.get("draws"), r["data"]): r for r in result["rows"]}
    worth = {draws: row["information_nats"] for (_, draws, data), row in rows.items() if draws and "3 days" in data}
    assert worth["informative"] > worth["random"]
    adapted = [row for row in result["rows"] if row["part"] == "adaptation"]
    assert len(adapted) == 2
    for row in adapted:
        assert row["true_change"] < 0.9, "the machine must have weakened"
        assert row["found_change"] == pytest.approx(row["true_change"], abs=0.12)
        assert 0 < row["blocks_used"] <= row["blocks"]
    for target in result["targets"]:
        least = target["sense"] == "at least"
        holds = target["value"] >= target["goal"] if least else target["value"] <= target["goal"]
        assert target["holds"] == holds
