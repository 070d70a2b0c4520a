"""Test cases of several zones written from BOPTEST's sources, on a service with their names and control."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from boptest_server import running_service
from click.testing import CliRunner
from fake_boptest import DESIGN_M3S, LEAST_M3S, FakeService
from multizone_points import HOUSE_ROOMS, OFFICE_ZONES

from thermoforce_mpc import run
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.boptest.plant import BoptestPlant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.settings import find_config, merge, read_yaml, validate
from thermoforce_mpc.scenario.testcase import TestCase

HOUSE, OFFICE = "multizone_residential_hydronic", "multizone_office_simple_air"


@pytest.fixture
def service():
    with running_service(FakeService()) as service:
        yield service


def test_boiler_and_pump_run_while_a_valve_is_open_and_only_then(service):
    with BoptestPlant(service.url, load_testcase(HOUSE)) as plant:
        plant.reset(30 * DAY_S, DAY_S)
        shut = plant.advance([0.0] * 5, HOUR_S)
        one = plant.advance([0.0, 0.0, 0.0, 1.0, 0.0], HOUR_S)
        sent = service.started[-1].sent
        assert (sent[0]["oveTSetPumBoi_u"], sent[0]["oveTSetPumBoi_activate"]) == (283.15, 1.0)
        assert (sent[1]["oveTSetPumBoi_u"], sent[1]["oveTSetSup_u"]) == (303.15, 333.15)
        assert all(sent[1][f"conHea{room}_oveActHea_activate"] == 1.0 for room in HOUSE_ROOMS)
    assert (shut.power_W[0], one.u.tolist()) == (pytest.approx(2.56 * 4.0), [0.0, 0.0, 0.0, 1.0, 0.0])
    assert one.power_W[0] > 2.56 * 141.0, "gas, and the pump at the price of electricity over that of gas"
    assert one.heat_W[3] > 500.0 > 50.0 > abs(one.heat_W[4])
    assert one.T_zone_C[3] - shut.T_zone_C[3] > max(one.T_zone_C[[0, 1, 2, 4]] - shut.T_zone_C[[0, 1, 2, 4]])


def test_a_room_that_was_handed_back_keeps_its_water(service):
    with BoptestPlant(service.url, load_testcase(HOUSE)) as plant:
        plant.reset(30 * DAY_S, DAY_S)
        plant.advance([None, 0.0, 0.0, 0.0, 0.0], 900.0)
        plant.advance([None, 0.0, 0.0, 0.0, 1.0], 900.0)
        plant.advance(None, 900.0)
        some, open_one, native = service.started[-1].sent
    assert (some["conHeaLiv_oveActHea_activate"], some["conHeaBth_oveActHea_activate"]) == (0.0, 1.0)
    assert some["oveTSetPumBoi_activate"] == some["oveTSetSup_activate"] == 0.0, "the native thermostat decides"
    assert (open_one["oveTSetPumBoi_u"], open_one["oveTSetPumBoi_activate"]) == (303.15, 1.0)
    assert set(native.values()) == {0.0}


@pytest.mark.slow
def test_a_valve_that_native_control_opens_without_water_has_no_level(service):
    """In the sun the living room turns the boiler off, and the valves of the cold rooms open for nothing."""
    with BoptestPlant(service.url, load_testcase(HOUSE)) as plant:
        plant.reset(30 * DAY_S, 7 * DAY_S)
        record = plant.past(900.0)
        rows = service.started[-1].recorded(["oveEmiPum_u", "conHeaRo3_oveActHea_u"], 0.0, 30 * DAY_S)
    stands = np.array(rows["oveEmiPum_u"]) == 0.0
    assert np.array(rows["conHeaRo3_oveActHea_u"])[stands].max() > 0.3
    heat_W, u = record.heat_W[3, 1:], record.u[3, 1:]
    assert u.max() > 0.3
    assert u[heat_W < 20.0].max() < 0.1, "no level where no heat came for a while"


def test_the_level_of_a_box_is_0_at_rest_and_has_the_sign_of_what_its_loop_does(service):
    with BoptestPlant(service.url, load_testcase(OFFICE)) as plant:
        plant.reset(30 * DAY_S, DAY_S)
        night = plant.advance([0.0] * 5, 6 * HOUR_S, [(12.0, 30.0)] * 5)
        rest = plant.advance([0.0] * 5, HOUR_S, [(12.0, 30.0)] * 5)
        plant.advance([0.5] * 5, HOUR_S, [(23.0, 30.0)] * 5)
        row = service.started[-1].recorded(
            ["hvac_reaZonSou_V_flow_y", "hvac_reaZonSou_TSup_y", "hvac_reaZonSou_TZon_y"], 0, 1e9
        )
        warm = plant.advance([0.5] * 5, 900.0, [(24.0, 30.0)] * 5)
        cold = plant.advance([-0.5] * 5, 900.0, [(12.0, 18.0)] * 5)
        sent = service.started[-1].sent[-1]
    assert row["hvac_reaZonSou_V_flow_y"][-1] == pytest.approx(0.3 * DESIGN_M3S["Sou"])
    assert abs(night.u).max() == 0.0
    assert abs(rest.u).max() < 1e-9, "the least flow of cold air is nobody's choice"
    assert warm.u.min() > 0.5
    assert -2.2 < cold.u.min() <= cold.u.max() < -0.3
    full_W = 1207.0 * ((0.3 * DESIGN_M3S["Sou"]) * 20.0 - (0.3 * DESIGN_M3S["Sou"] - LEAST_M3S["Sou"]) * 8.0)
    assert load_testcase(OFFICE).actuators["sou_box"].heating_W == pytest.approx(full_W, rel=0.01)
    for zone in OFFICE_ZONES:
        at = f"hvac_oveZonSup{zone}_TZon"
        assert (sent[f"{at}CooSet_u"], sent[f"{at}HeaSet_u"]) == (pytest.approx(291.15), 285.15)
        assert sent[f"{at}CooSet_activate"] == sent[f"{at}HeaSet_activate"] == 1.0
    assert sum(load_testcase(OFFICE).layout.shares) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", [HOUSE, OFFICE])
def test_it_is_probed_planned_for_and_written_to_by_the_command_line(name, service, tmp_path):
    """Little data and no gate: what is tested is the way from the YAML file to the points, not what a plan is worth."""
    fast = {"enabled": False}
    scenario = {
        "testcase": name, "step_s": 1800, "period": "30", "days": 1 / 24, "baselines": [],
        "plant": {"kind": "boptest", "url": service.url},
        "identification": {
            "days": 1, "most_days": 1, "probing": {"candidates": 2, "warmup_days": 1, "step_s": 1800},
            "options": {
                "order": 1, "modulation": "linear", "sun_on_sensor": False, "cross_effects": False,
                "foreign_loads": False,
            },
        },
        "controller": {
            "name": "thermoforce_mpc",
            "options": {"horizon_h": 12, "gate": fast, "watch": fast, "free_response": {"name": "persistence"}},
        },
    }  # fmt: skip
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(scenario))
    words = ["run", "--config", str(tmp_path / "scenario.yaml"), "--out", str(tmp_path / "run"), "--quiet"]
    done = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    last = service.started[-1].sent[-1]
    assert {value for key, value in last.items() if key.endswith("_activate")} == {1.0}, (
        "a plan acted, not native control"
    )
    if name == HOUSE:
        valves = [last[f"conHea{room}_oveActHea_u"] for room in HOUSE_ROOMS]
        assert set(valves) <= {0.0, 1.0}
        assert last["oveTSetPumBoi_u"] == (303.15 if any(valves) else 283.15)
    else:
        assert len(last) == 20


@pytest.mark.slow
@pytest.mark.parametrize("name", [HOUSE, OFFICE])
def test_thermostats_and_native_control_run_beside_each_other(name, service):
    plant = {"kind": "boptest", "url": service.url}
    result = run(
        name, controller="thermostat", baselines=["native"], plant=plant, period="1", days=1 / 8, progress=False
    )
    assert set(result.kpis) == {"thermostat", "native"}
    sent = {bool(any(one.values())): one for test in service.started for one in test.sent}
    assert set(sent) == {True, False}, "one of them acts, the other releases every point"


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        (HOUSE, {"machines": {"boiler": {"idle": {"x": 1.0}}}}, r"machines\.boiler.*idle: 'x' is not one of"),
        (HOUSE, {"machines": {"boiler": {"held": {"conHeaRo1_oveActHea": 1.0}}}}, "a point of actuators.Ro1_valve"),
        (HOUSE, {"plant": "rooms"}, "machines.boiler: the plant 'rooms'"),
        (
            HOUSE,
            {
                "machines": {"other": {"power": ["P_y"], "held": {"oveTSetSup": 1}}},
                "actuators": {"Ro1_valve": {"machine": "other"}},
            },
            r"machines.boiler.held: 'oveTSetSup' is a point of machines.other as well",
        ),
        (
            HOUSE,
            {"actuators": {"Ro1_valve": {"zone": "Ro4"}}},
            r"actuators.Ro1_valve.zone: there is no zone 'Ro4'.*[^)]$",
        ),
        (
            OFFICE,
            {"actuators": {"sou_box": {"heat": {"flo": "x"}}}},
            r"file:\n  actuators.sou_box.heat.flo: unknown key",
        ),
        (OFFICE, {"actuators": {"sou_box": {"heat": {"least_flow": 0.0}}}}, "before and least_flow go together"),
    ],
    ids=["idle", "twice", "ignored", "machines", "zone", "typing", "air"],
)
def test_what_does_not_fit_is_refused_by_key(name, change, message):
    with pytest.raises(ConfigError, match=message):
        validate(TestCase, merge(read_yaml(find_config("testcases", name)), change), "file")
