"""The other shipped test cases, driven through their YAML files alone: FMUs with the documented points, and REST."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu")
from emulator_service import running_emulator_service
from fmu_files import build_room

from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.boptest.plant import BoptestPlant
from thermoforce_mpc.plants.fmu import FmuPlant
from thermoforce_mpc.plants.testcases import load_testcase


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("others")
    return {
        "bestest_air": build_room("bestest_air", "fmu_office.py", folder),
        "bestest_hydronic": build_room("bestest_hydronic", "fmu_radiator.py", folder),
    }


@pytest.mark.slow
def test_more_u_is_more_effort_and_costs_more(fmus):
    testcase = load_testcase("bestest_hydronic")
    reached, spent = [], []
    with FmuPlant(fmus[testcase.name], testcase) as plant:
        for u in (0.0, 0.5, 1.0):
            plant.reset(100 * DAY_S, 0.0)
            measured = plant.advance(u, 2 * HOUR_S)
            # A radiator's set-point is that for the room at the start of the block; a warmer room takes less.
            assert (
                measured.u[0] == pytest.approx(u)
                if testcase.actuator.map == "linear"
                else 0.8 * u <= measured.u[0] <= u
            )
            reached.append(measured.T_zone_C[0])
            spent.append(measured.power_W[0])
    assert np.diff(reached).min() > 0.05, reached
    assert np.diff(spent).min() > 1.0, spent


@pytest.mark.slow
def test_room_setpoints_are_kept_and_the_level_is_the_measured_heat(fmus):
    testcase = load_testcase("bestest_air")
    with FmuPlant(fmus["bestest_air"], testcase) as plant:
        plant.reset(100 * DAY_S, 0.0)
        cold = plant.advance(-0.3, HOUR_S, (15.0, 22.0))
        plant.advance(0.3, 12 * HOUR_S, (25.0, 30.0))
        warm = plant.advance(0.3, HOUR_S, (25.0, 30.0))
        record = plant.past(HOUR_S)
        prices = plant.forecast(HOUR_S, HOUR_S)
        with pytest.raises(InputError, match="without room set-points"):
            plant.advance(0.3, HOUR_S)
        with pytest.raises(InputError, match=r"level of -0\.7"):
            plant.advance(-0.7, HOUR_S, (21.0, 24.0))
        with pytest.raises(InputError, match="heating set-point not above"):
            plant.advance(0.3, HOUR_S, (24.0, 21.0))
    # The office starts at 29 °C; its loops are proportional, so they rest a little off their set-points.
    assert 21.0 < cold.T_zone_C < 24.0
    assert warm.T_zone_C == pytest.approx(25.0, abs=0.3)
    assert cold.u < 0.0 < warm.u
    assert warm.u == pytest.approx(warm.heat_W / 11000.0)
    fan_W = cold.power_W + cold.heat_W / 3.0  # no gas was burnt
    assert 0.0 < fan_W <= 130.0, "heat from the room is three times the chiller's power"
    assert record.u.min() < 0.0 < record.u.max()
    assert (prices.price_per_kWh[0, 0], prices.heating_price_per_kWh[0, 0]) == (0.2, 0.05)


def test_room_setpoints_are_refused_where_there_are_none(fmus):
    with FmuPlant(fmus["bestest_hydronic"], load_testcase("bestest_hydronic")) as plant:
        plant.reset(20 * DAY_S, 0.0)
        with pytest.raises(InputError, match="the actuator 'oveTSetSup' has none"):
            plant.advance(0.5, HOUR_S, (21.0, 24.0))


def test_gas_and_electricity_each_at_their_price(fmus):
    with FmuPlant(fmus["bestest_hydronic"], load_testcase("bestest_hydronic")) as plant:
        plant.reset(20 * DAY_S, 0.0, "dynamic")
        assert plant.forecast(2 * HOUR_S, HOUR_S).price_per_kWh[0].tolist() == [0.05] * 3, (
            "planned with the price of gas"
        )
        plant.advance(0.5, HOUR_S)
        held = plant.advance(0.01, HOUR_S)
        assert held.points["ovePum_y"] == 1.0, "the pump is held while u acts"
        kpis = plant.kpis()
        stopped = plant.advance(0.0, HOUR_S)
        assert (stopped.points["ovePum_y"], stopped.u) == (0.0, 0.0)
        released = plant.advance(None, HOUR_S)
    gas = kpis["ener_tot"] - 20.0 * 2.0 / 1e3 / 48.0
    assert kpis["cost_tot"] == pytest.approx(0.05 * gas + 0.3 * 20.0 * 2.0 / 1e3 / 48.0, rel=0.01)
    assert {"pgas_tot", "pele_tot", "tdis_tot", "idis_tot"} < set(kpis)
    assert released.points["ovePum_y"] in (0.0, 1.0)
    assert released.points["oveTSetSup_y"] != 293.15, "native control is back"


@pytest.mark.slow
def test_its_own_windows_and_native_control_by_the_command_line(fmus, tmp_path):
    with FmuPlant(fmus["bestest_air"], load_testcase("bestest_air")) as plant:
        assert plant.period("mix_day").start_s == (350 - 7) * DAY_S
    words = ["run", "--testcase", "bestest_air", "--fmu", str(fmus["bestest_air"]), "--period", "peak_cool_day"]
    words += ["--days", "0.5", "--controller", "native", "--baselines", "", "--out", str(tmp_path / "run")]
    done = CliRunner().invoke(cli, [*words, "--quiet"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    kpis = json.loads((tmp_path / "run" / "kpis.json").read_text())
    assert (kpis["testcase"], kpis["start_day"]) == ("bestest_air", 282)
    assert "USD" in done.output


@pytest.mark.slow
def test_points_are_held_and_let_go_over_rest():
    testcase = load_testcase("bestest_hydronic_heat_pump")
    actuator = testcase.actuator.model_copy(update={"held": {"ovePum": 1.0}})
    with (
        running_emulator_service() as url,
        BoptestPlant(url, testcase.model_copy(update={"actuator": actuator})) as plant,
    ):
        plant.reset(200 * DAY_S, 0.0)
        off = plant.advance(0.0, HOUR_S)
        assert (off.points["ovePum_u"], off.points["ovePum_activate"]) == (1.0, 1.0)
        assert off.points["reaPPumEmi_y"] > 0
        free = plant.advance(None, HOUR_S)
        assert free.points["ovePum_activate"] == free.points["oveHeaPumY_activate"] == 0.0


@pytest.mark.slow
def test_the_set_point_follows_the_room_so_that_heat_does_not(fmus):
    """A radiator at one level heats a cold and a warm room alike, and what native control does has its level too."""
    testcase = load_testcase("bestest_hydronic")
    # The test FMU's radiator is linear in the water's excess temperature.
    actuator = testcase.actuator.model_copy(update={"exponent": 1.0})
    with FmuPlant(fmus["bestest_hydronic"], testcase.model_copy(update={"actuator": actuator})) as plant:
        plant.reset(20 * DAY_S, 0.0)
        spent, rooms = [], []
        for _ in range(6):
            measured = plant.advance(0.5, 300.0)
            spent.append(measured.power_W[0])
            rooms.append(measured.T_zone_C[0])
            assert measured.u == pytest.approx(0.5, abs=0.01)
        assert rooms[-1] > rooms[0] + 0.3
        assert np.ptp(spent) < 0.03 * np.mean(spent)
        plant.advance(1.0, 12 * HOUR_S)
        native = plant.advance(None, HOUR_S)
        assert (native.points["ovePum_y"], native.u) == (0.0, 0.0), "pump off: no heat, whatever the set-point"
        cold = plant.advance(0.0, 12 * HOUR_S)
        native = plant.advance(None, HOUR_S)
        assert cold.u == 0.0 < native.u
