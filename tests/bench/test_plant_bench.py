"""The plant bench on records made from the emulator itself: scores zero there, and refuses what it cannot score."""

from __future__ import annotations

import pandas as pd
import pytest

from thermoforce_mpc.bench import plant as bench
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.types import DAY_S
from thermoforce_mpc.weather import synthetic_weather


@pytest.fixture
def own_weather(monkeypatch):
    monkeypatch.setattr(bench, "load_weather", lambda path: synthetic_weather())


def record(path, shift_K: float) -> None:
    plant = EmbeddedPlant(synthetic_weather())
    plant.reset(10 * DAY_S, 5 * DAY_S)
    rows = []
    for k in range(96):
        m = plant.advance(float(k % 8 < 4), 900)
        power = {"reaPHeaPum_y": m.power_W, "reaPFan_y": 0.0, "reaPPumEmi_y": 0.0}
        rows.append({"time": m.time_s, "reaTZon_y": m.T_zone_C + shift_K, "oveHeaPumY_u": float(k % 8 < 4)} | power)
    pd.DataFrame(rows).to_csv(path, index=False)


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


def test_an_empty_folder_is_refused(tmp_path, own_weather):
    with pytest.raises(DataError, match=r"one \.mos file"):
        bench.run_plant_bench(tmp_path)
    (tmp_path / "w.mos").write_text("")
    with pytest.raises(DataError, match="nothing to score"):
        bench.run_plant_bench(tmp_path)
