"""A tank of hot water under control: its target is set beside the levels, within its map, and given back at the end."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import pandas as pd
import pytest
from click.testing import CliRunner
from home_by_setpoint import price
from home_with_tank import MAP, TANK, HomeWithTank
from simple_house import simple_model

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.live.control import in_words
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.live import KeptState, LiveBuilding, People, control
from thermoforce_mpc.live.building import real_run
from thermoforce_mpc.live.shared import shared_with
from thermoforce_mpc.measurements.load import learned_tank, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.records.live_journal import LiveJournal
from thermoforce_mpc.records.people import SHOWN
from thermoforce_mpc.report.live_view import LiveRun

_OFF = {"enabled": False}
_OPTIONS = {"step_s": HOUR_S, "horizon_h": 12.0, "free_response": {"name": "persistence"}, "gate": _OFF, "watch": _OFF}


def lived(hours: int, home: HomeWithTank, rules: dict = MAP):
    """`hours` of a home under control; its rows meanwhile."""
    first, measured = len(home.rows), read_measurements(home.measurements(), rules, step_s=HOUR_S).served()
    mpc = ThermoForceMPC(simple_model(), MPCConfig.model_validate(_OPTIONS), hot_water=learned_tank(measured))
    building = LiveBuilding(home, MeasurementMap.model_validate(rules), HOUR_S)
    control(building, mpc, clock=home, steps=hours, delay_s=0.0)
    return home.rows[first:]


def wanted_C(at: pd.Timestamp) -> float:
    return 42.0 if 6 <= at.hour < 9 else 40.0 if 17 <= at.hour < 22 else 36.0


def tank_cost(rows) -> float:
    """What charging cost: only then is the power that of the tank."""
    return sum(price(row["time"]) * 1.5 / 12.0 for row in rows if row["P"] == 1500.0 and row["u"] == 0.0)


@pytest.mark.slow
def test_the_tank_is_charged_more_cheaply_stays_warm_and_is_given_back():
    home, alone = HomeWithTank(), HomeWithTank()
    rows = lived(24, home)
    begin = len(alone.rows)
    alone.wait_until(home.at)
    assert tank_cost(rows) < 0.85 * tank_cost(alone.rows[begin:])
    cold = [wanted_C(row["time"]) - row["tank"] for row in rows]
    assert max(cold) < 1.0
    told = [(at, levels["hot_water"]) for at, levels in home.written]
    assert all(value is None or 35.0 <= value <= 56.0 for _, value in told)
    assert told[-1][1] is None
    changed = [at for (_, one), (at, other) in pairwise(told[:-1]) if one != other]
    assert changed
    assert all(later - at >= pd.Timedelta(minutes=30) for at, later in pairwise(changed))


def test_without_a_command_nothing_is_set_at_the_tank():
    home = HomeWithTank()
    lived(3, home, MAP | {"hot_water": {name: TANK[name] for name in ("temperature", "comfort")}})
    assert all(set(levels) == {"actuator"} for _, levels in home.written)


class _Silent(HomeWithTank):
    """Its tank's sensor says nothing after the second decision."""

    def measurements(self) -> pd.DataFrame:
        rows = super().measurements()
        if len(self.written) >= 2:
            rows.loc[rows["time"] > self.written[1][0], "tank"] = float("nan")
        return rows


@pytest.mark.slow
def test_a_tank_that_says_nothing_any_more_is_given_back():
    home = _Silent()
    lived(5, home)
    values = [levels["hot_water"] for _, levels in home.written]
    assert values[0] is not None
    assert values[-2] is None


@pytest.mark.slow
def test_explain_watch_and_page_tell_of_the_tank(tmp_path):
    home = HomeWithTank()
    tank, rules = learned_tank(read_measurements(home.measurements(), MAP, step_s=HOUR_S).served()), tmp_path / "m.yaml"
    mpc = ThermoForceMPC(simple_model(), MPCConfig.model_validate(_OPTIONS), hot_water=tank)
    mapped = MeasurementMap.model_validate(MAP)
    simple_model().save(tmp_path / "given")
    journal = LiveJournal(tmp_path, real_run(tmp_path, tmp_path / "given", rules, mapped, mpc.config, "x"))
    told = []
    shown = shared_with(
        home, People(tmp_path / "people.json", None), told.append, in_words, tmp_path, tank=tank.command
    )
    building = LiveBuilding(home, mapped, HOUR_S)
    control(building, mpc, clock=home, steps=3, delay_s=0.0, journal=journal, told=shown)
    planned, came_C = told[-1].plan.hot_water, [one.plan.hot_water.T_now_C for one in told]

    now = LiveRun(tmp_path).now()
    assert [point.T_C for point in now.hot_water.past] == pytest.approx(came_C)
    assert now.hot_water.told == planned.command[0]
    assert [point.T_C for point in now.hot_water.plan] == pytest.approx(planned.T_C, abs=0.01)
    assert f"{came_C[-1]:.1f} °C now" in now.hot_water.said
    rows = json.loads((tmp_path / SHOWN).read_text())["plan"]["commands"]
    assert {"hot_water"} == {row["actuator"] for row in rows}

    said = CliRunner().invoke(cli, ["explain", str(tmp_path), "--json", str(tmp_path / "step.json")])
    assert said.exit_code == 0, said.output
    assert f"tank: set to {planned.command[0]:g}. Hot water: {came_C[-1]:.1f} °C now" in said.output
    assert json.loads((tmp_path / "step.json").read_text())["hot_water"]["cost"] == pytest.approx(
        planned.cost, abs=1e-4
    )
    assert "tank: set to" in CliRunner().invoke(cli, ["watch", str(tmp_path), "--once"]).output


@pytest.mark.slow
def test_what_is_set_at_the_tank_is_known_after_a_restart(tmp_path):
    """It is held for its least time also by a controller that was started again."""
    home = HomeWithTank()
    tank = learned_tank(read_measurements(home.measurements(), MAP, step_s=HOUR_S).served())
    held = replace(tank, command=tank.command.model_copy(update={"hold_min": 360.0}))
    for _ in range(3):
        mpc = ThermoForceMPC(simple_model(), MPCConfig.model_validate(_OPTIONS), hot_water=held)
        building = LiveBuilding(home, MeasurementMap.model_validate(MAP), HOUR_S)
        control(building, mpc, clock=home, steps=2, delay_s=0.0, kept=KeptState(tmp_path / "state.npz", "one"))
    kept = KeptState(tmp_path / "state.npz", "one").load(home.at)
    value, since_s = kept.after.tank
    told = [levels["hot_water"] for _, levels in home.written]
    assert set(told) - {None} == {value}
    assert pd.Timestamp(kept.origin) + pd.Timedelta(seconds=since_s) == home.written[0][0]
