"""A test case from its FMU must tell the same story as the emulator inside that FMU, and say plainly what is wrong."""

from __future__ import annotations

import json
import zipfile

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu")
from benchmarks.chaos.fmu.building import CONFIG, DAYS, KPIS, build_house, build_troubled, rewritten
from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.options import scenario_from
from thermoforce_mpc.data import CONDITIONS, DAY_S, HOUR_S, SIGNALS
from thermoforce_mpc.errors import ConfigError, InputError, WeatherError
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.fmu import FmuPlant
from thermoforce_mpc.plants.fmu.archive import BoundaryData, read_table
from thermoforce_mpc.plants.fmu.process import missing_library
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import Scenario

TESTCASE = load_testcase("bestest_hydronic_heat_pump")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return build_house(tmp_path_factory.mktemp("fmu"))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A house whose process begins in a tenth of the time; nothing makes it fail here."""
    return build_troubled(tmp_path_factory.mktemp("small"))


@pytest.fixture(scope="module")
def inside():
    return EmbeddedPlant(synthetic_weather())


@pytest.mark.slow
def test_it_measures_forecasts_and_scores_as_the_emulator_inside(file, inside):
    with FmuPlant(file, TESTCASE) as plant:
        assert isinstance(plant, Plant)
        assert plant.info.kind == "fmu"
        for p in (plant, inside):
            p.reset(20 * DAY_S, DAY_S, "dynamic")
        assert plant.kpis() == dict.fromkeys(inside.kpis(), 0.0), "nothing counts before the warm-up is over"
        for u, duration in ((0.5, 900.0), (1.0, 3600.0), (0.0, 600.0), (None, 2100.0)):
            a, b = plant.advance(u, duration), inside.advance(u, duration)
            assert a.time_s == b.time_s
            for name in ("T_zone_C", "T_out_C", "solar_W_m2", "u", "power_W", "heat_W", "T_return_C"):
                assert getattr(a, name) == pytest.approx(getattr(b, name), abs=1e-9), name
        assert a.points["reaTZon_y"] == pytest.approx(a.T_zone_C + 273.15)
        for name, value in inside.kpis().items():
            assert plant.kpis()[name] == pytest.approx(value, rel=1e-9), name
        assert plant.kpis()["ener_tot"] > 0
        a, b = plant.past(HOUR_S), inside.past(HOUR_S)
        assert a.n_steps == 26
        for name in SIGNALS:
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-9, atol=1e-6, err_msg=name)
        a, b = plant.forecast(DAY_S, HOUR_S), inside.forecast(DAY_S, HOUR_S)
        for name in CONDITIONS:
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-9, err_msg=name)


@pytest.mark.slow
def test_two_plants_live_side_by_side_and_the_same_run_gives_the_same_bytes(small):
    with FmuPlant(small, TESTCASE) as one, FmuPlant(small, TESTCASE) as other:
        one.reset(30 * DAY_S, 0.0)
        other.reset(30 * DAY_S, 0.0)
        for _ in range(3):
            warm, cold = one.advance(1.0, 3600.0), other.advance(0.0, 3600.0)
        assert warm.heat_W > 1000.0 > cold.heat_W
        assert warm.T_zone_C > cold.T_zone_C
        other.reset(30 * DAY_S, 0.0)
        for _ in range(3):
            again = other.advance(1.0, 3600.0)
        assert again == warm, "a reset leaves nothing of the run before"


def test_windows_are_those_of_the_fmu(file):
    with FmuPlant(file, TESTCASE) as plant:
        assert plant.period("peak_heat_day").start_s == (DAYS["peak_heat_day"] - 7) * DAY_S
        assert plant.period("44").start_s == 44 * DAY_S
        with pytest.raises(InputError, match="expected peak_heat_day, typical_heat_day or a start day"):
            plant.period("peak_cool_day")
        with pytest.raises(InputError, match="between 0 and 365"):
            plant.period("400")


@pytest.mark.slow
def test_forecast_errors_leave_the_truth_alone(file):
    with FmuPlant(file, TESTCASE, forecast_error=ForecastError("high", "high", 3)) as plant:
        plant.reset(30 * DAY_S, 0.0)
        seen = plant.forecast(DAY_S, HOUR_S)
        truth = synthetic_weather().at("T_dry_C", seen.time_s)
        assert np.abs(seen.T_out_C - truth).max() > 0.1
        assert plant.advance(None, HOUR_S).T_out_C == pytest.approx(truth[1], abs=1e-6)


def test_a_library_that_the_machine_lacks_is_named_with_what_to_do():
    loader = "Failed to load shared library wrapped.so. {}: cannot open shared object file: No such file or directory"
    assert "lacks: install it; on Debian" in missing_library(loader.format("libgfortran.so.5"))
    assert missing_library(loader.format("libipopt.so.3")).endswith(
        "libipopt.so.3, which this machine lacks: install it"
    )
    assert missing_library("Failed to instantiate FMU") == ""


def test_a_forecast_over_new_year_repeats_the_year(small):
    with FmuPlant(small, TESTCASE) as plant:
        plant.reset(364.5 * DAY_S, 0.0)
        seen = plant.forecast(DAY_S, HOUR_S)
        truth = synthetic_weather().at("T_dry_C", np.array([364.75, 0.25]) * DAY_S)
        np.testing.assert_allclose(seen.T_out_C[[6, 18]], truth, atol=1e-9)


def table(rows):
    return BoundaryData(read_table(b"time,PriceElectricPowerConstant,TDryBul\n" + rows.encode(), "data.csv"))


@pytest.mark.parametrize(
    ("begins_h", "seen"),
    [(8759.0, [2, 2, 4, 1, 2]), (8759.5, [2, 4, 1, 2, 2]), (8760.0, [1, 1, 2, 2, 2]), (17520.0, [1, 1, 2, 2, 2])],
)
def test_what_begins_at_new_year_is_of_the_new_year(begins_h, seen):
    """BOPTEST's `data_manager`: what begins before takes the year's last row for midnight, the first row after it."""
    data = table("0,1,280\n3600,2,280\n31536000,4,280\n")
    asked_s = 3600.0 * (begins_h + 0.5 * np.arange(5))
    np.testing.assert_array_equal(data.at("PriceElectricPowerConstant", asked_s), seen)


def test_rows_without_a_value_are_left_out():
    """BOPTEST's own `occupancy.csv` of `multizone_office_simple_hydronic` has some."""
    data = table("0,1,280\n3600,,\n7200,3,290\n")
    np.testing.assert_array_equal(data.at("PriceElectricPowerConstant", np.array([0.0, 3600.0, 7200.0])), [1, 1, 3])
    assert data.at("TDryBul", np.array([3600.0])) == pytest.approx(285.0)


@pytest.mark.parametrize("level", [float("nan"), 1.5, -0.1, "high"])
def test_a_level_that_is_no_level_is_refused(file, level):
    with FmuPlant(file, TESTCASE) as plant, pytest.raises(InputError, match="number from 0 to 1"):
        plant.advance(level, 900.0)


@pytest.mark.parametrize("step", [0.0, -30.0, float("nan"), 366 * DAY_S, "an hour"])
def test_a_step_that_is_no_step_is_refused(file, step):
    with FmuPlant(file, TESTCASE) as plant, pytest.raises(InputError, match="positive number, less than a year"):
        plant.advance(0.5, step)


def test_what_needs_a_start_says_so(file):
    with FmuPlant(file, TESTCASE) as plant:
        asks = [lambda: plant.advance(0.5, 900.0), plant.kpis, lambda: plant.past(900.0)]
        for ask in (*asks, lambda: plant.forecast(3600.0, 900.0)):
            with pytest.raises(InputError, match="call reset"):
                ask()


def test_a_start_beyond_the_data_is_refused(small, tmp_path):
    short = "time,TDryBul,HGloHor\n" + "".join(f"{hour * 3600},280.0,0.0\n" for hour in range(48))
    with FmuPlant(rewritten(small, tmp_path / "short.fmu", {"resources/weather.csv": short}), TESTCASE) as plant:
        with pytest.raises(WeatherError, match=r"weather.csv: 'TDryBul' covers days 0 to 2, asked for days 3 to 3"):
            plant.reset(3 * DAY_S, 0.0)
        plant.reset(1.5 * DAY_S, 0.0)
        with pytest.raises(WeatherError, match="covers days 0 to 2"):
            plant.forecast(DAY_S, HOUR_S)
    with FmuPlant(small, TESTCASE) as plant:
        with pytest.raises(InputError, match="beyond the year"):
            plant.reset(366 * DAY_S, 0.0)
        with pytest.raises(InputError, match="unknown tariff"):
            plant.reset(DAY_S, 0.0, "cheap")
        with pytest.raises(InputError, match="finite, nonnegative"):
            plant.reset(float("nan"), 0.0)


WRONG_FILES = {
    "cut": (lambda data: data[: len(data) // 2], "not an FMU"),
    "text": (lambda data: b"model wrapped\nend wrapped;\n", "not an FMU"),
}


@pytest.mark.parametrize("case", WRONG_FILES)
def test_a_file_that_is_no_fmu(file, tmp_path, case):
    damage, message = WRONG_FILES[case]
    wrong = tmp_path / "wrong.fmu"
    wrong.write_bytes(damage(file.read_bytes()))
    with pytest.raises(ConfigError, match=message):
        FmuPlant(wrong, TESTCASE)


def test_a_missing_file_and_a_zip_that_is_no_fmu(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        FmuPlant(tmp_path / "none.fmu", TESTCASE)
    with zipfile.ZipFile(tmp_path / "zip.fmu", "w") as archive:
        archive.writestr("readme.txt", "nothing here")
    with pytest.raises(ConfigError, match=r"no modelDescription\.xml"):
        FmuPlant(tmp_path / "zip.fmu", TESTCASE)


def _version_3(root):
    root.set("fmiVersion", "3.0")


def _model_exchange(root):
    root.find("CoSimulation").tag = "ModelExchange"


def _kelvin_lost(root):
    for variable in root.iter("ScalarVariable"):
        if variable.get("name") == "reaTZon_y":
            variable.find("Real").set("unit", "degC")


def _zone_lost(root):
    for variable in root.iter("ScalarVariable"):
        if variable.get("name") == "reaTZon_y":
            variable.set("name", "reaTRoo_y")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("describe", "message"),
    [
        (_version_3, r"FMI version 3\.0"),
        (_model_exchange, "co-simulation is needed"),
        (_kelvin_lost, "'reaTZon_y' is in degC"),
        (_zone_lost, r"measurements\.zone_temperature: the FMU .* has no point 'reaTZon_y'.*reaTRoo_y"),
    ],
)
def test_a_description_that_does_not_fit(file, tmp_path, describe, message):
    with pytest.raises(ConfigError, match=message):
        FmuPlant(rewritten(file, tmp_path / "other.fmu", {}, describe), TESTCASE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"resources/kpis.json": "{"}, r"kpis\.json: not valid JSON"),
        ({"resources/kpis.json": json.dumps(KPIS | {"GasPower": ["reaPGas_y"]})}, "does not have: reaPGas_y"),
        ({"resources/kpis.json": json.dumps(KPIS | {"ElectricPower": "reaPFan_y"})}, "expected a list of outputs"),
        ({"resources/days.json": '{"peak_heat_day": 400}'}, "expected a day from 0 to 364"),
        ({"resources/days.json": '{"peak_heat_day": true}'}, "is True, expected a day from 0 to 364"),
        ({"resources/days.json": "[" * 100_000}, r"days\.json: not valid JSON"),
        ({"resources/config.json": json.dumps(CONFIG | {"area": True})}, "expected square metres"),
        ({"resources/config.json": json.dumps(CONFIG | {"area": 1e308})}, "expected square metres"),
        ({"resources/config.json": json.dumps(CONFIG | {"resource_file_exclusion": 3})}, "expected a list of files"),
        (
            {"resources/emissions.csv": "time,EmissionsElectricPower\n0,0.1,1\n900,0.1,1\n"},
            "more cells than its header",
        ),
        (
            {"resources/emissions.csv": "time,EmissionsElectricPower\n0,1e300\n900,0.1\n"},
            "data row 1: '1e\\+300' is no",
        ),
        ({"resources/emissions.csv": 'time,EmissionsElectricPower\n0,"0.1\n900,0.1\n'}, "line 2: a quotation mark"),
        ({"resources/emissions.csv": "time," * 5000 + "\n0,0.1\n900,0.1\n"}, "line 1 has more than 20,000 bytes"),
        ({"resources/config.json": json.dumps(CONFIG | {"area": 48.0})}, "another building"),
        ({"resources/emissions.csv": None}, "forecast.emission: the FMU .* has no point"),
        (
            {"resources/emissions.csv": "time,EmissionsElectricPower,Other\n0,0.1,1\n900,,1\n"},
            r"data row 2: 'nan' is no number",
        ),
        ({"resources/emissions.csv": "time,EmissionsElectricPower\n900,0.1\n0,0.1\n"}, "'time' must rise"),
        ({"resources/again.csv": "time,TDryBul\n0,280\n900,280\n"}, "already in"),
    ],
)
def test_resources_that_cannot_be_used(file, tmp_path, changed, message):
    with pytest.raises(ConfigError, match=message):
        FmuPlant(rewritten(file, tmp_path / "other.fmu", changed), TESTCASE)


def test_binaries_of_another_platform(file, tmp_path):
    with zipfile.ZipFile(file) as archive:
        shared = [name for name in archive.namelist() if name.startswith("binaries/") and not name.endswith(".dll")]
    other = rewritten(file, tmp_path / "other.fmu", dict.fromkeys(shared))
    with pytest.raises(ConfigError, match=r"no binaries for this machine .* runs on: win64"):
        FmuPlant(other, TESTCASE)


@pytest.mark.slow
def test_without_kpis_json_the_test_case_file_says_what_counts(file, inside, tmp_path):
    with FmuPlant(rewritten(file, tmp_path / "bare.fmu", {"resources/kpis.json": None}), TESTCASE) as plant:
        for p in (plant, inside):
            p.reset(20 * DAY_S, 0.0)
            p.advance(1.0, HOUR_S)
        expected = inside.kpis()
        del expected["idis_tot"]  # the test case file names no CO2 sensor
        assert plant.kpis() == pytest.approx(expected)


@pytest.mark.slow
def test_gas_is_billed_at_the_price_of_gas(file, inside, tmp_path):
    """Condenser heat declared as gas: every KPI can then be worked out from the emulator's own two meters."""
    held = "time,PriceGasPower,EmissionsGasPower\n0,0.05,0.2\n31536000,0.05,0.2\n"
    listed = KPIS | {"GasPower": ["reaQHeaPumCon_y"], "ElectricPower": ["reaPFan_y"], "None": ["reaTSup_y"]}
    changed = {"resources/gas.csv": held, "resources/kpis.json": json.dumps(listed)}
    with FmuPlant(rewritten(file, tmp_path / "gas.fmu", changed), TESTCASE) as plant:
        for p in (plant, inside):
            p.reset(20 * DAY_S, 0.0)
            p.advance(0.8, HOUR_S)
        kpis = plant.kpis()
    record = inside.recorded(20 * DAY_S, inside.now_s)
    gas, fan = (np.trapezoid(record[name], record["time"]) / 3.6e6 / 192.0 for name in ("Q_condenser", "P_fan"))
    assert gas > 10 * fan > 0
    assert kpis["ener_tot"] == pytest.approx(gas + fan)
    assert kpis["cost_tot"] == pytest.approx(0.05 * gas + 0.2535 * fan)
    assert kpis["emis_tot"] == pytest.approx(0.2 * gas + 0.167 * fan)
    assert kpis["pgas_tot"] > kpis["pele_tot"] > 0


@pytest.mark.slow
def test_the_cli_runs_it(file, tmp_path):
    command = ["run", "--testcase", TESTCASE.name, "--fmu", str(file), "--period", "0.25", "--days", "0.25"]
    options = ["--controller", "thermostat", "--baselines", "", "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(cli, [*command, *options, "--quiet"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert "wrapped.fmu" in json.dumps(manifest)
    result = CliRunner().invoke(cli, [*command, "--url", "http://127.0.0.1:1"])
    assert "different plants" in result.output


def test_an_option_wins_over_the_plant_of_a_scenario_file(tmp_path):
    config = tmp_path / "mine.yaml"
    config.write_text("testcase: bestest_hydronic_heat_pump\nplant: {kind: fmu, path: other.fmu}\n")
    served = scenario_from({"config": str(config), "url": "http://127.0.0.1:1"}).plant
    assert (served.kind, served.path) == ("boptest", None)
    config.write_text("testcase: bestest_hydronic_heat_pump\nplant: {kind: boptest}\n")
    filed = scenario_from({"config": str(config), "fmu": "mine.fmu"}).plant
    assert (filed.kind, filed.path) == ("fmu", "mine.fmu")


def test_kind_and_path_go_together():
    with pytest.raises(ValueError, match="go together"):
        Scenario.model_validate({"testcase": "x", "plant": {"kind": "fmu"}})
    with pytest.raises(ValueError, match="go together"):
        Scenario.model_validate({"testcase": "x", "plant": {"path": "wrapped.fmu"}})
