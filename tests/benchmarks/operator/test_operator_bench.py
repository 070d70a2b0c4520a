"""The operator bench on a reference folder that this test writes, and the refusals of its reader."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from houses import House, random_levels, record

from benchmarks.operator.bench import run_operator_bench
from benchmarks.operator.data import cut, read_hourly_pairs, read_run
from benchmarks.operator.score import score_pairs
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.parameters import linear_operator

pytestmark = pytest.mark.slow

HOUSE = House()


def _write_run(path, days: float) -> None:
    h = record(HOUSE, days, 900.0, seed=7)
    frame = pd.DataFrame(
        {
            "time": h.time_s,
            "reaTZon_y": h.T_zone_C[0],
            "weaSta_reaWeaTDryBul_y": h.T_out_C,
            "weaSta_reaWeaHGloHor_y": h.solar_W_m2,
            "oveHeaPumY_u": np.append(0.0, h.u[0]),
            "reaPHeaPum_y": np.append(0.0, h.power_W[0]),
            "reaPFan_y": 0.0,
            "reaPPumEmi_y": 0.0,
            "reaQHeaPumCon_y": np.append(0.0, h.heat_W[0]),
        }
    )
    frame.to_csv(path, index=False)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reference")
    (folder / "pairs").mkdir()
    _write_run(folder / "excite_a.csv.gz", 3.3)
    hours, rows, weather = 30, [], None
    for number, day in enumerate((20, 22, 24, 26)):
        base = record(HOUSE, 10.0, 3600.0, seed=1, u=np.zeros(240))
        weather = base
        first = (day - 20) * 24
        window = slice(first, first + hours)
        runs = {}
        for side, seed in (("A", number), ("B", 50 + number)):
            u = np.zeros(240)
            u[window] = random_levels(hours, seed, hold=4)
            u[first : first + 2] = 0.0
            runs[side] = record(HOUSE, 10.0, 3600.0, seed=1, u=u)
        for hour in range(hours):
            row = {"pair": number, "start_day": day, "kind": "random", "h0": 2, "hour": hour}
            for side, run in runs.items():
                k = first + hour
                start_C, end_C = run.T_zone_C[0, k : k + 2]
                row |= {f"u{side}": run.u[0, k], f"T{side}_start": start_C, f"T{side}_end": end_C}
                row |= {f"Q{side}_W": run.heat_W[0, k], f"P{side}_W": run.power_W[0, k]}
            rows.append(row)
    pd.DataFrame(rows).to_csv(folder / "pairs" / "pairs_1h.csv.gz", index=False)
    year = pd.DataFrame({"TDryBul": np.zeros(24 * 40), "HGloHor": np.zeros(24 * 40)})
    year.loc[20 * 24 : 20 * 24 + 240, "TDryBul"] = weather.T_out_C
    year.loc[20 * 24 : 20 * 24 + 240, "HGloHor"] = weather.solar_W_m2
    year.to_csv(folder / "boundary_hourly.csv.gz", index=False)
    return folder


def test_bench_tells_rows_and_targets(reference):
    result = run_operator_bench(reference, quick=True, epochs=3)
    json.dumps(result)
    assert result["bench"] == "operator"
    rows = {
        (r.get("input"), r.get("gain"), r.get("order")): r for r in result["rows"] if r["part"] == "trained on pairs"
    }
    third, first = rows["auto", "linear", 3], rows["auto", "linear", 1]
    # The house is of third order and its heat is measured exactly.
    assert third["rmse_K"] < 0.3 * first["rmse_K"]
    assert {r["part"] for r in result["rows"]} >= {"trained on pairs", "one run", "speed"}
    for target in result["targets"]:
        assert target["holds"] == (
            target["value"] <= target["goal"] if target["sense"] == "at most" else target["value"] >= target["goal"]
        )
    names = [target["name"] for target in result["targets"]]
    assert any("3 days of one run" in name for name in names)


def test_scores_of_nothing_are_the_effect_itself(reference):
    pairs = read_hourly_pairs(reference)
    nothing = linear_operator(np.array([0.9]), np.array([0.0]), step_s=3600.0)
    scores = score_pairs(nothing, pairs)
    assert scores.rmse_K == pytest.approx(scores.effect_K)
    assert scores.sign_accuracy == 0.0


def test_reader_refuses_what_is_not_there(tmp_path, reference):
    with pytest.raises(DataError, match="pairs_1h"):
        run_operator_bench(tmp_path)
    path = tmp_path / "excite_x.csv.gz"
    pd.DataFrame({"time": [0.0, 900.0]}).to_csv(path, index=False)
    with pytest.raises(DataError, match=r"excite_x.csv.gz: column 'reaTZon_y' is missing"):
        read_run(path)


def test_cut_keeps_boundaries_and_steps_together(reference):
    run = read_run(reference / "excite_a.csv.gz")
    part = cut(run, 1.0, 2.0)
    assert part.n_steps == 192
    assert part.time_s[0] == run.time_s[96]
    np.testing.assert_array_equal(part.u[0], run.u[0, 96:288])


def test_own_factors_are_what_a_gain_of_each_pair_could_still_explain(reference):
    pairs = read_hourly_pairs(reference)
    one = score_pairs(linear_operator(np.array([0.9]), np.array([1.0]), step_s=3600.0), pairs)
    # Four times the gain is four times the prediction: best with a quarter of the factor, and then the same.
    four = score_pairs(linear_operator(np.array([0.9]), np.array([4.0]), step_s=3600.0), pairs)
    assert four.rmse_K > 2 * one.rmse_K
    assert one.own_factor_rmse_K < one.rmse_K
    assert four.own_factor_rmse_K == pytest.approx(one.own_factor_rmse_K, rel=1e-6)
    assert four.own_factor_sd == pytest.approx(0.25 * one.own_factor_sd, rel=1e-6)
