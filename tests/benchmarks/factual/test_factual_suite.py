"""The factual suite on small records whose truth is known."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from here import Here

from benchmarks.factual import suite, tables
from benchmarks.factual.bench import run_factual_bench
from benchmarks.factual.evaluate import BEST, METHODS, OURS, RAW, RESIDUAL_PERSISTED, Scores
from benchmarks.factual.homes import Home, prepared
from benchmarks.factual.protocol import Protocol
from benchmarks.factual.suite import run_suite
from benchmarks.free_response.scales import SMALLER
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.errors import DataError

_STEP_S, _PER_DAY = 1800.0, 48
_SMALL = Protocol(days=(3,), most_origins=12)


def _home(name: str, days: float, *, effect_K: float, seed: int = 3) -> Home:
    """A room with one mode of 5 h that a metered heater warms by up to `effect_K`, on at random hours."""
    rng = np.random.default_rng(seed)
    n = round(days * _PER_DAY)
    hours = np.arange(n + 1) / 2.0
    T_out = 4.0 + 3.0 * np.sin(2 * np.pi * (hours - 9) / 24) + np.cumsum(rng.normal(0, 0.15, n + 1))
    sun = np.maximum(0.0, 300.0 * np.sin(2 * np.pi * (hours - 6) / 24))
    level = np.repeat(rng.choice([0.0, 0.0, 0.5, 1.0], n // 6 + 1), 6)[:n]
    forced, free = np.zeros(n + 1), np.full(n + 1, 16.0)
    pole, slow = np.exp(-0.5 / 5.0), np.exp(-0.5 / 40.0)
    for t in range(n):
        forced[t + 1] = pole * forced[t] + (1 - pole) * effect_K * level[t]
        free[t + 1] = slow * free[t] + (1 - slow) * (10.0 + T_out[t] + 0.01 * sun[t])
    T = free + forced + rng.normal(0, 0.03, n + 1)
    nothing = np.full(n, np.nan)
    record = Record(hours * 3600.0, T, T_out, sun, nothing, nothing, nothing)
    return Home(name, "made", record, {"heater": 800.0 * level})


@pytest.fixture(scope="module")
def homes() -> list[Home]:
    return [_home("strong heater", 20, effect_K=8.0), _home("no effect", 20, effect_K=0.0, seed=4)]


@pytest.fixture(scope="module")
def engine() -> Iterator[Here]:
    with Here() as made:
        yield made


@pytest.fixture(scope="module")
def run(homes: list[Home], engine: Here, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Scores], Path]:
    folder = tmp_path_factory.mktemp("factual")
    scores, _, computed = run_suite(homes, _SMALL, folder, backbone="shipped_tiny", engine=engine)
    assert computed == 2
    return scores, folder


def _error(scores: Scores, method: str, hours: str = "6") -> float:
    return next(iter(scores.errors[method].values()))[hours]


@pytest.mark.slow
def test_all_methods_are_scored_at_both_horizons(run: tuple[list[Scores], Path]) -> None:
    for scores in run[0]:
        assert set(scores.errors) == set(METHODS)
        assert all(np.isfinite(_error(scores, m, h)) for m in METHODS for h in ("6", "24"))


def test_an_operator_is_found_where_the_heater_acts(run: tuple[list[Scores], Path]) -> None:
    strong = run[0][0]
    assert _error(strong, OURS) < 0.7 * _error(strong, RAW)
    assert _error(strong, BEST) < 0.7 * _error(strong, RAW)
    assert strong.window["gain_K"] > 3.0
    # Its fan rises with the level at every step; the raw forecast has none.
    assert (np.diff(np.array(strong.window["fan_C"]), axis=0) > 0).all()


def test_without_an_effect_thermoforce_is_the_raw_forecast(run: tuple[list[Scores], Path]) -> None:
    idle = run[0][1]
    assert _error(idle, OURS) == _error(idle, RAW)
    assert "no operator" in idle.notes[OURS]["3"]
    assert "fan_C" not in idle.window


@pytest.mark.slow
def test_scores_are_kept_and_computed_anew_for_other_data(
    homes: list[Home], run: tuple[list[Scores], Path], engine: Here
) -> None:
    scores, folder = run
    again, _, computed = run_suite(homes, _SMALL, folder, backbone="shipped_tiny", engine=engine)
    assert computed == 0
    assert [s.errors for s in again] == [s.errors for s in scores]
    warmer = replace(homes[1], record=replace(homes[1].record, T_zone_C=homes[1].record.T_zone_C + 1.0))
    anew, _, computed = run_suite([homes[0], warmer], _SMALL, folder, backbone="shipped_tiny", engine=engine)
    assert computed == 1
    assert anew[0].errors == scores[0].errors
    assert anew[1].errors != scores[1].errors


def test_scores_are_computed_anew_for_other_weights(
    homes: list[Home], engine: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights = tmp_path / "weights"
    shutil.copytree(SMALLER["shipped_tiny"], weights)

    def computed() -> int:
        folder, backbone = tmp_path / "scores", str(weights)
        return run_suite([homes[1]], _SMALL, folder, backbone=backbone, engine=engine, evaluate=_nothing)[2]

    assert (computed(), computed()) == (1, 0)
    (weights / "more.json").write_text("{}")
    assert (computed(), computed()) == (1, 0)
    monkeypatch.setattr(suite, "source_fingerprint", lambda *packages: "other")
    assert computed() == 1


def _nothing(task: tuple) -> Scores:
    """Scores of a home without forecasting anything."""
    zero = {"0": {"6": 0.0}, "3": {"6": 0.0}}
    return Scores(task[0].home.name, "made", {RAW: zero, BEST: zero})


@pytest.mark.slow
def test_nothing_is_chosen_on_the_test_part(
    homes: list[Home], run: tuple[list[Scores], Path], engine: Here, tmp_path: Path
) -> None:
    home, first = homes[0], prepared(homes[0], _SMALL).test[0]
    T: Array = home.record.T_zone_C.copy()
    T[0, first + 1 :] += np.random.default_rng(0).normal(0.0, 2.0, T.shape[1] - first - 1)
    changed = replace(home, record=replace(home.record, T_zone_C=T))
    found = run_suite([changed], _SMALL, tmp_path, backbone="shipped_tiny", engine=engine)[0][0]
    assert found.notes == run[0][0].notes
    assert _error(found, RAW) > _error(run[0][0], RAW)


def test_persisted_weather_is_no_oracle(run: tuple[list[Scores], Path]) -> None:
    strong = run[0][0]
    assert _error(strong, RESIDUAL_PERSISTED, "24") != _error(strong, "ThermoForce, residual free response", "24")


def test_parts_never_reach_beyond_the_record() -> None:
    # 232 steps: the shares round up to one step more.
    home = _home("short", 232 / _PER_DAY, effect_K=2.0)
    ready = prepared(home, replace(_SMALL, least_origins=2))
    assert ready.test[1] == 232
    assert all(o + 48 <= 232 for o in ready.origins(ready.test, 48))


def test_a_record_that_is_too_short_says_what_to_do() -> None:
    with pytest.raises(DataError, match="days are too short for forecasts of 24 h"):
        prepared(_home("tiny", 2, effect_K=2.0), _SMALL)


def test_long_gaps_are_not_scored(homes: list[Home]) -> None:
    home = homes[0]
    T_out = home.record.T_out_C.copy()
    few = replace(_SMALL, least_origins=2)
    ready = prepared(home, few)
    gap = slice(ready.test[0] + 20, ready.test[0] + 60)
    T_out[gap] = np.nan
    filled = prepared(replace(home, record=replace(home.record, T_out_C=T_out)), few)
    assert np.isfinite(filled.record.T_out_C).all()
    assert all(o + 48 <= gap.start or o >= gap.stop for o in filled.origins(filled.test, 48))
    assert any("outdoor temperature" in note for note in filled.notes)


def test_wins_and_wilcoxon() -> None:
    ours, raw = np.linspace(0.1, 0.9, 9), np.linspace(0.2, 1.0, 9)
    assert tables.one_sided(ours, raw) == pytest.approx(0.5**9)
    assert tables.one_sided(raw, raw) == 1.0
    scores = [
        Scores(f"{i}", "made", {RAW: {"0": {"6": raw[i], "24": 1.0}}, BEST: {"3": {"6": ours[i], "24": 1.0}}})
        for i in range(9)
    ]
    found = {t.name.split(": ")[1]: t for t in tables.targets(scores, Protocol(days=(3,)))}
    assert found["homes ahead of raw TSFM, 6 h, of 9"].value == 9
    assert found["RMSE over raw TSFM, 6 h, median"].value == pytest.approx(5 / 6)
    assert found["RMSE over raw TSFM, 24 h, median"].holds


@pytest.mark.slow
def test_the_bench_writes_tables_figures_manifest_and_page(homes: list[Home], engine: Here, tmp_path: Path) -> None:
    result = run_factual_bench(
        homes[:1], tmp_path, backbone="shipped_tiny", others=["shipped_tiny"], quick=True, engine=engine
    )
    written = {path.name for path in tmp_path.iterdir()}
    figures = {f"{name}.{kind}" for name in ("few_shot", "decomposition", "fan") for kind in ("png", "svg")}
    expected = {"main", "covariates", "few_shot", "backbones", "homes", "decomposition", "fan"}
    assert figures | {f"{name}.csv" for name in expected} | {"factual.json", "index.html"} <= written
    assert result["manifest"]["protocol"]["days"] == (3,)
    kept = json.loads((tmp_path / "factual.json").read_text())
    assert {t["name"] for t in kept["targets"]} == {t["name"] for t in result["targets"]}


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_your_own_table_by_its_map(homes: list[Home], tmp_path: Path) -> None:
    record = homes[0].record
    frame = pd.DataFrame(
        {
            "when": pd.date_range("2026-01-01", periods=record.time_s.size, freq="30min", tz="UTC"),
            "room": record.T_zone_C[0],
            "out": record.T_out_C,
            "sun": record.solar_W_m2,
            "heater": np.append(homes[0].meters["heater"], 0.0),
        }
    )
    frame.to_csv(tmp_path / "mine.csv", index=False)
    (tmp_path / "map.yaml").write_text(
        "time: {column: when}\noutdoor: out\nsun: {column: sun}\nzones: {living: {temperature: room}}\n"
        "actuators: {stove: {zone: living, heat: heater}}\nstep: 30min\n"
    )
    said = CliRunner().invoke(
        cli,
        ["bench", "factual", "--data", str(tmp_path / "mine.csv"), "--map", str(tmp_path / "map.yaml"), "--quick",
         "--backbone", "shipped_tiny", "--other", "shipped_tiny", "--workers", "1", "--out", str(tmp_path / "out"),
         "--json", str(tmp_path / "out.json")],
        catch_exceptions=False,
    )  # fmt: skip
    assert said.exit_code in (0, 1), said.output
    rows = json.loads((tmp_path / "out.json").read_text())["rows"]
    mine = next(row for row in rows if row.get("home") == "living")
    assert mine["ratio_6h"] < 0.8
    assert "stove" in mine["operator"]
