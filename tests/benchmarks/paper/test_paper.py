"""`tf-mpc paper`: figures of benches beside the paper's, in its tables; what cannot run is said."""

import csv
import json

import pytest
from click.testing import CliRunner

from benchmarks.paper import closed_loop, tables
from benchmarks.paper.closed_loop import closed_loop_tests
from benchmarks.paper.parts import PARTS, Table
from benchmarks.paper.printed import BACKBONES, CLOSED_LOOP, COVARIATES
from benchmarks.paper.run import markdown
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.experiment.run import run_scenario


@pytest.mark.slow
def test_a_days_closed_loop_stands_beside_the_papers(tmp_path, monkeypatch):
    """One window is run; the others are asked for and shown with its figures."""
    asked = []

    def one_window(scenario, display, folder, words):
        asked.append((scenario.period, run_scenario(scenario, display, folder, words) if not asked else asked[0][1]))
        return asked[0][1]

    monkeypatch.setattr(closed_loop, "run_scenario", one_window)
    done = CliRunner().invoke(
        cli, ["paper", "--quick", "--seeds", "1", "--only", "closed-loop", "--out", str(tmp_path / "p")]
    )
    assert done.exit_code == 0, done.output
    assert [period for period, _ in asked] == list(closed_loop.WINDOWS.values())
    with (tmp_path / "p" / "tables.csv").open() as file:
        rows = list(csv.DictReader(file))
    native = next(r for r in rows if r["row"] == "peak A: native" and r["quantity"] == "energy, kWh/m²")
    assert float(native["paper"]) == 3.478
    kpis = json.loads((tmp_path / "p" / "closed-loop" / "peak-A" / "kpis.json").read_text())
    assert float(native["here"]) == pytest.approx(kpis["baselines"]["native"]["ener_tot"])
    ours = {r["row"] for r in rows if not r["row"].startswith("Wilcoxon")}
    beside = {f"{window}: rc_mpc" for window, _ in CLOSED_LOOP}
    assert ours == {f"{window}: {name}" for window, name in CLOSED_LOOP} | beside
    text = (tmp_path / "p" / "tables.md").read_text()
    assert f"{float(native['here']):.3g} (3.48)" in text
    assert (tmp_path / "p" / "closed-loop" / "pareto.png").stat().st_size > 10_000


def test_seeds_are_shown_each_with_their_mean_and_its_interval():
    """Student's t over seeds; RC-MPC with the paper's operator and today's stand in rows of their own."""
    names = {"native": [8.0], "rc_mpc_paper": [6.0, 7.0, 8.0], "thermoforce_paper": [1.0, 2.0, 3.0], "rc_mpc": [0.5]}
    rows = [
        {
            "window": window,
            "seed": seed,
            "controller": name,
            "energy_kWh_m2": 3.0,
            "discomfort_Kh": K_h,
            "cost_EUR_m2": 1,
        }
        for window in ("peak A", "peak B", "typical")
        for name, each in names.items()
        for seed, K_h in enumerate(each, start=1)
    ]
    found = tables.closed_loop({"rows": [*rows, *closed_loop_tests(rows)]})
    assert found["peak A: thermoforce_paper"]["discomfort, K·h"] == (1.726, 2.0, (1.0, 2.0, 3.0))
    assert found["peak A: rc_mpc"]["discomfort, K·h"] == (None, 0.5), "one run, and no figure of the paper"
    assert found["peak A: rc_mpc_paper"]["discomfort against native, %"][2] == (-25.0, -12.5, 0.0)
    test = found["Wilcoxon: discomfort of thermoforce_paper below rc_mpc_paper, windows and seeds"]
    assert (test["lower in"][1], test["of"][1]) == (9, 9)
    assert test["p"][1] < 0.01
    assert found["Wilcoxon: energy of thermoforce_paper below native, windows and seeds"]["p"][1] == 1.0
    table = Table("tab:closedloop", "Closed loop", lambda result: found)
    text = markdown("closed-loop", table, found, {"minutes": 1.0, "differs": "ours", "missing": ""})
    assert "2 [-0.484, 4.48] (1.73): 1 2 3 |" in text, "mean ± 4.303 · 1 / √3"


def test_what_cannot_be_measured_is_said_in_its_tables(tmp_path):
    done = CliRunner().invoke(cli, ["paper", "--only", "homes", "--out", str(tmp_path)])
    assert done.exit_code == 1
    text = (tmp_path / "tables.md").read_text()
    for label in ("tab:refit", "tab:cov", "tab:backbone"):
        section = text.split(f"## {label}", 1)[1].split("\n## ", 1)[0]
        assert "**Not reproduced here:** --records: no folder of measured homes" in section
    assert "tab:positioning" in text
    assert json.loads((tmp_path / "tables.json").read_text())["rows"] == []


def test_an_unknown_part_is_refused_with_the_nearest():
    done = CliRunner().invoke(cli, ["paper", "--only", "closed_loop"])
    assert isinstance(done.exception, InputError)
    assert "did you mean 'closed-loop'" in str(done.exception)


def test_every_printed_figure_of_homes_finds_its_row():
    rows = [{"method": name, "rmse_6h_K": 0.5, "rmse_24h_K": 1.0} for name in (*COVARIATES, "another")]
    rows += [
        {"backbone": name, "parameters": 1e6, "raw_K": 1.0, "thermoforce_K": 0.5, "change_percent": -50.0}
        for name in ("shipped", "shipped_small", "shipped_tiny")
    ]
    found = tables.covariates({"rows": rows})
    assert found["TSFM + covariates + AR"] == {"RMSE 6 h, K": (0.642, 0.5), "RMSE 24 h, K": (0.959, 1.0)}
    assert tables.factual({"rows": rows})["another"]["RMSE 6 h, K"] == (None, 0.5)
    scales = tables.backbones({"rows": rows})
    assert len(scales) == len(BACKBONES)
    assert scales["chronos-bolt-tiny; here shipped_tiny"]["change, %"] == (pytest.approx(-24.95, abs=0.05), -50.0)


def test_gains_are_means_of_the_climates():
    cell = {"days": 3, "paper_DR_down_K": 0.39, "paper_DR_up_K": 0.51}
    rows = [
        {"mode": mode, "gain": gain, "DR_down_K": down, "DR_up_K": 0.2, **cell}
        for mode, down in (("heating", 0.1), ("cooling", 0.3))
        for gain in ("linear", "neural")
    ]
    assert tables.ablation({"rows": rows})["3 probe days"]["linear, DR-down, K"] == (0.39, pytest.approx(0.2))


def test_every_table_of_the_paper_is_there():
    labels = {table.label for part in PARTS.values() for table in part.tables}
    assert {
        "tab:interv",
        "tab:refit",
        "tab:cov",
        "tab:closedloop",
        "tab:ablation",
        "tab:backbone",
        "tab:efficiency",
    } < labels
