"""`tf-mpc init --from-url`: a test case file proposed from the points of a service, which runs there as it is."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from boptest_client import Point
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.boptest.plant import BoptestPlant
from thermoforce_mpc.plants.boptest.proposal import ServicePoints, proposed_testcase
from thermoforce_mpc.plants.points import check_points
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.settings import parse_value
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.service.server import serving


def tf_mpc(*words: str):
    return CliRunner().invoke(cli, list(words))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "point", "power"),
    [
        ("bestest_hydronic_heat_pump", "oveHeaPumY", ("reaPFan_y", "reaPHeaPum_y", "reaPPumEmi_y")),
        ("bestest_hydronic", "oveTSetSup", ("reaQHea_y",)),
        ("bestest_air", "fcu_oveFan", ("fcu_reaPHea_y",)),
    ],
)
def test_the_proposed_file_is_that_of_the_service_and_runs(name, point, power, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with serving(synthetic_weather(), testcase=name) as url:
        done = tf_mpc("init", str(tmp_path / "study"), "--testcase", name, "--from-url", url)
        assert done.exit_code == 0, done.output
        proposed = load_testcase(str(tmp_path / "study" / "testcase.yaml"))
        assert proposed.actuator.point == point
        assert set(proposed.metered.electric_power) == set(power)
        assert proposed.metered.zone_temperature == load_testcase(name).metered.zone_temperature
        monkeypatch.chdir(tmp_path / "study")
        assert tf_mpc("validate", "scenario.yaml").exit_code == 0
        monkeypatch.chdir(tmp_path)
        with BoptestPlant(url, proposed) as plant:
            plant.reset(20 * 86400.0, 0.0)
            before = plant.advance(1.0, 3600.0).T_zone_C[0]
            assert plant.advance(1.0, 4 * 3600.0).T_zone_C[0] > before  # it heats
        for folder, asked, told in (("study", name, "never overwritten"), ("other", "somebodys", f"offers {name}")):
            refused = tf_mpc("init", folder, "--testcase", asked, "--from-url", url)
            assert isinstance(refused.exception, ConfigError)
            assert told in str(refused.exception)


def points(*rows: tuple[str, str, str]) -> dict[str, Point]:
    return {name: Point(name, unit, words, 0.0 if unit == "1" else 283.15, 1.0 if unit == "1" else 323.15)
            for name, unit, words in rows}  # fmt: skip


def office() -> ServicePoints:
    """Two zones with circuits of their own, cooled too, in the words of BOPTEST's offices; one that is not heated."""
    inputs, measured, forecast = [], [], []
    for key, word in (("nZ", "North"), ("sZ", "South")):
        end = key.capitalize()
        inputs += [
            (f"oveTSupEmiCoo{end}_u", "K", f"{word} zone cooling emission circuit supply temperature setpoint"),
            (f"oveTSupEmiHea{end}_u", "K", f"{word} zone heating emission circuit supply temperature setpoint"),
            (f"ovePrfEmiHea{end}_u", "1", f"{word} zone emission heating pump activation setpoint"),
            (f"ovePrfAhuHea{end}_u", "1", f"{word} zone AHU heating pump activation setpoint"),
        ]
        measured += [
            (f"reaTRetEmiHea{end}_y", "K", f"{word} zone heating emission system return temperature"),
            (f"reaTZonPercLow{end}_y", "K", f"{word} zone lower percentile temperature"),
            (f"reaTZon{end}_y", "K", f"{word} zone operative temperature"),
        ]
    for key in ("nZ", "sZ", "att"):
        forecast += [(f"{what}[{key}]", "K", "") for what in ("LowerSetp", "UpperSetp", "Occupancy")]
    measured += [
        ("reaTZonAtt_y", "K", "Zone temperature of zone att"),
        ("reaPProHea_y", "W", "Electric power used by the heating production system"),
        ("reaPProCoo_y", "W", "Electric power used by the cooling production system"),
        ("weaSta_reaWeaTDryBul_y", "K", "Outside drybulb temperature measurement"),
        ("weaSta_reaWeaHGloHor_y", "W/m2", "Global horizontal solar irradiation measurement"),
    ]
    weather = [("TDryBul", "K", ""), ("HGloHor", "W/m2", ""), ("EmissionsElectricPower", "kgCO2/kWh", "")]
    prices = [(f"PriceElectricPower{one}", "($/Euro)/kWh", "") for one in ("Constant", "Dynamic", "HighlyDynamic")]
    inputs += [(name.replace("_u", "_activate"), "1", "") for name, _, _ in inputs]
    return ServicePoints(points(*inputs), points(*measured), points(*forecast, *weather, *prices))


def test_zones_get_what_heats_them_and_others_are_left_out():
    at = office()
    proposed = TestCase.model_validate(parse_value(proposed_testcase("office", at), "proposed"))
    check_points(proposed, at.inputs, at.measurements, at.forecast)
    assert {key: zone.temperature for key, zone in proposed.zones.items()} == {
        "nZ": "reaTZonNz_y", "sZ": "reaTZonSz_y",
    }  # fmt: skip
    north = proposed.actuators["nZ_heating"]
    assert (north.point, north.map, north.switch) == ("oveTSupEmiHeaNz", "radiator", "ovePrfEmiHeaNz")
    assert proposed.machines["machine"].power == ("reaPProHea_y",)


def test_what_is_missing_is_said():
    at = office()
    bare = {name: one for name, one in at.forecast.items() if "LowerSetp" not in name}
    with pytest.raises(ConfigError, match="names no zone with a comfort band"):
        proposed_testcase("office", ServicePoints(at.inputs, at.measurements, bare))
    with pytest.raises(ConfigError, match="no input heats a single zone"):
        proposed_testcase("office", ServicePoints({}, at.measurements, at.forecast))


def test_an_unknown_test_case_says_how_a_file_of_it_is_made():
    with pytest.raises(ConfigError, match=r"^unknown testcase 'my_office'.* DIR --testcase NAME --from-url URL"):
        load_testcase("my_office")
