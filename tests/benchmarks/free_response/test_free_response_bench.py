"""The free-response and backbone benches: what a method is shown, how it is scored, what is left out and said."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.free_response import bench, runs
from benchmarks.free_response.runs import cost_rows, interval_runs, look_rows
from benchmarks.free_response.score import forecast_origins, mae_K, score, window
from benchmarks.free_response.sources import Source
from thermoforce_mpc.data import HOUR_S, FreeForecast, Record
from thermoforce_mpc.execution import LocalEngine

pytestmark = pytest.mark.slow


def source(days: int, *, gap: slice | None = None) -> Source:
    """Hourly: a daily wave on weather that matters a little, all made from a seed."""
    rng = np.random.default_rng(0)
    t = np.arange(days * 24 + 1.0)
    outdoor = 5 + 3 * np.cos(2 * np.pi * t / 24) + np.cumsum(0.2 * rng.standard_normal(t.size))
    free = 15 + 0.3 * outdoor + 0.1 * rng.standard_normal(t.size)
    if gap is not None:
        free[gap] = np.nan
    nothing = np.zeros(t.size - 1)
    history = Record(t * HOUR_S, free, outdoor, np.zeros(t.size), nothing, nothing, nothing)
    return Source("made up", "made up", history, free, context_steps=14 * 24, least_context_steps=7 * 24)


class Oracle:
    """Knows the record; its interval is open on one side, so that exactly the values of even hours are inside."""

    name = "oracle"

    def __init__(self, record: Source) -> None:
        self.record, self.seen = record, []

    def forecast(self, free_C, history, boundary):
        now = round(boundary.time_s[0] / HOUR_S)
        self.seen.append((now, round(history.time_s[-1] / HOUR_S), free_C.size, history.n_steps))
        hours = np.round(boundary.time_s[1:] / HOUR_S).astype(int)
        truth = self.record.free_C[hours]
        off = np.where(hours % 2 == 0, 0.0, 1.0)
        return FreeForecast(np.arange(1, 10) / 10, truth + off + np.linspace(-0.5, 0.5, 9)[:, None])


def test_a_method_sees_the_context_and_no_more_and_is_scored_on_what_came():
    record = source(20)
    origins = forecast_origins(record, 5)
    assert len(origins) == 5
    assert origins[0] == 7 * 24
    assert origins[-1] == 19 * 24
    oracle = Oracle(record)
    found = score(oracle, record, origins)
    assert oracle.seen == [(o, o, min(o, 336) + 1, min(o, 336)) for o in origins]
    assert found.inside.mean() == pytest.approx(0.5)
    assert mae_K(found, 24) == pytest.approx(0.5)
    assert mae_K(found, 6) == pytest.approx(0.5)
    free, history, boundary, truth = window(record, 200)
    np.testing.assert_array_equal(truth, record.free_C[201:225])
    assert history.time_s[-1] == boundary.time_s[0]
    assert free[-1] == record.free_C[200]
    assert not np.isfinite(history.u).any()


def test_no_forecast_starts_after_or_before_a_gap():
    origins = forecast_origins(source(20, gap=slice(300, 310)), 1000)
    assert origins
    assert all(o + 24 < 300 or o - 2 * 24 - 1 >= 310 for o in origins)


def test_runs_of_two_weeks_are_scored_after_two_days_and_short_records_are_not(monkeypatch):
    record = source(28)
    built = []

    def build(name, **options):
        built.append((name, options))
        return Oracle(record)

    monkeypatch.setattr(runs, "build_free_response", build)
    rows, targets = interval_runs([record, source(16)], lambda _: None)
    assert built == [("residual", {})]
    assert [row["forecasts"] for row in rows] == [13 * 24 + 1 - 48]
    assert rows[0]["held"] == pytest.approx(0.5, abs=0.01)
    assert rows[0]["held_6h_ahead"] == pytest.approx(rows[0]["held_24h_ahead"], abs=0.01)
    assert [target.holds for target in targets] == [False, False, False]


def test_many_buildings_at_once_cost_less_each_than_one():
    rows = cost_rows(source(20), "shipped")
    assert [row["forecast"] for row in rows] == ["24 h", "48 h", "24 h of 32 buildings at once"]
    assert rows[2]["processor_ms_per_building"] < 0.7 * rows[0]["processor_ms"]


def test_energyplus_zones_run_free_or_are_left_out_with_a_word(monkeypatch):
    from benchmarks.free_response import energyplus

    lines = []
    monkeypatch.setattr(energyplus, "is_available", lambda: False)
    monkeypatch.setattr(bench, "embedded_sources", lambda people=None: [source(15)])
    monkeypatch.setattr(bench, "house_sources", lambda people=None: [])
    others = {"look_rows": [{"looks": 1}], "cost_rows": [{"processor_ms": 1.0}]}  # which have tests of their own
    for name, rows in others.items():
        monkeypatch.setattr(bench, name, lambda *given, rows=rows: rows)
    result = bench.run_free_response_bench(quick=True, progress=lines.append)
    assert lines[0].startswith("EnergyPlus left out")
    assert {row["source"] for row in result["rows"] if {"source", "mae_24h_K"} <= row.keys()} == {"made up"}
    assert [row for rows in others.values() for row in rows if row not in result["rows"]] == []
    monkeypatch.undo()
    pytest.importorskip("pyenergyplus")
    with LocalEngine(1) as engine:
        zones = energyplus.energyplus_sources(engine, days=1)
    assert len(zones) == 3
    for zone in zones:
        assert zone.free_C.size == 25
        assert np.isfinite(zone.free_C).all()
        assert zone.free_C.std() > 0.05
        assert zone.history.solar_W_m2.max() > 100


def test_backbones_are_compared_raw_and_composed(tmp_path):
    from benchmarks.free_response import backbones
    from thermoforce_mpc.model.free_response.chronos import shipped_folder

    records = backbones.embedded_records({"embedded winter": 20}, days=9)
    names = ["shipped", str(shipped_folder())]
    result = backbones.run_backbone_bench(names, records=records, origins=3, quick=True, out=tmp_path)
    by_name = {(row["backbone"], row["record"]): row for row in result["rows"]}
    shipped = by_name["shipped", "embedded winter"]
    again = by_name[str(shipped_folder()), "embedded winter"]
    assert shipped["composed_rmse_K"] == again["composed_rmse_K"]  # the same weights by another name
    assert shipped["composed_rmse_K"] < 0.8 * shipped["raw_rmse_K"]
    assert shipped["change_percent"] == pytest.approx(100 * (shipped["composed_rmse_K"] / shipped["raw_rmse_K"] - 1))
    assert 300_000 < shipped["parameters"] < 1_000_000
    assert ("shipped", "median of 1") in by_name
    assert (tmp_path / "backbones.png").stat().st_size > 1000


def test_a_backbone_that_is_not_there_stops_the_bench_at_once():
    from benchmarks.free_response.backbones import run_backbone_bench
    from thermoforce_mpc.errors import BackboneError

    with pytest.raises(BackboneError, match=r"no config\.json"):
        run_backbone_bench(["shipped", "./nowhere"], quick=True)


def test_several_looks_keep_the_second_day_of_15_minute_forecasts_honest():
    one, several = look_rows("shipped", 6)
    assert one["48 h at 15 min, embedded"] == "one resolution"
    assert several["inside 80 %, second day"] > one["inside 80 %, second day"] + 0.05
    assert several["error in K, first day"] < 1.05 * one["error in K, first day"]
    assert several["error in K, second day"] > several["error in K, first day"] > 0
