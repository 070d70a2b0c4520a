"""When to charge a tank: before dear hours, within its comfort and holds, beside rooms that share its machine."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner
from home_by_setpoint import START, price
from home_with_tank import BAND_K, DRAWN_K, MAP, POWER_W, RISE_K_H, TARGET_C, HomeWithTank
from simple_house import simple_model

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.cli import cli
from thermoforce_mpc.commands.tank import TankCharge, TankTarget
from thermoforce_mpc.data import HOUR_S, Observation
from thermoforce_mpc.measurements.forecast import read_forecast
from thermoforce_mpc.measurements.load import learned_tank, read_measurements


@pytest.fixture(scope="module")
def home():
    return HomeWithTank()


@pytest.fixture(scope="module")
def rows(home):
    return home.measurements()


@pytest.fixture(scope="module")
def measured(rows):
    return read_measurements(rows, MAP, step_s=HOUR_S).served()


def planned(home, measured, tank=None, T_tank_C=44.5, prices=None, colder_K=0.0, of_ahead=None, **options):
    off = {"enabled": False}
    base = {"step_s": HOUR_S, "horizon_h": 24.0, "free_response": {"name": "persistence"}, "gate": off, "watch": off}
    mpc = ThermoForceMPC(
        simple_model(), MPCConfig.model_validate(base | options), hot_water=tank or learned_tank(measured)
    )
    ahead = read_forecast(home.forecast(), measured)
    ahead = ahead if prices is None else ahead.at_prices(np.atleast_2d(prices))
    ahead = replace(ahead, T_out_C=ahead.T_out_C - colder_K)
    ahead = replace(ahead, **(of_ahead or {}))
    return mpc.plan(Observation(measured.record, ahead, T_tank_C))


def test_the_record_tells_what_the_tank_is(measured):
    tank = learned_tank(measured)
    assert tank.band_K == pytest.approx(BAND_K, abs=0.8)
    assert tank.rise_K_h == pytest.approx(RISE_K_H, rel=0.15)
    assert tank.energy[0] == pytest.approx(POWER_W / RISE_K_H, rel=0.2)
    assert tank.draws_K.sum(axis=1).mean() == pytest.approx(sum(DRAWN_K.values()), rel=0.15)


@pytest.mark.slow
def test_it_is_charged_outside_dear_hours_and_never_colder_than_is_wanted(home, measured):
    plan = planned(home, measured).hot_water
    dear = np.array([price(START + pd.Timedelta(hours=k)) for k in range(24)]) > 0.3
    assert plan.share[~dear].sum() > 0.5
    assert plan.share[dear].sum() < 0.1 * plan.share.sum()
    assert plan.cost < 0.85 * plan.cost_alone
    assert plan.below_Kh <= 0.05
    assert (plan.low_C >= plan.lower_C - 0.1).all()


@pytest.mark.slow
def test_commands_are_of_the_map_and_keep_their_hold(home, measured):
    told = np.array(planned(home, measured).hot_water.command)
    assert ((told >= 35.0) & (told <= 56.0)).all()
    np.testing.assert_allclose(told, np.round(told))
    tank = learned_tank(measured)
    held = replace(tank, command=tank.command.model_copy(update={"hold_min": 180.0}))
    told = planned(home, measured, held).hot_water.command
    changes = [k for k, (one, next_) in enumerate(pairwise(told), 1) if one != next_]
    assert changes
    assert all(later - first >= 3 for first, later in pairwise(changes))


def test_what_is_set_now_is_held_in_the_next_plan_too(home, measured):
    tank = learned_tank(measured)
    held = replace(tank, command=tank.command.model_copy(update={"hold_min": 720.0}))
    off = {"enabled": False}
    base = {"step_s": HOUR_S, "horizon_h": 24.0, "free_response": {"name": "persistence"}, "gate": off, "watch": off}
    mpc = ThermoForceMPC(simple_model(), MPCConfig.model_validate(base), hot_water=held)
    ahead = read_forecast(home.forecast(), measured)
    first = mpc.plan(Observation(measured.record, ahead, 44.5))
    (value, since_s) = first.state.tank
    assert value == first.hot_water.command[0]
    colder = mpc.plan(Observation(measured.record, ahead, 38.0), replace(first.state, tank=(41.0, since_s - HOUR_S)))
    assert set(colder.hot_water.command[:11]) == {41.0}


def test_a_switch_charges_to_the_devices_own_target(home, measured):
    tank = replace(learned_tank(measured), command=TankCharge(kind="tank_charge", column="boost"))
    plan = planned(home, measured, tank).hot_water
    assert set(plan.command) == {0.0, 1.0}
    assert plan.T_C.max() <= TARGET_C + 0.5
    assert plan.cost < plan.cost_alone


def test_without_a_command_the_rooms_count_on_the_charges_of_the_device(home, measured):
    tank = replace(learned_tank(measured), command=None)
    plan = planned(home, measured, tank, T_tank_C=42.0)
    assert set(plan.hot_water.command) == {None}
    assert plan.hot_water.share[0] > 0.3
    assert plan.hot_water.cost == plan.hot_water.cost_alone


def test_rooms_get_nothing_while_the_tank_is_charged(home, measured):
    """A tank that is charged all the time leaves a house that needs heat without it."""
    slow = replace(learned_tank(measured), command=None, rise=np.array([0.3, 0.0]))
    beside = planned(home, measured, slow, T_tank_C=30.0)
    alone = planned(home, measured, replace(slow, usual_C=np.full(24, 0.0)), T_tank_C=30.0)
    assert beside.hot_water.share.min() > 0.9
    assert alone.hot_water.share.max() == 0.0
    assert alone.u[0].max() > 0.3
    assert beside.T_zone_C[0, -1] < alone.T_zone_C[0, -1] - 2.0


def test_a_tank_whose_temperature_is_not_known_is_left_to_the_device(home, measured):
    plan = planned(home, measured, T_tank_C=float("nan"))
    assert plan.hot_water is None
    assert "its temperature is not known" in plan.why
    assert plan.u.size


def test_the_tank_is_charged_when_the_rooms_can_do_without_the_machine(home, measured, monkeypatch):
    """In the cheapest hours a house in the cold needs all of it: what it would lack counts in when to charge."""
    prices = 0.25 + 0.12 * np.sin(np.arange(49) * 0.9)
    tank = replace(learned_tank(measured), rise=np.array([7.0, 0.0]))

    both = planned(home, measured, tank, 43.0, prices, colder_K=12.0)
    monkeypatch.setattr("controllers.mpc.controller.PRICE_SHARES", (0.0,))
    alone = planned(home, measured, tank, 43.0, prices, colder_K=12.0)
    assert both.hot_water.below_Kh <= alone.hot_water.below_Kh + 0.1
    # Both are above the same bound: the cheapest tank, and rooms with the whole machine.
    assert both.hot_water.gap < 0.5 * alone.hot_water.gap


def test_it_is_charged_with_what_would_be_fed_in_for_little(home, measured):
    """The sun of noon and after, at one price all day, in a house that may be cold."""
    hour = np.arange(49) % 24
    sunny = (hour >= 12) & (hour < 16)
    plan = planned(
        home,
        measured,
        prices=np.full(49, 0.3),
        objective={"at_the_meter": True},
        of_ahead={
            "others_W": np.where(sunny, -6000.0, 400.0),
            "export_per_kWh": np.full(49, 0.05),
            "lower_C": np.full((1, 49), 12.0),
        },
    ).hot_water
    assert plan.share[12:16].sum() > 0.4 * plan.share.sum()
    assert plan.cost < 0.8 * plan.cost_alone


@pytest.mark.slow
def test_plan_says_prints_and_writes_what_to_set_at_the_tank(home, rows, tmp_path):
    simple_model().save(tmp_path / "model")
    rows.to_csv(tmp_path / "recent.csv", index=False)
    home.forecast().to_csv(tmp_path / "ahead.csv")
    (tmp_path / "map.yaml").write_text(json.dumps(MAP))
    files = [f"{tmp_path}/{name}" for name in ("model", "recent.csv", "map.yaml", "ahead.csv", "told.json", "plan.csv")]
    options = [
        x
        for pair in zip(("--model", "--data", "--map", "--forecast", "--commands", "--out"), files, strict=True)
        for x in pair
    ]
    settings = ["--hours", "24", "--set", "gate.enabled=false", "--set", "free_response.name=persistence"]
    done = CliRunner().invoke(cli, ["plan", *options, *settings])
    assert done.exit_code == 0, done.output
    text = " ".join(done.output.split())
    assert "charges in 21 days" in text
    assert "with the tank left to the device" in text
    told = json.loads((tmp_path / "told.json").read_text())["commands"]
    assert {one["actuator"] for one in told} == {"hot_water"}
    assert all(35 <= one["value"] <= 56 and one["unit"] == "°C" for one in told)
    table = pd.read_csv(tmp_path / "plan.csv")
    assert {"T_tank_C", "T_tank_low_C", "tank_power_W", "tank_share"} <= set(table.columns)
    rows.assign(tank=20.0).to_csv(tmp_path / "recent.csv", index=False)
    done = CliRunner().invoke(cli, ["plan", *[x for x in options if x not in ("--commands", files[4])], *settings])
    assert done.exit_code == 0, done.output
    assert "left to the device" in done.output
    assert TankTarget(kind="tank_target", column="x").in_words(50.0) == "tank target 50 °C"


@pytest.mark.slow
def test_the_tank_of_the_page_is_planned(home, rows):
    page = (Path(__file__).parents[3] / "docs/how-to/hot-water.md").read_text()
    (text,) = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    table = rows.rename(columns={"tank": "tank_temperature", "target": "tank_setpoint"})
    of_page = read_measurements(table, MAP | yaml.safe_load(text), step_s=HOUR_S).served()
    plan = planned(home, of_page).hot_water
    assert plan.cost < plan.cost_alone
    assert max(plan.command) <= 56.0
