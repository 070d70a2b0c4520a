"""The emulators of `bestest_hydronic` and `bestest_air`: what their points do, books, refusals, and records beside."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from benchmarks.plant import point_scores
from thermoforce_mpc.boundary.weather import CONTINENTAL, synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError, InputError
from thermoforce_mpc.plants.embedded import PointEmulator
from thermoforce_mpc.plants.registry import emulator_of
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant

NAMES = ("bestest_hydronic", "bestest_air")
ROOM_C = 273.15


@pytest.fixture(scope="module")
def boiler():
    return emulator_of("bestest_hydronic", synthetic_weather())


@pytest.fixture(scope="module")
def office():
    return emulator_of("bestest_air", synthetic_weather(climate=CONTINENTAL))


@pytest.mark.slow
def test_they_are_plants_of_their_test_case(boiler, office):
    for plant, name in zip((boiler, office), NAMES, strict=True):
        assert isinstance(plant, Plant)
        assert (plant.info.kind, plant.info.testcase) == ("embedded", name)
    assert "continental" in office.info.weather


@pytest.mark.slow
def test_a_lowered_cooling_set_point_alone_brings_no_cold_air(office):
    """The mode follows the schedule: at night, below 30 °C, the fan blows air of 21 °C or more."""
    office.reset(200 * DAY_S + 2 * HOUR_S, DAY_S)
    asked = {"con_oveTSetHea": ROOM_C + 10.0, "con_oveTSetCoo": ROOM_C + 16.0}
    state = office.advance_points(asked, HOUR_S)
    assert state.points["fcu_oveFan_u"] > 0.5
    assert state.points["fcu_oveTSup_u"] >= ROOM_C + 21.0
    with_air = office.advance_points(asked | {"fcu_oveTSup": ROOM_C + 12.0}, HOUR_S)
    assert with_air.points["fcu_oveTSup_u"] == ROOM_C + 12.0
    assert with_air.T_zone_C[0] < state.T_zone_C[0] - 2.0


def test_cooling_goes_on_until_a_kelvin_below_the_scheduled_set_point(office):
    office.reset(200 * DAY_S + 12 * HOUR_S, 2 * DAY_S)
    colder = {"con_oveTSetHea": ROOM_C + 10.0, "con_oveTSetCoo": ROOM_C + 22.0}
    seen = []
    for _ in range(40):
        state = office.advance_points(colder, 60.0)
        seen.append((state.T_zone_C[0], state.points["fcu_oveTSup_u"] - ROOM_C))
    cold_air = [T_C for T_C, supply_C in seen if supply_C < 20.9]
    assert cold_air, "cooling mode by day"
    assert min(cold_air) > 22.9
    assert all(supply_C >= 21.0 for T_C, supply_C in seen if T_C < 22.9)


@pytest.mark.slow
@pytest.mark.parametrize(("signal", "runs"), [(0.39, False), (0.51, True)])
def test_the_pump_rounds_its_signal(boiler, signal, runs):
    boiler.reset(20 * DAY_S, DAY_S)
    power_W = boiler.advance_points({"ovePum": signal}, 900.0).points["reaPPum_y"]
    assert power_W == pytest.approx(12.2482 if runs else 0.0)


def test_an_overwritten_set_point_replaces_the_tenth_of_a_kelvin_too(boiler):
    boiler.reset(20 * DAY_S + 3 * HOUR_S, DAY_S)
    assert boiler.advance_points({}, 900.0).points["oveTSetHea_u"] == pytest.approx(ROOM_C + 21.1)
    assert boiler.advance_points({"oveTSetHea": ROOM_C + 21.0}, 900.0).points["oveTSetHea_u"] == ROOM_C + 21.0


def test_heating_power_of_the_boiler_is_fuel(boiler):
    """Water that goes around at 60 °C in a warm house burns what the radiator gives, over the boiler's efficiency."""
    boiler.reset(120 * DAY_S, DAY_S)
    asked = {"ovePum": 1.0, "oveTSetSup": ROOM_C + 60.0}
    boiler.advance_points(asked, 6 * HOUR_S)
    boiler.advance_points(asked, HOUR_S)
    record = boiler.recorded(boiler.now_s - HOUR_S, boiler.now_s)
    T_return_C = record["T_return"] - ROOM_C
    gas_W = record["P_gas"]
    heat_W = np.minimum(0.0597514 * 4184.0 * (60.0 - T_return_C), 5000.0)
    # Efficiencies of the specification between 45 and 55 °C of returning water.
    assert ((T_return_C > 40.0) & (T_return_C < 60.0)).all()
    assert ((heat_W / gas_W > 0.877) & (heat_W / gas_W < 0.902)).all()


@pytest.mark.parametrize("name", NAMES)
def test_any_control_step_gives_the_same_bytes(name, boiler, office):
    plant = boiler if name == NAMES[0] else office
    finals = []
    for step_s in (30.0, 900.0, 3600.0):
        plant.reset(50 * DAY_S, DAY_S)
        for _ in range(int(3 * HOUR_S / step_s)):
            last = plant.advance(None, step_s)
        finals.append((last.T_zone_C[0], plant.recorded(50 * DAY_S, plant.now_s)["P_gas"].sum()))
    assert all(final == finals[0] for final in finals)


def test_branches_of_a_snapshot_share_the_past(office):
    office.reset(50 * DAY_S, DAY_S)
    here = office.snapshot()
    a = office.advance(0.5, 900.0, (22.0, 26.0)).T_zone_C[0]
    office.restore(here)
    assert office.advance(0.5, 900.0, (22.0, 26.0)).T_zone_C[0] == a
    office.restore(here)
    assert office.advance(0.0, 900.0, (15.0, 30.0)).T_zone_C[0] != a


def test_the_sample_of_the_instant_of_a_switch_shows_the_state_before(office):
    begin_s = 20 * DAY_S + 7.75 * 3600.0
    office.reset(begin_s, DAY_S)
    office.advance(None, 1800.0)
    samples = office.recorded(begin_s, office.now_s)
    eight = int(np.argmin(np.abs(samples["time"] - (20 * DAY_S + 8 * 3600.0))))
    before, at, after = (samples["T_heating"][eight + k] for k in (-1, 0, 1))
    assert at == before == pytest.approx(288.15)
    assert after == pytest.approx(294.15)
    assert samples["P_gas"][eight] == pytest.approx(samples["P_gas"][eight - 1], rel=0.05)


def test_gas_and_electricity_cost_what_each_of_them_costs(office):
    office.reset(20 * DAY_S, DAY_S, "dynamic")
    office.advance(None, DAY_S)
    kpis, record = office.kpis(), office.recorded(20 * DAY_S, 21 * DAY_S)
    price = office.tariff("dynamic")(record["time"])
    electric, gas = record["P_chiller"] + record["P_fan"], record["P_gas"]
    cost = np.trapezoid(electric * price + gas * 0.002878, record["time"]) / 3.6e6 / 48.0
    assert kpis["cost_tot"] == pytest.approx(cost)
    assert kpis["ener_tot"] == pytest.approx(np.trapezoid(electric + gas, record["time"]) / 3.6e6 / 48.0)
    assert kpis["pgas_tot"] > 0.0


@pytest.mark.slow
def test_people_who_do_not_keep_to_the_schedule_are_felt(office):
    office.reset(20 * DAY_S, DAY_S)
    office.advance(None, DAY_S)
    lively = emulator_of("bestest_air", office.weather, people=3)
    lively.reset(20 * DAY_S, DAY_S)
    lively.advance(None, DAY_S)
    a, b = (plant.recorded(20 * DAY_S, 21 * DAY_S)["CO2"] for plant in (office, lively))
    assert np.abs(a - b).max() > 10.0


def test_the_denver_tariff_is_dearest_on_summer_afternoons_of_working_days(office):
    at = np.array([160, 160, 158, 20, 20]) * DAY_S + np.array([15, 3, 15, 15, 10]) * HOUR_S
    np.testing.assert_allclose(office.tariff("dynamic")(at), [0.13814, 0.0444, 0.0842, 0.0888, 0.05413])


def test_a_test_case_file_that_does_not_fit_is_refused(office):
    file = load_testcase("bestest_air")
    wrong = file.model_copy(
        update={"measurements": file.measurements.model_copy(update={"zone_temperature": "reaTZon_y"})}
    )
    with pytest.raises(ConfigError, match=r"zone_temperature.*no point 'reaTZon_y'"):
        PointEmulator(wrong, office.weather)
    with pytest.raises(ConfigError, match="those do for bestest_hydronic_heat_pump, bestest_hydronic, bestest_air"):
        emulator_of("twozone_apartment_hydronic", office.weather)
    with pytest.raises(InputError, match="fcu_oveTSup"):
        office.advance_points({"fcu_oveTSup": 400.0}, 900.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_beside_the_records_of_the_real_test_case(shared, name):
    folder = shared / "boptest_more" / name
    if not folder.is_dir():
        pytest.skip(f"no records at {folder}")
    case = point_scores.case_of(folder)
    assert case is not None
    assert case.name == name
    plant = point_scores.recorded_plant(case, folder, None)
    _, targets, _ = point_scores.score(plant, folder, quick=True, progress=lambda _: None)
    assert [target for target in targets if not target.holds] == []
    assert len(targets) > 15


def test_records_of_points_are_told_by_their_columns(tmp_path, office):
    assert point_scores.case_of(tmp_path) is None
    columns = ["time", "zon_reaTRooAir_y", "con_oveTSetHea_y", "con_oveTSetHea_activate"]
    pd.DataFrame([[900.0, 20.0, 15.0, 0]], columns=columns).to_csv(tmp_path / "off_d001_1d.csv.gz", index=False)
    case = point_scores.case_of(tmp_path)
    assert case is not None
    assert case.name == "bestest_air"
