"""What a plan in levels saves: against a house whose thermostats the record shows, lived both ways."""

from __future__ import annotations

import copy
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner
from home_by_setpoint import RULES, START, HomeBySetpoint
from simple_house import GAIN_K, POLE, outdoor_C, simple_model
from two_houses import TWO, two_model

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.cli import cli
from thermoforce_mpc.commands.loop import USUAL_COMMANDS, saving_in_words
from thermoforce_mpc.data import HOUR_S, HotWaterPlan, Observation
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.experiment.left_alone import LEFT_ALONE, saving_of_levels
from thermoforce_mpc.measurements.forecast import read_forecast
from thermoforce_mpc.measurements.load import read_measurements
from thermoforce_mpc.model.card import JUDGED_H, Competence, HorizonScore

LEVELS = RULES | {"actuators": {"actuator": {"level": "u"}}}
W_PER_U = 4300.0


def price(at):
    """A little dearer in the morning and in the evening."""
    return 0.25 if at.hour in (7, 8, 17, 18, 19, 20) else 0.20


@pytest.fixture(scope="module")
def home():
    return HomeBySetpoint(days=14)


@pytest.fixture(scope="module")
def measured(home):
    return read_measurements(home.measurements(), LEVELS, step_s=HOUR_S).served()


@pytest.fixture(scope="module")
def model():
    exact, steady = simple_model(), GAIN_K / (1.0 - POLE)
    known = {f"step_response_{h}h_K": steady * (1.0 - POLE**h) for h in (1, 2, 4, 8, 12, 24, 48)}
    known |= {f"step_response_{h}h_sd_K": 0.1 * steady * (1.0 - POLE**h) for h in (1, 2, 4, 8, 12, 24, 48)}
    scores = tuple(HorizonScore(float(h), 0.1, 2.0, 2.0, 9.0, 9) for h in JUDGED_H)
    verdict = Competence(True, horizons=scores, effect_K=known["step_response_8h_K"], effect_sd_K=0.2)
    return replace(exact, cards=(replace(exact.cards[0], uncertainty=known, competence=verdict),))


@pytest.fixture(scope="module")
def planned(home, measured, model):
    """What is ahead, and the plan."""
    off = {"enabled": False}
    options = {"step_s": HOUR_S, "horizon_h": 24.0, "free_response": {"name": "persistence"}, "gate": off, "watch": off}
    table = home.forecast()
    ahead = read_forecast(table.assign(price=[price(at) for at in table.index]), measured).head(24)
    return ahead, ThermoForceMPC(model, MPCConfig.model_validate(options)).plan(Observation(measured.record, ahead))


def lived(home, levels, days=8):
    """What the home costs until a week later: at `levels` in the first of them, or by its own thermostat."""
    own, n = HomeBySetpoint(days=14), len(home.rows)
    if levels is None:
        own.wait_until(START + pd.Timedelta(days=days))
        return sum(price(row["time"]) * row["P"] for row in own.rows[n:]) / 12000.0
    cost = sum(price(START + pd.Timedelta(hours=k)) * W_PER_U * u / 1000.0 for k, u in enumerate(levels))
    out = outdoor_C((START - pd.Timestamp("2025-01-01", tz="UTC")).total_seconds() + HOUR_S * np.arange(len(levels)))
    for k, u in enumerate(levels):
        own.T = POLE * own.T + (1.0 - POLE) * out[k] + GAIN_K * u
    own.at = START + pd.Timedelta(hours=len(levels))
    own.wait_until(START + pd.Timedelta(days=days))
    return cost + sum(price(row["time"]) * row["P"] for row in own.rows[n:]) / 12000.0


def test_the_saving_of_levels_is_that_of_the_house_lived_both_ways(home, measured, model, planned):
    ahead, plan = planned
    saving = saving_of_levels(model, measured.record, ahead, plan)
    true = lived(home, None) - lived(home, plan.u[0])
    assert saving.low < true < saving.high
    assert saving.saved == pytest.approx(true, abs=0.1 * saving.cost_alone)
    assert saving.high - saving.low < 0.5 * saving.cost_alone
    alone = lived(home, None, days=1)
    assert saving.cost_alone == pytest.approx(alone, rel=0.1)
    dearer = replace(plan, u=np.clip(plan.u + 0.2, 0.0, 1.0))
    assert saving_of_levels(model, measured.record, ahead, dearer).saved < saving.saved - 0.3
    words = saving_in_words(replace(saving, gain=-1.0), f"with {LEFT_ALONE}")
    assert words.endswith(
        "By the same model with rooms kept as warm as they were at these hours while their heat acted."
    )
    assert "Not set" not in words


def test_days_are_seen_in_a_record_that_ends_at_any_minute(measured, model, planned):
    """Steps of an hour end when the record does, so that none of them may begin at midnight."""
    ahead, plan = planned
    later = [replace(one, time_s=one.time_s + 55.0 * 60.0) for one in (measured.record, ahead)]
    saving, of_later = (saving_of_levels(model, *both, plan) for both in ((measured.record, ahead), later))
    assert of_later.saved == pytest.approx(saving.saved, abs=0.02 * saving.cost_alone)


def test_what_a_tank_takes_of_the_machine_the_rooms_do_not_get(measured, model, planned):
    ahead, plan = planned
    share = np.where(np.arange(24) % 6 == 0, 0.5, 0.0)
    hours = {name: np.zeros(24) for name in ("T_C", "low_C", "lower_C", "power_W")}
    tank = HotWaterPlan(command=(None,) * 24, share=share, cost=1.0, cost_alone=2.0, below_Kh=0.0, below_alone_Kh=0.0,
                        **hours)  # fmt: skip
    levels = 0.5 * plan.u + 0.2
    of_rooms = saving_of_levels(
        model, measured.record, ahead, replace(plan, u=levels, hot_water=tank), tank_machine=model.names.machines[0]
    )
    assert of_rooms == saving_of_levels(model, measured.record, ahead, replace(plan, u=levels * (1.0 - share)))
    assert of_rooms != saving_of_levels(model, measured.record, ahead, replace(plan, u=levels))


def test_a_record_that_shows_no_habit_tells_no_saving(measured, model, planned):
    ahead, plan = planned
    rng = np.random.default_rng(5)
    r = measured.record
    u = np.repeat(rng.uniform(0.0, 1.0, (1, r.n_steps // 12)), 12, axis=1)
    T = np.full((1, r.n_steps + 1), 20.0)
    for k in range(r.n_steps):
        T[0, k + 1] = POLE * T[0, k] + (1.0 - POLE) * r.T_out_C[k] + GAIN_K * u[0, k]
    by_chance = replace(r, T_zone_C=T, u=u, power_W=W_PER_U * u)
    with pytest.raises(DataError, match=r"how the building is left alone is no habit: .* single days differ by"):
        saving_of_levels(model, by_chance, ahead, plan)
    with pytest.raises(DataError, match="the record has 3 whole days, and 7 tell"):
        saving_of_levels(model, r.last(80), ahead, plan)
    with pytest.raises(DataError, match="no heat acted"):
        saving_of_levels(model, replace(r, u=0.0 * r.u), ahead, plan)


def test_what_the_model_does_not_tell_is_said(measured, model, planned):
    ahead, plan = planned
    unsure = replace(model, cards=(replace(model.cards[0], uncertainty={}),))
    with pytest.raises(DataError, match="the model does not say how well it knows"):
        saving_of_levels(unsure, measured.record, ahead, plan)
    with pytest.raises(DataError, match="not all actuators follow the plan"):
        saving_of_levels(model, measured.record, ahead, replace(plan, u=np.empty((1, 0))))


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Two such homes as rooms of one house, of which one takes set-points and the other levels: its files by name."""
    place, homes = tmp_path_factory.mktemp("two"), {"bath": HomeBySetpoint(days=14), "hall": HomeBySetpoint(days=14)}
    both = [home.measurements().set_index("time") for home in homes.values()]
    own = ("T", "u", "set", "P")
    table = both[0].drop(columns=list(own))
    for name, one in zip(homes, both, strict=True):
        table = table.join(one[list(own)].add_suffix(f"_{name}"))
    ahead = homes["bath"].forecast().head(25)
    ahead["price"] = [price(at) for at in ahead.index]
    rooms = {name: RULES["zones"]["zone"] | {"temperature": f"T_{name}"} for name in homes}
    act = {
        name: {"zone": zone, "machine": machine, "level": f"u_{zone}"}
        for name, zone, machine in zip(TWO.actuators, TWO.zones, TWO.machines, strict=True)
    }
    act["radiator"]["command"] = {"kind": "setpoint", "column": "set_bath"}
    machines = {m: {"power": f"P_{z}", "price": "price"} for m, z in zip(TWO.machines, TWO.zones, strict=True)}
    files = {"data": place / "data.csv", "forecast": place / "ahead.csv", "map": place / "map.yaml"}
    table.drop(columns=["set_hall"]).to_csv(files["data"])
    ahead.to_csv(files["forecast"])
    files["map"].write_text(
        yaml.safe_dump(RULES | {"zones": rooms, "actuators": act, "machines": machines}, sort_keys=False)
    )
    return homes["bath"], files, place


def planned_by(two, model):
    """What `tf-mpc plan` says and writes."""
    _, files, place = two
    model.save(place / "model", overwrite=True)
    call = ["plan", "--model", place / "model", "--out", place / "plan.json", "--commands", place / "set.json"]
    call += [part for name, file in files.items() for part in (f"--{name}", file)]
    for one in ("free_response.name=persistence", "gate.enabled=false", "watch.enabled=false"):
        call += ["--set", one]
    found = CliRunner().invoke(cli, list(map(str, call)))
    assert found.exit_code == 0, found.output
    return " ".join(found.output.split()), json.loads((place / "plan.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def of_two(model):
    """The model of both rooms, with what it says of its errors."""
    return replace(two_model(), cards=model.cards * 2)


def test_what_a_plan_in_commands_and_levels_saves_is_that_of_the_house_lived_both_ways(two, of_two):
    home, _, place = two
    said, told = planned_by(two, of_two)
    saving = told["saving"]
    by_commands, alone = copy.deepcopy(home), lived(home, None)
    for one in told["commands"]:
        by_commands.told = one["value"]
        by_commands.wait_until(pd.Timestamp(one["until"]))
    by_commands.told = None
    by_commands.wait_until(START + pd.Timedelta(days=8))
    of_commands = sum(price(row["time"]) * row["P"] for row in by_commands.rows[len(home.rows) :]) / 12000.0
    of_levels = lived(home, [row["u[floor]"] for row in told["rows"]])
    true = 2.0 * alone - of_commands - of_levels
    assert saving["low"] < true < saving["high"]
    assert saving["saved"] == pytest.approx(true, abs=0.1 * saving["cost_alone"])
    assert saving["cost_alone"] == pytest.approx(2.0 * lived(home, None, days=1), rel=0.15)
    assert f"{saving['saved']:.2f} (90 % band {saving['low']:.2f} to {saving['high']:.2f}): cost" in said
    assert f"By the same model {USUAL_COMMANDS}, and with {LEFT_ALONE}." in said
    assert json.loads((place / "set.json").read_text(encoding="utf-8"))["saving"] == saving


def test_where_levels_tell_no_saving_that_of_the_commands_is_called_so(two, of_two):
    unsure = replace(of_two, cards=(of_two.cards[0], replace(of_two.cards[1], uncertainty={})))
    said, told = planned_by(two, unsure)
    assert told["saving"] is None
    assert "Of its commands alone: " in told["no_saving"]
    assert "What the plan saves is not told: the model does not say how well it knows" in said
