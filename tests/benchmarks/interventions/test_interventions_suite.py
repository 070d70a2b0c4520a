"""The suite on the real engine, as small as it can be: data on disk, the command, its files, the numbers twice."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from click.testing import CliRunner
from here import Here

from benchmarks.interventions import bench as interventions
from benchmarks.interventions.dataset import load_or_simulate
from benchmarks.interventions.protocol import QUICK
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.plants.energyplus.engine import is_available

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not is_available(), reason="EnergyPlus (extra [energyplus]) is not installed"),
]


TINY = replace(QUICK, probe_days=(1,), validation_days=1, test_days=1, climates=("heating_chicago",))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("pairs")


@pytest.fixture(scope="module")
def simulated(folder):
    lines = []
    with LocalEngine(2) as engine:
        return load_or_simulate(TINY, folder, engine, say=lines.append), lines


@pytest.mark.slow
def test_pairs_share_everything_but_their_window(simulated):
    data, lines = simulated
    assert lines[0] == "EnergyPlus: 10 simulations"
    windows = data.climates["heating_chicago"].windows
    assert len(windows) == 6
    for w in windows:
        assert w.factual.T_zone_C[0, 0] == w.perturbed.T_zone_C[0, 0] == w.history.T_zone_C[0, -1]
        assert w.factual.T_out_C.tobytes() == w.perturbed.T_out_C.tobytes()
        assert w.factual.n_steps == 24
        assert w.history.n_steps >= 21 * 96
        # Full shifts are not always reached (a house cannot be cooled by a heater), but they never go the other way.
        effect = w.perturbed.T_zone_C[0, 12] - w.factual.T_zone_C[0, 12]
        assert effect * np.sign(w.shift_K) > 0.05
        assert abs(effect) < abs(w.shift_K) + 0.5


def test_what_was_simulated_is_read_back_and_damage_is_noticed(simulated, folder):
    data, _ = simulated
    lines = []
    again = load_or_simulate(TINY, folder, say=lines.append)
    assert not lines, "nothing was simulated a second time"
    for a, b in zip(data.climates["heating_chicago"].windows, again.climates["heating_chicago"].windows, strict=True):
        assert a.perturbed.T_zone_C.tobytes() == b.perturbed.T_zone_C.tobytes()
    (file,) = folder.glob("*.npz")
    kept = file.read_bytes()
    with np.load(file) as stored:
        arrays = dict(stored)
    arrays["heating_chicago/probe/1/probed/u"] = arrays["heating_chicago/probe/1/probed/u"] + 1e-12
    np.savez_compressed(file, **arrays)
    try:
        with pytest.raises(DataError, match=r"do not match the hash .* simulate again"):
            load_or_simulate(TINY, folder)
    finally:
        file.write_bytes(kept)


def test_the_manifest_names_engine_weather_model_and_outputs_by_their_hash(simulated):
    manifest = simulated[0].manifest
    climate = manifest["climates"]["heating_chicago"]
    hashes = [manifest["engine_sha256"], manifest["arrays_sha256"], climate["weather_sha256"], climate["model_sha256"]]
    assert all(len(one) == 64 for one in hashes)
    assert len(set(hashes)) == 4
    assert manifest["engine"].startswith("25.2")


@pytest.mark.slow
def test_the_command_writes_table_figures_and_page(simulated, folder, tmp_path, monkeypatch, computed_here):
    monkeypatch.setattr(interventions, "QUICK", TINY)
    out = tmp_path / "out"
    command = ["bench", "interventions", "--quick", "--data", str(folder), "--out", str(out), "--workers", "1"]
    done = CliRunner().invoke(cli, [*command, "--method", "tsfm", "--method", "thermoforce_two_state"])
    assert done.exit_code == 0, done.output
    assert {"scatter.png", "scatter.svg", "fan.png", "fan.svg", "index.html"} <= {f.name for f in out.iterdir()}
    rows = json.loads((out / "interventions.json").read_text())["rows"]
    table = {row["method"]: row for row in rows if "paper_effect_K" in row}
    raw, ours = table["TSFM raw"], table["ThermoForce (two-state)"]
    assert raw["sign"] == 0.0
    assert ours["effect_K"] < 0.4 * raw["effect_K"]
    assert ours["violations"] == 0
    # On its way it says of each method what the table will say.
    assert all(f"{label}: effect RMSE {row['effect_K']:.3f} K" in done.output for label, row in table.items())
    page = (out / "index.html").read_text()
    assert "<svg" in page
    assert "ThermoForce (two-state)" in page


def test_days_that_cannot_be_probed_are_refused(tmp_path):
    done = CliRunner().invoke(cli, ["bench", "interventions", "--days", "31", "--data", str(tmp_path)])
    assert done.exit_code == 2
    assert "31" in done.output


def test_studies_have_their_own_methods_and_names(tmp_path):
    command = ["bench", "interventions", "--data", str(tmp_path), "--study"]
    done = CliRunner().invoke(cli, [*command, "gamma", "--method", "tsfm"])
    assert done.exit_code == 2
    assert "the other studies have fixed methods" in done.output
    done = CliRunner().invoke(cli, [*command, "astrology"])
    assert done.exit_code == 2
    assert "ablation" in done.output


@pytest.mark.slow
def test_efficiency_compares_the_parts_with_the_paper(simulated, folder, tmp_path, monkeypatch):
    from benchmarks.interventions import studies

    monkeypatch.setattr(interventions, "QUICK", TINY)
    result = studies.run_study("efficiency", folder, out=tmp_path, engine=Here(), days=(1,), quick=True, repeats=1)
    rows = {row["component"]: row for row in result["rows"]}
    assert rows["trained parameters"]["here"] <= rows["trained parameters"]["paper"] == 195.0
    assert all(row["here"] > 0 for row in rows.values())
    solve, step = rows["solve (48 h at 15 min)"], rows["control step (estimate, forecast, solve)"]
    assert solve["here"] < step["here"]
    assert solve["paper"] is None
    assert {"efficiency.png", "efficiency.svg", "efficiency.html", "efficiency.json"} == {
        f.name for f in tmp_path.iterdir()
    }


@pytest.mark.slow
def test_baselines_are_scored_in_every_setting_and_seed(simulated, folder, tmp_path, monkeypatch):
    from benchmarks.interventions import studies
    from benchmarks.interventions.methods import surrogate

    monkeypatch.setattr(interventions, "QUICK", TINY)
    monkeypatch.setattr(studies, "TEACHER_SEEDS", 2)
    monkeypatch.setattr(surrogate, "surrogates", partial(surrogate.surrogates, epochs=2))
    rows = studies.run_study("baselines", folder, out=tmp_path, engine=LocalEngine(1), quick=True)["rows"]
    rc, network = ([row for row in rows if (row["teacher"] is None) == of_rc] for of_rc in (True, False))
    modes = len({row["mode"] for row in rows})
    assert len(rc) == 2 * 4 * 2 * modes, "plain operation with the days before and without, four orders, two errors"
    assert [(row["teacher"], row["seeds"]) for row in network] == [(w, 2) for w, _ in studies.TEACHERS] * 2 * modes
    assert all(row["worst_sign"] <= row["sign"] and row["worst_effect_K"] >= row["effect_K"] for row in rows)
    assert any(row["worst_effect_K"] > row["effect_K"] for row in network), "seeds differ"
    assert (tmp_path / "baselines.json").is_file()
