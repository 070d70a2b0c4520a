"""The plant bench on records made from the emulator itself: scores zero there, and refuses what it cannot score."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from benchmarks.plant import bench, speed
from benchmarks.plant.scores import Thermostat, thermostat_energy
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.embedded import EmbeddedPlant


@pytest.fixture
def own_weather(monkeypatch):
    monkeypatch.setattr(bench, "load_weather", lambda path: synthetic_weather())
    monkeypatch.setattr(bench, "scaling", lambda weather: [])  # how speed grows is tested by itself, below


def record(path, shift_K: float) -> None:
    plant = EmbeddedPlant(synthetic_weather())
    plant.reset(10 * DAY_S, 5 * DAY_S)
    rows = []
    for k in range(96):
        m = plant.advance(float(k % 8 < 4), 900)
        power = {"reaPHeaPum_y": m.power_W[0], "reaPFan_y": 0.0, "reaPPumEmi_y": 0.0}
        rows.append({"time": m.time_s, "reaTZon_y": m.T_zone_C[0] + shift_K, "oveHeaPumY_u": float(k % 8 < 4)} | power)
    pd.DataFrame(rows).to_csv(path, index=False)


@pytest.mark.slow
def test_its_own_record_scores_zero_and_a_shifted_one_fails(tmp_path, own_weather):
    (tmp_path / "w.mos").write_text("")
    record(tmp_path / "excite_same.csv.gz", 0.0)
    record(tmp_path / "excite_shifted.csv.gz", 0.5)
    result = bench.run_plant_bench(tmp_path, out=tmp_path / "plots")
    rmse = {row["what"]: row.get("T_rmse_K") for row in result["rows"]}
    assert rmse["excite_same"] == pytest.approx(0.0, abs=1e-9)
    assert rmse["excite_shifted"] == pytest.approx(0.5)
    holds = {target["name"]: target["holds"] for target in result["targets"]}
    assert holds["excite_same: T RMSE, K"] is True
    assert holds["excite_shifted: T RMSE, K"] is False
    assert (tmp_path / "plots" / "plant_replay.png").stat().st_size > 1000


def record_hourly_pair(path, shift_K: float) -> None:
    plant = EmbeddedPlant(synthetic_weather())
    plant.reset(10 * DAY_S, 5 * DAY_S)
    here = plant.snapshot()
    sides = {}
    for side, boost in (("A", 0.0), ("B", 1.0)):
        plant.restore(here)
        levels = [0.0, boost, 0.0, 0.0]
        sides[f"u{side}"] = levels
        sides[f"T{side}_end"] = [plant.advance(u, 3600).T_zone_C[0] for u in levels]
    table = pd.DataFrame({"pair": 0, "start_day": 10, "hour": range(4)} | sides)
    table["TB_end"] += shift_K
    table.to_csv(path, index=False)


@pytest.mark.slow
@pytest.mark.parametrize(("shift_K", "holds"), [(0.0, True), (0.2, False)])
def test_effects_of_hourly_pairs(tmp_path, own_weather, shift_K, holds):
    (tmp_path / "w.mos").write_text("")
    (tmp_path / "pairs").mkdir()
    record_hourly_pair(tmp_path / "pairs" / "pairs_1h.csv.gz", shift_K)
    result = bench.run_plant_bench(tmp_path)
    (effect,) = [target for target in result["targets"] if target["name"].startswith("hourly pairs")]
    assert effect["value"] == pytest.approx(shift_K, abs=1e-9)
    assert effect["holds"] is holds


def native_kpis(price: str) -> dict[str, float]:
    plant = EmbeddedPlant(synthetic_weather(), highly_dynamic=lambda time_s: 0.4 + 0 * time_s)
    plant.reset(16 * DAY_S, 7 * DAY_S, price)
    plant.advance(None, 14 * DAY_S)
    return plant.kpis()


@pytest.mark.slow
@pytest.mark.parametrize("real_prices", [True, False])
def test_native_windows_cost_what_the_folders_own_prices_say(tmp_path, own_weather, real_prices):
    (tmp_path / "w.mos").write_text("")
    rows = [{"price": price, "centre_day": 23} | native_kpis(price) for price in ("constant", "highly_dynamic")]
    rows[0]["ener_tot"] *= 1.05  # a window the emulator misses
    pd.DataFrame(rows).to_csv(tmp_path / "baseline_kpis.csv", index=False)
    if real_prices:
        prices = pd.DataFrame({"time": [0.0, 182 * DAY_S, 364 * DAY_S], "PriceElectricPowerHighlyDynamic": [0.4] * 3})
        prices.to_csv(tmp_path / "boundary_hourly.csv.gz", index=False)
    holds = {target["name"]: target["holds"] for target in bench.run_plant_bench(tmp_path)["targets"]}
    assert holds["native ener_tot: worst off by"] is False
    assert holds["native cost_tot constant: worst off by"] is True
    assert ("native cost_tot highly_dynamic: worst off by" in holds) is real_prices
    assert holds.get("native cost_tot highly_dynamic: worst off by", True) is True
    assert holds["native pele_tot: median off by"] is True


@pytest.mark.slow
def test_a_native_record_is_run_by_the_plants_own_control(tmp_path, own_weather):
    (tmp_path / "w.mos").write_text("")
    record(tmp_path / "native_not.csv.gz", 0.0)  # driven by a schedule, so native control must not reproduce it
    result = bench.run_plant_bench(tmp_path)
    assert result["rows"][0]["T_rmse_K"] > 0.1


def test_a_record_without_a_column_is_named(tmp_path, own_weather):
    (tmp_path / "w.mos").write_text("")
    pd.DataFrame({"time": [900.0], "reaTZon_y": [20.0]}).to_csv(tmp_path / "excite_bad.csv.gz", index=False)
    with pytest.raises(DataError, match=r"excite_bad\.csv\.gz: columns missing: oveHeaPumY_u"):
        bench.run_plant_bench(tmp_path)


@pytest.mark.slow
def test_a_hotter_thermostat_uses_more(own_weather):
    plant = EmbeddedPlant(synthetic_weather())
    low, high = (thermostat_energy(plant, Thermostat(16, centre, 1.0, 1.0)) for centre in (21.0, 22.0))
    assert 0 < low < high


def test_an_empty_folder_is_refused(tmp_path, own_weather):
    with pytest.raises(DataError, match=r"one \.mos file"):
        bench.run_plant_bench(tmp_path)
    (tmp_path / "w.mos").write_text("")
    with pytest.raises(DataError, match="nothing to score"):
        bench.run_plant_bench(tmp_path)


@pytest.mark.slow
def test_processes_leave_no_trace_in_the_results():
    """Of three runs in two processes, as the bench starts them, one follows another in its process."""
    weather, levels = synthetic_weather(), (0.3, 0.9, 0.6)
    with speed.plant_processes(weather, 2) as executor:
        there = list(executor.map(speed.hourly_run, levels, [2] * len(levels)))
    plant = EmbeddedPlant(weather)
    for level, run in zip(levels, there, strict=True):
        start = plant.reset(0.0, 0.0).T_zone_C[0]
        here = np.array([start, *(plant.advance(level, 3600.0).T_zone_C[0] for _ in range(48))])
        assert here.tobytes() == run.tobytes()


def test_how_speed_grows_is_measured_for_threads_and_processes():
    def rate_of(weather, n):
        return speed.Rate(2.0 * n, 1.0, 0.5)

    rows = speed.scaling(synthetic_weather(), days=1, together=(1, 3), processes=(2,), best_of=1, rate_of=rate_of)
    assert [row["plants"] for row in rows] == [1, 3, 2]
    assert rows[0]["growth"] == 1.0
    assert rows[2]["growth"] == pytest.approx(4.0 / rows[0]["days_per_second"])
    assert (rows[2]["cores_used"], rows[2]["days_per_cpu_second"]) == (0.5, 8.0)
    assert all(row["days_per_second"] > 0 for row in rows)
