"""The probing bench tells rows and targets that can be read and that fit together."""

from __future__ import annotations

import json

import pytest

from benchmarks.probing.bench import run_probing_bench

pytestmark = pytest.mark.slow


def test_bench_of_probing():
    result = run_probing_bench(quick=True)
    json.dumps(result)
    rows = {(r["draws"], r["data"]): r for r in result["rows"]}
    worth = {draws: row["information_nats"] for (draws, data), row in rows.items() if "3 days" in data}
    assert worth["informative"] > worth["random"]
    for target in result["targets"]:
        least = target["sense"] == "at least"
        holds = target["value"] >= target["goal"] if least else target["value"] <= target["goal"]
        assert target["holds"] == holds
