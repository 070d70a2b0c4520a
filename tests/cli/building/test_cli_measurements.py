"""From files to a plan on the command line: check, starting map, identify, probing by hand, plan."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner

from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.building.data import show_findings
from thermoforce_mpc.cli.building.plan import drawn_plan, plan_table
from thermoforce_mpc.data import DAY_S, Boundary, Layout, Names, Plan, PlannedSaving, PlanStatus, Record
from thermoforce_mpc.errors import ConfigError, DataError, ThermoForceError
from thermoforce_mpc.identification.probing import operation
from thermoforce_mpc.identification.probing.operation import OperationFinding
from thermoforce_mpc.identification.validation import competence
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.measurements.load import read_measurements
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.report.display import RunDisplay

pytestmark = pytest.mark.usefixtures("identified_once")

MAP = """\
time: {zone: Europe/Brussels}
outdoor: out_F
sun: sun
zones:
  living: {temperature: {column: room_K, unit: K}, lower: 21, upper: 24}
actuators:
  heat_pump: {level: {column: percent, unit: '%'}}
machines:
  meter: {power: {column: kWh, unit: kWh per step}, price: 0.3}
""".replace("out_F", "{column: out_F, unit: '°F'}")
LINEAR = ("--set", "identification.options.modulation=linear")


def tabled(r: Record, path: Path, begin: str = "2025-01-21") -> None:
    """Write a record with the units and names of someone who never heard of ours."""
    at = pd.date_range(begin, periods=r.n_steps + 1, freq="15min", name="when")
    columns = {"room_K": r.T_zone_C[0] + 273.15, "out_F": r.T_out_C * 1.8 + 32, "sun": r.solar_W_m2}
    acting = {"percent": [*(100 * r.u[0]), np.nan], "kWh": [*(r.power_W[0] / 4000), np.nan]}
    pd.DataFrame(columns | acting, index=at).round(4).to_csv(path)


def test_bounds_that_leave_no_band_are_refused_with_the_map(tmp_path):
    (tmp_path / "map.yaml").write_text(MAP.replace("lower: 21, upper: 24", "lower: 24, upper: 21"), encoding="utf-8")
    done = CliRunner().invoke(cli, ["data", "check", "house.csv", "--map", str(tmp_path / "map.yaml")])
    assert isinstance(done.exception, ConfigError)
    assert "zones.living: the lower bound, 24 °C, is not below the upper one, 21 °C" in str(done.exception)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A probed house, two days of its own control, the map, and a forecast."""
    path = tmp_path_factory.mktemp("house")
    plant = EmbeddedPlant(synthetic_weather())
    tabled(probe(plant, 20 * DAY_S, 3.0, seed=1), path / "probed.csv")
    b = plant.forecast(1.5 * DAY_S, 3600.0)
    at = pd.date_range("2025-01-24", periods=b.n_steps + 1, freq="1h", name="when")
    pd.DataFrame({"out_F": b.T_out_C * 1.8 + 32, "sun": b.solar_W_m2}, index=at).to_csv(path / "ahead.csv")
    record = Record.beginning(plant.reset(21 * DAY_S, 5 * DAY_S))
    for _ in range(2 * 96):
        record = record.extended(plant.advance(None, 900.0))
    tabled(record, path / "operated.csv", "2025-01-22")
    (path / "map.yaml").write_text(MAP, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def model(folder) -> Path:
    words = ["--data", str(folder / "probed.csv"), "--map", str(folder / "map.yaml"), "--out", str(folder / "good")]
    done = CliRunner().invoke(cli, ["identify", *words, *LINEAR])
    assert done.exit_code == 0, done.output
    assert "Competence: COMPETENT" in done.output
    return folder / "good"


def tf_mpc(folder: Path, *words: str):
    """Run a command; names of files in `folder` become their paths."""
    named = [str(folder / word) if word.endswith((".csv", ".yaml", ".png", ".json")) else word for word in words]
    return CliRunner().invoke(cli, named)


@pytest.mark.slow
def test_check_prints_and_draws_what_it_understood(folder):
    words = ("data", "check", "probed.csv", "--map", "map.yaml", "--plot", "check.png", "--json", "check.json")
    done = tf_mpc(folder, *words)
    assert done.exit_code == 0, done.output
    assert "2025-01-21 00:00:00+01:00 to 2025-01-24 00:00:00+01:00 (3.0 days, Europe/Brussels)" in done.output
    assert "heat_pump: competent" in done.output
    assert "first mend" not in done.output
    assert "days of probing" not in done.output, "three days are enough"
    assert "probe-plan" not in done.output
    assert (folder / "check.png").stat().st_size > 10_000
    found = json.loads((folder / "check.json").read_text())
    assert found["understood"]["rows"] == 289
    assert found["tells"]["found"][0]["competent"] is True


def test_a_model_of_readings_that_do_not_count_says_which_they_are(folder):
    stuck = pd.read_csv(folder / "probed.csv", index_col=0).assign(room_K=294.15)
    stuck.to_csv(folder / "stuck.csv")
    done = tf_mpc(folder, "identify", "--data", "stuck.csv", "--map", "map.yaml", "--out", str(folder / "stuck"))
    assert "flagged in zones.living.temperature: 289 by rule 'frozen', first 21 °C" in done.output
    assert "no zone temperature is known; check its column" in str(done.exception)


@pytest.mark.slow
def test_what_is_doubtful_comes_before_a_model_of_it(folder):
    (folder / "celsius.yaml").write_text(MAP.replace("{column: out_F, unit: '°F'}", "out_F"), encoding="utf-8")
    done = tf_mpc(folder, "data", "check", "probed.csv", "--map", "celsius.yaml", "--plot", "celsius.png")
    assert "°F is likelier" in done.output
    assert "heat_pump: competent" in done.output
    assert "first mend what is doubtful above" in done.output


@pytest.mark.slow
def test_what_a_record_of_operation_cannot_tell_is_said_and_a_probing_is_proposed(folder, monkeypatch):
    monkeypatch.setattr(competence, "MOST_RELATIVE_SD", 0.05)
    done = tf_mpc(folder, "data", "check", "operated.csv", "--map", "map.yaml", "--plot", "operated.png")
    assert done.exit_code == 0, done.output
    assert "not competent" in done.output
    assert "data probe-plan" in done.output
    done = tf_mpc(folder, "data", "probe-plan", "operated.csv", "--map", "map.yaml", "--out", "probe.csv")
    assert done.exit_code == 0, done.output
    assert "K·h outside 21.0 to 24.0 °C" in done.output
    schedule = pd.read_csv(folder / "probe.csv", index_col=0, parse_dates=True)
    assert str(schedule.index[0]) == "2025-01-24 07:00:00+01:00"
    assert schedule.columns.tolist() == ["heat_pump"]
    assert set(schedule["heat_pump"].dropna()) == {0.0, 1.0}
    assert np.isnan(schedule["heat_pump"].iloc[-1]), "the last line gives control back"


def test_what_is_told_of_many_actuators_alike_is_said_once(monkeypatch, capsys):
    """Of twelve rooms the same advice stood there twelve times."""
    rooms, at = ["bath", "hall", "loft"], pd.date_range("2025-02-01", periods=25, freq="1h", name="when")
    told = [
        OperationFinding("bath", False, "not known", ("hold full level", "probe 6 hours more")),
        OperationFinding("hall", True, "competent"),
        OperationFinding("loft", False, "not known", ("hold full level", "probe 9 hours more")),
    ]
    monkeypatch.setattr(operation, "findings", lambda record, layout: told)
    rules = {
        "outdoor": "out",
        "zones": {name: {"temperature": f"T_{name}"} for name in rooms},
        "actuators": {name: {"level": f"u_{name}", "zone": name} for name in rooms},
    }
    columns = {f"T_{name}": 20.0 for name in rooms} | {f"u_{name}": 0.5 for name in rooms}
    measured = read_measurements(pd.DataFrame({"out": 0.0, **columns}, index=at).reset_index(), rules)
    show_findings(measured, RunDisplay(), [])
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert lines[lines.index("bath, loft: not known") + 1] == "hall: competent"
    assert [line for line in lines if line.startswith("advice")] == [
        "advice for bath, loft: hold full level",
        "advice for bath: probe 6 hours more",
        "advice for loft: probe 9 hours more",
    ]


def test_probing_by_hand_keeps_the_hours_of_summer_time(folder, tmp_path):
    at = pd.date_range("2025-07-01", periods=5 * 24 + 1, freq="1h", name="when")
    hour = np.arange(at.size)
    df = pd.DataFrame({"room_K": 297.0 + hour % 24 / 10, "out_F": 70.0 + hour % 24, "sun": 9.0 * (hour % 24)}, index=at)
    df.assign(percent=30.0, kWh=0.3).to_csv(tmp_path / "summer.csv")
    (tmp_path / "cooled.yaml").write_text(MAP.replace("{level", "{mode: cooling, level"), encoding="utf-8")
    words = ("summer.csv", "--map", "cooled.yaml", "--no-fit", "--start", "2025-08-01", "--out", "probe.csv")
    done = tf_mpc(tmp_path, "data", "probe-plan", *words)
    assert done.exit_code == 0, done.output
    assert "15 h by hand at heat_pump" in done.output
    times = pd.read_csv(tmp_path / "probe.csv")["time"].tolist()
    assert times[0] == "2025-08-01 07:00:00+02:00"
    assert {time[11:] for time in times if time[11:13] > "21"} == {"22:00:00+02:00"}


def test_a_starting_map_is_printed(folder):
    done = tf_mpc(folder, "data", "map", "probed.csv")
    assert done.exit_code == 0, done.output
    rules = yaml.safe_load(done.stdout)
    assert rules["zones"]["room_k"]["temperature"] == {"column": "room_K", "unit": "K"}
    assert rules["outdoor"]["column"] == "out_F"


@pytest.mark.slow
def test_a_record_that_tells_needs_no_probing(folder):
    done = tf_mpc(folder, "data", "probe-plan", "probed.csv", "--map", "map.yaml", "--out", "none.csv")
    assert done.exit_code == 0, done.output
    assert "Nothing needs to be probed" in done.output
    assert not (folder / "none.csv").exists()


@pytest.mark.slow
def test_identify_exits_with_4_where_the_model_is_not_competent_and_says_what_to_do(folder, monkeypatch):
    monkeypatch.setattr(competence, "MOST_RELATIVE_SD", 0.05)
    words = ("--data", "operated.csv", "--map", "map.yaml", "--out", str(folder / "weak"), *LINEAR)
    done = tf_mpc(folder, "identify", *words)
    assert done.exit_code == 4, done.output
    assert "tf-mpc data probe-plan" in done.output
    words = ("--model", str(folder / "weak"), "--data", "operated.csv", "--map", "map.yaml", "--forecast", "ahead.csv")
    done = tf_mpc(folder, "plan", *words, "--out", "weak.csv")
    assert done.exit_code == 4, done.output
    assert re.search(r"^Plan from \S+ \S+ for \d+ h: gate: This model may not act, .* Next: ", done.output, flags=re.M)
    assert "leave the building to its own control" in done.output
    assert not (folder / "weak.csv").exists()


@pytest.mark.slow
def test_a_plan_is_a_table_a_file_and_a_picture(folder, model):
    words = ("plan", "--model", str(model), "--data", "probed.csv", "--map", "map.yaml", "--forecast", "ahead.csv")
    done = tf_mpc(folder, *words, "--out", "plan.csv", "--plot", "plan.png")
    assert done.exit_code == 0, done.output
    assert "Fri 24 Jan 00:00" in done.output
    table = pd.read_csv(folder / "plan.csv", index_col=0, parse_dates=True)
    assert len(table) == 36
    assert str(table.index[0]) == "2025-01-24 00:00:00+01:00"
    assert table["u"].between(0, 1).all()
    np.testing.assert_allclose(table["cost"], table["power_W"] / 1000 * 0.3, atol=1e-3)
    assert (table["T_zone_C"] + table["slack_K"] > 20.9).all()
    assert (folder / "plan.png").stat().st_size > 10_000
    done = tf_mpc(folder, *words, "--hours", "6", "--step", "30min", "--out", "plan.json")
    assert done.exit_code == 0, done.output
    found = json.loads((folder / "plan.json").read_text())
    assert [found["rows"][k]["time"] for k in (0, -1)] == ["2025-01-24T00:00:00+01:00", "2025-01-24T05:30:00+01:00"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("data", "check", "none.csv", "--map", "map.yaml"), "none.csv: no such file"),
        (("data", "check", "probed.csv", "--map", "other.yaml"), "no such file; `tf-mpc data map FILE` writes one"),
        (("data", "probe-plan", "probed.csv", "--map", "map.yaml", "--levels", "1,0"), "start with 0"),
        (("data", "probe-plan", "probed.csv", "--map", "map.yaml", "--start", "2024-01-01"), "before the end of"),
        (
            ("data", "probe-plan", "probed.csv", "--map", "map.yaml", "--start", "NaT"),
            "--start 'NaT' is not a time stamp",
        ),
        (("identify", "--data", "probed.csv"), "--data and --map belong together"),
        (("identify", "--data", "probed.csv", "--map", "map.yaml", "--data-days", "nan"), "nan is no number"),
        (("identify", "--data", "probed.csv", "--map", "map.yaml", "--testcase", "x"), "--testcase is for probing"),
        (("identify", "--data", "probed.csv", "--map", "map.yaml", "--set", "seed=1"), "identification.options"),
        (("identify", "--data-days", "7"), "--data-days belongs to --data"),
        (("identify", "--data", "probed.csv", "--map", "map.yaml", "--out", "map.yaml/m"), "map.yaml is a file"),
        (
            ("plan", "--model", "m", "--data", "x", "--map", "y", "--forecast", "z", "--out", "map.yaml/p.csv"),
            "is a file",
        ),
    ],
)
def test_bad_input_is_told_and_nothing_is_written(folder, words, message, monkeypatch):
    monkeypatch.chdir(folder)
    before = sorted(path.name for path in folder.iterdir())
    done = tf_mpc(folder, *words)
    assert done.exit_code != 0
    said = str(done.exception) if isinstance(done.exception, ThermoForceError) else done.output
    assert message in said
    assert sorted(path.name for path in folder.iterdir()) == before


def test_a_plan_of_several_zones_has_a_column_for_each(tmp_path):
    names = Names(("bath", "hall"), ("towel", "floor"), ("grid",))
    n, two = 4, np.ones((2, 4))
    at = pd.Timestamp("2025-01-01", tz="UTC")
    time_s = np.arange(n) * 3600.0
    plan = Plan(
        (), PlanStatus.SOLVED, "", 0.5 * two, np.array([20.0, 21.0]), 20 * two, two, 19 * two, 22 * two, 0 * two,
        np.full((1, n), 500.0), time_s, at, names=names,
    )  # fmt: skip
    edges, bound = np.arange(n + 1) * 3600.0, np.full((2, n + 1), 20.0)
    price = np.linspace(0.1, 0.5, n + 1)[None]
    ahead = Boundary(
        edges, edges, edges, 0 * bound, bound, bound + np.array([[3.0], [4.0]]), price, 0 * price, names=names
    )
    table = plan_table(plan, ahead)
    assert table["upper_C[hall]"].tolist() == [24.0] * n
    np.testing.assert_allclose(table["cost"], 0.5 * price[0, :-1])
    row = {"actuator": "floor", "from": at.isoformat(), "until": (at + pd.Timedelta("1h")).isoformat()}
    left = row | {"from": row["until"], "until": (at + pd.Timedelta("3h")).isoformat(), "value": None, "unit": "°C"}
    drawn = drawn_plan(plan, table, ahead, [row | {"value": 21.5, "unit": "°C"}, left])
    assert [len(axes.get_legend_handles_labels()[1]) for axes in drawn.axes[:3]] == [2, 1, 2]
    (steps,) = drawn.axes[1].lines
    np.testing.assert_array_equal(np.asarray(steps.get_ydata()), [21.5, np.nan, np.nan])
    assert drawn.axes[1].get_ylabel() == "set, °C"
    assert drawn.axes[0].lines[1].get_drawstyle() == "steps-post", "bounds hold until they change"


def test_what_may_not_act_has_no_level_and_its_room_no_temperature():
    names, n = Names(("bath", "hall"), ("towel", "floor"), ("grid",)), 4
    two, time_s = np.ones((2, n)), np.arange(n) * 3600.0
    plan = Plan(
        (), PlanStatus.GATE, "", two, np.array([20.0, 21.0]), 20 * two, two, 19 * two, 22 * two, 0 * two,
        np.full((1, n), 500.0), time_s, pd.Timestamp("2025-01-01", tz="UTC"), names=names,
        acting=(PlanStatus.SOLVED, PlanStatus.GATE),
    )  # fmt: skip
    edges = np.arange(n + 1) * 3600.0
    rows, price = np.full((2, n + 1), 20.0), np.full((1, n + 1), 0.3)
    ahead = Boundary(edges, edges, edges, 0 * rows, rows, rows + 3.0, price, 0 * price, names=names)
    layout = Layout(names, (1, 1), (0, 1), (0, 0), (0.0, 0.0), (0.5, 0.5), (20.0, 20.0))
    table = plan_table(plan, ahead, layout)
    assert (table["u[towel]"] == 1.0).all()
    assert table[["u[floor]", "T_zone_C[hall]", "slack_K[hall]", "power_W", "cost"]].isna().all().all()
    assert (table["T_zone_C[bath]"] == 21.0).all()
    assert plan.to_dataframe()["u[floor]"].isna().all()
    assert len(drawn_plan(plan, table, ahead).axes[1].patches) == 1


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ("30", "--step 30: has no unit; write one from 5min to 1h"),
        ("1h30min", "--step 1h30min: is no step of a plan"),
        ("soon", "--step soon: is no duration"),
        ("NaT", "--step NaT: is no step of a plan"),
        ("7min", "--step 7min: a plan of on/off blocks has 10min to 1h"),
    ],
)
def test_a_step_of_a_plan_is_refused_by_its_name(folder, model, step, message):
    words = ("--model", str(model), "--data", "probed.csv", "--map", "map.yaml", "--forecast", "ahead.csv")
    done = tf_mpc(folder, "plan", *words, "--step", step)
    assert isinstance(done.exception, ConfigError)
    assert message in str(done.exception)


def test_what_a_plan_rests_on_stands_in_whole_sentences(folder, model, monkeypatch):
    why = "levels of a rule act (5.93 over the horizon (24 h); comfort +1.20); the least total (heat 0.30 more; peak)"
    planned = ThermoForceMPC.plan
    monkeypatch.setattr(ThermoForceMPC, "plan", lambda self, seen, state=None: replace(planned(self, seen), why=why))
    words = ("--model", str(model), "--data", "probed.csv", "--map", "map.yaml", "--forecast", "ahead.csv")
    lines = [line.strip() for line in tf_mpc(folder, "plan", *words, "--hours", "6").output.splitlines()]
    assert "levels of a rule act (5.93 over the horizon (24 h); comfort +1.20)" in lines
    assert "the least total (heat 0.30 more; peak)" in lines
    monkeypatch.setattr(ThermalModel, "claims", property(lambda self: ("another load",)))
    assert "Found: another load" in tf_mpc(folder, "plan", *words, "--hours", "6").output.splitlines()


SIX_HOURS = ("--data", "probed.csv", "--map", "map.yaml", "--forecast", "ahead.csv", "--hours", "6")


def test_why_a_plan_in_levels_has_no_saving_is_said(folder, model):
    words = ("--model", str(model), *SIX_HOURS)
    said = " ".join(tf_mpc(folder, "plan", *words, "--out", "levels.json").output.split())
    assert "What the plan saves is not told: the record has 3 whole days, and 7 tell how it is left alone" in said
    assert "Saves" not in said
    found = json.loads((folder / "levels.json").read_text())
    assert found["saving"] is None
    assert found["no_saving"].startswith("What the plan saves is not told")
    peaks = ("--set", "objective.peak_price_per_kW=1")
    assert "at the meter, as a peak, is not counted" in " ".join(tf_mpc(folder, "plan", *words, *peaks).output.split())


def test_a_saving_of_levels_is_said_with_what_it_is_compared_with(folder, model, monkeypatch):
    found = PlannedSaving(0.5, 0.2, 0.8, 3.0, 3.5, 10.0, 11.0, 0.0, 0.4, 0.5)
    monkeypatch.setattr("thermoforce_mpc.experiment.left_alone.saving_of_levels", lambda *_: found)
    words = ("--model", str(model), *SIX_HOURS, "--out", "levels.json")
    said = " ".join(tf_mpc(folder, "plan", *words).output.split())
    beside = r"Energy [\d.]+ kWh, cost [\d.]+, expected outside the bounds [\d.]+ K·h, if the model were exact\. "
    saves = r"Saves 0\.50 against leaving it alone \(90 % band 0\.20 to 0\.80\): cost 3\.00 instead of 3\.50"
    assert re.search(rf"{beside}On average over what it may err: {saves}", said)
    assert "By the same model with rooms kept as warm as they were at these hours" in said
    saving = json.loads((folder / "levels.json").read_text())["saving"]
    assert (saving["low"], saving["stored"], saving["currency"]) == (0.2, 0.0, "")
    # In the currency of the map, or of the bill that takes the place of its prices.
    (folder / "in_sek.yaml").write_text((folder / "map.yaml").read_text() + "\ncurrency: SEK\n")
    (folder / "bill.yaml").write_text("{source: a contract, currency: NOK, energy: 0.9}\n")
    for more, currency in ((), "SEK"), (("--prices", "bill.yaml"), "NOK"):
        asked = [one.replace("map.yaml", "in_sek.yaml") for one in words]
        said = " ".join(tf_mpc(folder, "plan", *asked, *more).output.split())
        assert f"Saves 0.50 {currency} against leaving it alone" in said
        assert json.loads((folder / "levels.json").read_text())["saving"]["currency"] == currency
    (folder / "in_euro.yaml").write_text((folder / "map.yaml").read_text() + "\ncurrency: euro\n")
    refused = tf_mpc(folder, "plan", *[one.replace("map.yaml", "in_euro.yaml") for one in words])
    assert isinstance(refused.exception, ConfigError)
    assert "currency: expected a code of three capitals, such as EUR (got 'euro')" in str(refused.exception)


@pytest.mark.parametrize("mode", ["duty", "modulating"])
def test_minimum_times_that_a_plan_does_not_keep_are_said(folder, model, mode):
    words = ("--model", str(model), *SIX_HOURS)
    limits = {"mode": mode, "lowest_level": 0, "min_on_s": 7200}
    options = [word for key, value in limits.items() for word in ("--set", f"actuation.{key}={value}")]
    done = tf_mpc(folder, "plan", *words, *options)
    said = (
        "heat_pump: minimum on and off times and starts an hour are kept by the machine's own control, and not planned"
    )
    assert (said in " ".join(done.output.split())) == (mode == "modulating"), done.output


def test_a_plan_refuses_what_does_not_belong_together(folder, model):
    words = ("plan", "--model", str(model), "--data", "probed.csv", "--map", "map.yaml", "--forecast")
    for more, error, message in (
        (("ahead.csv", "--hours", "40"), DataError, "covers 36 h"),
        (("probed.csv",), DataError, "the measurements end at 2025-01-24"),
        (("ahead.csv", "--set", "horizn_h=3"), ConfigError, "did you mean 'horizon_h'"),
    ):
        done = tf_mpc(folder, *words, *more, "--out", "refused.csv")
        assert isinstance(done.exception, error)
        assert message in str(done.exception)
    (folder / "bath.yaml").write_text(MAP.replace("living", "bath"), encoding="utf-8")
    other = [word.replace("map.yaml", "bath.yaml") for word in words]
    said = str(tf_mpc(folder, *other, "ahead.csv").exception)
    assert re.search(r": is of zones living, \S+ of zones bath: another building\?", said)
    assert not (folder / "refused.csv").exists()


@pytest.mark.slow
def test_a_band_that_held_nothing_is_a_warning(folder, model, tmp_path):
    """A room that is 5 K warmer than it was from an hour after the start of the forecast on."""
    table = pd.read_csv(folder / "probed.csv")
    table.loc[table["when"] > "2025-01-22 13:00", "room_K"] += 5.0
    table.to_csv(tmp_path / "warm.csv", index=False)
    said = {}
    for name, file in (("as it was", folder / "probed.csv"), ("warmer", tmp_path / "warm.csv")):
        words = ["--data", str(file), "--map", str(folder / "map.yaml"), "--start", "2025-01-22 12:00", "--hours", "24"]
        done = CliRunner().invoke(cli, ["forecast", "--model", str(model), *words])
        assert done.exit_code == 0, done.output
        said[name] = done.output
    assert "warning: the band of living promises 80 % and held far less" in said["warmer"]
    assert "warning" not in said["as it was"]


def test_a_map_whose_hours_are_of_utc_says_so_loudly_until_the_zone_is_told(tmp_path):
    table = pd.DataFrame({"time": pd.date_range("2026-01-12", periods=48, freq="15min", tz="UTC")})
    table["room temperature"], table["outdoor temperature"] = 20 + np.arange(48) % 7 / 4, np.arange(48) / 9
    table["time"] = table["time"].dt.strftime("%Y-%m-%dT%H:%M:%SZ")
    table.to_csv(tmp_path / "house.csv", index=False)
    said = "time.zone of the map is UTC"
    for zone, loud in ((), True), (("--zone", "America/Denver"), False):
        done = tf_mpc(tmp_path, "data", "map", "house.csv", *zone)
        assert (said in done.stderr, "zone: America/Denver  #" in done.stdout) == (loud, not loud)
        assert yaml.safe_load(done.stdout)["outdoor"]
        begun = tf_mpc(tmp_path, "init", str(tmp_path / f"home{loud}"), "--data", "house.csv", *zone)
        assert (said in begun.stdout) is loud
    refused = tf_mpc(tmp_path, "init", "other", "--zone", "UTC").exception
    assert str(refused).startswith("--zone: is of the map that --data writes")
