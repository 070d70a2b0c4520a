"""A controller at a real building: it heats by what the tables say, and whatever fails gives the building back."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from importlib.machinery import ExtensionFileLoader
from itertools import groupby, pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner
from places import ROOT
from simulated_building import RULES, START, SimulatedBuilding, files_of_now, mpc
from waiting import LONG_S, wait_for

from controllers.rules.thermostat import Thermostat, ThermostatConfig
from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.live.control import in_words
from thermoforce_mpc.connections.sole import set_by, sole_control
from thermoforce_mpc.data import Block, Layout, Plan, PlanStatus
from thermoforce_mpc.errors import ConfigError, PlantError, Terminated, terminated_by
from thermoforce_mpc.live import Decision, KeptState, LiveBuilding, WallClock, control
from thermoforce_mpc.live.building import Kept
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.report.display import RunDisplay

HOUR = pd.Timedelta("1h")
START_S = (START - pd.Timestamp("2025-01-01", tz="UTC")).total_seconds()


def controlled(house, steps, rules=RULES, **settings):
    told = []
    building = LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0)
    control(building, mpc(), clock=house, steps=steps, told=told.append, **settings)
    return told


@pytest.mark.slow
def test_the_building_is_kept_warm_and_given_back():
    house = SimulatedBuilding()
    told = controlled(house, 48)
    assert [decision.plan.status for decision in told] == ["solved"] * 48
    assert [decision.instant for decision in told] == list(pd.date_range(START, periods=48, freq="1h"))
    T = np.array([row["T"] for row in house.rows[house.begun :]])
    assert T.min() > 19.5
    assert T.max() < 24.0
    _, levels, seconds = house.written[-1]
    assert levels == {"actuator": None}
    assert seconds == 0.0
    for _, levels, seconds in house.written[:-1]:
        assert 0.0 <= levels["actuator"] <= 1.0
        assert 0.0 < seconds <= 3600.0 + 120.0


def when(what, first_h, last_h, error):
    """Raise `error` when asked for `what` between two hours of the run."""

    def failing(asked, now):
        if asked == what and first_h * HOUR <= now - START < last_h * HOUR:
            raise error

    return failing


def test_readings_that_cannot_be_had_give_the_building_back_until_there_are_some(caplog):
    house = SimulatedBuilding(when("measurements", 3, 6, OSError("gateway is down")))
    told = controlled(house, 10)
    assert [decision.plan.status for decision in told] == ["solved"] * 3 + ["native"] * 3 + ["solved"] * 4
    assert "gateway is down" in told[3].plan.why
    assert [levels["actuator"] for at, levels, _ in house.written if 3 * HOUR <= at - START < 6 * HOUR] == [None] * 3
    assert "no decision" in caplog.text


def test_a_step_without_a_decision_names_every_actuator():
    """With one of two names or with none of them nobody could say what `advise` advises."""
    house = SimulatedBuilding(when("measurements", 1, 2, OSError("gateway is down")))
    house.write = lambda levels, seconds: None
    rules = RULES | {"actuators": {"north": {"level": "u"}, "south": {"level": "u"}}}
    told = []
    thermostat = Thermostat(ThermostatConfig(step_s=3600.0), MeasurementMap.model_validate(rules).layout)
    building = LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0)
    control(building, thermostat, clock=house, steps=3, told=told.append)
    assert [decision.plan.status for decision in told] == ["rule", "native", "rule"]
    assert "north own control for 60 min; south own control for 60 min" in in_words(told[1])


def test_a_block_that_begins_within_a_step_is_told_in_tenths_of_a_minute():
    blocks = (Block(0.5, 336.7986), Block(1.0, 563.2014))
    plan = Plan(blocks, PlanStatus.SOLVED, "cheap", names=Layout.single().names)
    assert "50 % for 5.6 min" in in_words(Decision(START, plan, blocks))


def test_the_last_forecast_stands_in_for_one_that_is_missing():
    house = SimulatedBuilding(when("forecast", 3, 5, TimeoutError("weather service")))
    told = controlled(house, 7)
    assert [decision.plan.status for decision in told] == ["solved"] * 3 + ["bridged"] * 2 + ["solved"] * 2
    assert any("weather service" in note or "no forecast" in note for note in told[3].notes)
    assert not told[6].notes


def test_levels_that_are_not_taken_are_set_again_in_the_next_step(caplog):
    house = SimulatedBuilding(when("write", 1, 3, ConnectionError("bus")))
    controlled(house, 5)
    assert "were not taken (ConnectionError: bus)" in caplog.text
    assert next(at - START for at, _, _ in house.written if at - START >= 1 * HOUR) >= 3 * HOUR
    assert house.level is None


def test_after_levels_that_were_not_taken_the_controller_keeps_what_readings_taught_and_follows_no_plan():
    house, states = SimulatedBuilding(when("write", 1, 3, ConnectionError("bus"))), []
    controller = mpc()
    plan = controller.plan

    def seen(observation, state=None):
        states.append(state and ((state.last_s - START_S) / 3600.0, state.good is None, state.actuation[0].native))
        return plan(observation, state)

    controller.plan = seen
    building = LiveBuilding(house, MeasurementMap.model_validate(RULES), 3600.0)
    control(building, controller, clock=house, steps=5)
    assert states == [None, (0.0, False, False), (1.0, True, True), (2.0, True, True), (3.0, False, False)]


def test_after_a_refused_plan_the_controller_keeps_what_readings_taught_and_follows_no_plan():
    house, states = SimulatedBuilding(), []
    controller = mpc()
    plan = controller.plan

    def seen(observation, state=None):
        states.append(state and ((state.last_s - START_S) / 3600.0, state.good is None, state.actuation[0].native))
        decided = plan(observation, state)
        return replace(decided, blocks=(Block(1.5, 3600.0),)) if len(states) in (2, 3) else decided

    controller.plan = seen
    building = LiveBuilding(house, MeasurementMap.model_validate(RULES), 3600.0)
    control(building, controller, clock=house, steps=5)
    assert states == [None, (0.0, False, False), (1.0, True, True), (2.0, True, True), (3.0, False, False)]
    assert [levels["actuator"] for _, levels, _ in house.written][1:3] == [None, None]


def test_a_connection_that_does_not_answer_is_not_waited_for(monkeypatch):
    """Levels are given back while a table is still waited for; it is not asked again meanwhile."""
    monkeypatch.setattr("thermoforce_mpc.live.building.ANSWER_S", 0.3)
    house, hangs, asked = SimulatedBuilding(), threading.Event(), []
    live = house.measurements

    def measurements():
        asked.append(None)
        if len(asked) == 3:
            hangs.wait(LONG_S)
        return live()

    house.measurements = measurements
    began = time.monotonic()
    told = controlled(house, 5)
    hangs.set()
    assert time.monotonic() - began < LONG_S
    assert [decision.plan.status for decision in told] == ["solved", "solved", "native", "native", "native"]
    assert "no answer within 0.3 s" in told[2].plan.why
    assert "has not returned" in told[3].plan.why
    assert len(asked) == 3
    assert [levels["actuator"] for _, levels, _ in house.written[2:]] == [None] * 4


def test_a_silent_logger_is_bridged_by_the_model_for_a_while():
    house = SimulatedBuilding()
    live = house.measurements
    house.measurements = lambda: live()[lambda table: table["time"] < START + 2.5 * HOUR]
    told = [decision.plan.status for decision in controlled(house, 20)]
    assert told[:5] == ["solved"] * 3 + ["bridged"] * 2
    assert told[-1] in ("thermostat", "native")


@pytest.mark.slow
def test_a_logger_that_was_silent_for_a_day_says_nothing_of_now():
    house = SimulatedBuilding()
    live = house.measurements
    house.measurements = lambda: live()[lambda table: table["time"] < START]
    told = controlled(house, 27)
    assert told[-1].plan.status == "native"
    assert "does the logger run" in told[-1].plan.why


def test_what_is_wrong_at_the_start_is_raised_and_nothing_is_set():
    house = SimulatedBuilding(when("measurements", 0, 1, OSError("no route to host")))
    with pytest.raises(PlantError, match=r"gives no measurements \(OSError: no route to host\)"):
        controlled(house, 3)
    house = SimulatedBuilding()
    live = house.measurements
    house.measurements = lambda: live().assign(time=lambda table: table["time"].dt.tz_localize(None))
    with pytest.raises(ConfigError, match=r"time\.zone"):
        controlled(house, 3, {**RULES, "time": {}})
    assert not house.written


def test_a_level_holds_until_the_next_decision_is_there():
    """Tables are read and a plan is made in 90 s, and the building is left to itself in none of them."""
    house = SimulatedBuilding()
    live = house.measurements

    def slow():
        table = live()
        house.wait_until(house.at + pd.Timedelta("90s"))
        return table

    house.measurements = slow
    controlled(house, 4)
    for (at, _, seconds), (then, *_) in pairwise(house.written):
        assert at + pd.Timedelta(seconds=seconds) > then


def in_two_blocks(house, steps):
    """Control that heats for a quarter of an hour in each step, and then not."""
    controller = mpc()
    plan = controller.plan
    blocks = (Block(1.0, 900.0), Block(0.0, 2700.0))
    controller.plan = lambda observation, state=None: replace(plan(observation, state), blocks=blocks)
    building = LiveBuilding(house, MeasurementMap.model_validate(RULES), 3600.0)
    control(building, controller, clock=house, steps=steps)


def test_the_level_of_a_later_block_holds_no_longer_than_that_of_the_first():
    house = SimulatedBuilding()
    in_two_blocks(house, 3)
    held = [(levels["actuator"], (at - START).total_seconds(), seconds) for at, levels, seconds in house.written[:-1]]
    assert [(level, at_s % 3600.0) for level, at_s, _ in held] == [(1.0, 30.0), (0.0, 930.0)] * 3
    assert [at_s + seconds - 150.0 for _, at_s, seconds in held] == [3600.0] * 2 + [7200.0] * 2 + [10800.0] * 2


def test_what_is_past_when_a_plan_is_there_is_not_set_any_more():
    house = SimulatedBuilding()
    live = house.measurements

    def slow():
        table = live()
        house.wait_until(house.at + pd.Timedelta("20min"))
        return table

    house.measurements = slow
    in_two_blocks(house, 2)
    assert {levels["actuator"] for _, levels, _ in house.written[:-1]} == {0.0}


BY_SETPOINT = {"kind": "setpoint", "column": "T", "minimum": 18, "maximum": 24}


@pytest.mark.parametrize(
    ("command", "told", "written", "refused"),
    [
        (BY_SETPOINT, 21, 21.0, ""),
        (BY_SETPOINT, np.float32(21.5), 21.5, ""),
        (BY_SETPOINT, None, None, "a level of 0.4 for 'actuator', of which its set-point is set"),
        (BY_SETPOINT, 24.5, None, "24.5 °C for 'actuator', which its command in the map does not allow"),
        (BY_SETPOINT, float("nan"), None, "command of nan"),
        (BY_SETPOINT, [20.0, 24.0], None, "room set-points, which a connection has none of"),
        (None, 21.0, None, "a command of 21 for 'actuator', whose level is set"),
        (None, None, 0.4, ""),
    ],
)
def test_a_level_is_not_written_for_a_command_nor_what_its_map_does_not_allow(command, told, written, refused):
    house, controller = SimulatedBuilding(), mpc()
    plan = controller.plan
    block = Block(0.4, 3600.0, told if isinstance(told, list) else (told,))
    controller.plan = lambda observation, state=None: replace(plan(observation, state), blocks=(block,))
    rules = RULES | {"actuators": {"actuator": {"level": "u", "command": command}}}
    decisions = []
    building = LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0)
    control(building, controller, clock=house, steps=1, told=decisions.append)
    assert house.written[0][1] == {"actuator": written}
    assert refused in decisions[0].refused
    assert bool(refused) == bool(decisions[0].refused)
    assert house.written[-1][1] == {"actuator": None}


@pytest.mark.parametrize("jump", [-5 * HOUR, 5 * HOUR])
def test_nothing_is_set_for_less_than_no_time_or_for_longer_than_a_step(jump):
    """A machine sleeps until the second block of a step is over, or its clock is set back while it waits for it."""
    house = SimulatedBuilding()
    now, wait, off = house.now, house.wait_until, [0 * HOUR]
    house.now = lambda: now() + off[0]

    def waited(at):
        until = at - off[0]
        if not off[0] and until > START + HOUR / 10:
            off[0] = jump
        wait(until)

    house.wait_until = waited
    in_two_blocks(house, 3)
    assert all(0.0 < seconds <= 3600.0 + 120.0 for *_, seconds in house.written[:-1])
    real = [at for at, *_ in house.written]
    assert all((later - at) <= pd.Timedelta(seconds=3600.0 + 120.0) for at, later in pairwise(real))


@pytest.mark.parametrize("error", [TimeoutError("no answer"), KeyboardInterrupt()])
def test_a_level_that_was_set_by_a_call_that_failed_is_given_back(error):
    house = SimulatedBuilding()
    write = house.write

    def late(levels, seconds):
        house.write = write
        write(levels, seconds)
        raise error

    house.write = late
    with suppress(KeyboardInterrupt):
        controlled(house, 1)
    assert len(house.written) == 2
    assert house.level is None


def test_an_interrupted_run_gives_the_building_back():
    house = SimulatedBuilding()
    wait = house.wait_until

    def interrupted(at):
        wait(at)
        if house.at > START + 2 * HOUR:
            raise KeyboardInterrupt

    house.wait_until = interrupted
    with pytest.raises(KeyboardInterrupt) as ended:
        controlled(house, 24)
    assert ended.value.__notes__ == ["given back to the building's own control: actuator"]
    assert house.level is None
    assert house.written[-1][1:] == ({"actuator": None}, 0.0)


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_a_signal_that_a_library_keeps_to_itself_ends_the_run_before_the_next_wait(name):
    """A library that closes its files raises an error of its own in place of what the signal raised."""
    house, controller, sent = SimulatedBuilding(), mpc(), []
    plan, number = controller.plan, signal.Signals[name]
    before = signal.getsignal(number)

    def interrupted(observation, state=None):
        if house.at >= START + 2 * HOUR and not sent:
            sent.append(house.at)
            try:
                signal.raise_signal(number)
            except BaseException as error:
                raise ValueError("cannot close the file") from error
        return plan(observation, state)

    controller.plan = interrupted
    building = LiveBuilding(house, MeasurementMap.model_validate(RULES), 3600.0)
    with terminated_by(name):
        with pytest.raises(KeyboardInterrupt if name == "SIGINT" else Terminated):
            control(building, controller, clock=house, steps=24)
        assert (signal.getsignal(number) is signal.SIG_IGN) == (name == "SIGTERM")
    assert signal.getsignal(number) is before
    assert sent == [house.at]
    assert house.level is None
    assert house.written[-1][1:] == ({"actuator": None}, 0.0)


@pytest.mark.parametrize(("name", "raised"), [("SIGTERM", Terminated), ("SIGINT", KeyboardInterrupt)])
def test_a_signal_waits_until_a_compiled_module_is_loaded(monkeypatch, name, raised):
    """pybind11's modules are cut short else: some crash, others are no more importable."""
    loaded = []

    def load(module):
        signal.raise_signal(signal.Signals[name])
        loaded.append(module)

    def imports():
        ExtensionFileLoader("compiled", "compiled.so").exec_module(ModuleType("compiled"))
        time.sleep(LONG_S)

    monkeypatch.setattr("_imp.exec_dynamic", load)
    with terminated_by(name), pytest.raises(raised):
        imports()
    assert loaded


@pytest.mark.parametrize("steps", [2, 24])
def test_an_interrupt_while_the_building_is_given_back_cuts_nothing_short(steps):
    """Ctrl-C at the end of a run, and Ctrl-C twice."""
    house = SimulatedBuilding()
    wait, write, cut = house.wait_until, house.write, []

    def interrupted(at):
        wait(at)
        if steps > 2 and house.at > START + 2 * HOUR:
            raise KeyboardInterrupt

    def impatient(levels, seconds):
        if seconds == 0.0 and len(cut) < 3:
            cut.append(house.at)
            raise KeyboardInterrupt
        write(levels, seconds)

    house.wait_until, house.write = interrupted, impatient
    with pytest.raises(KeyboardInterrupt) as ended:
        controlled(house, steps)
    assert ended.value.__notes__ == ["given back to the building's own control: actuator"]
    assert len(cut) == 3
    assert house.written[-1][1:] == ({"actuator": None}, 0.0)


def test_a_building_that_does_not_take_its_levels_back_is_told_of():
    house = SimulatedBuilding(when("write", 2, 99, OSError("bus")))
    with pytest.raises(PlantError, match="actuator in 5 attempts"):
        controlled(house, 3)


def test_a_dry_run_sets_nothing():
    house = SimulatedBuilding()
    (decision,) = controlled(house, 1, dry=True)
    assert decision.plan.status == "solved"
    assert not house.written


def test_over_the_new_year_time_goes_on():
    """A table of the last days begins in the old year, then in the new one; the clock of the plans does not jump."""
    house = SimulatedBuilding()
    shift = pd.Timestamp("2024-12-31 20:00", tz="UTC") - START
    live, ahead, now, wait = house.measurements, house.forecast, house.now, house.wait_until
    house.now = lambda: now() + shift
    house.wait_until = lambda at: wait(at - shift)
    house.measurements = lambda: (
        live()
        .assign(time=lambda t: t["time"] + shift)
        .tail(1200 if house.now() < pd.Timestamp("2025-01-01 06:00", tz="UTC") else 300)
    )
    house.forecast = lambda: ahead().shift(freq=shift)
    told = controlled(house, 12)
    assert {decision.plan.status for decision in told} == {"solved"}


def test_a_clock_that_is_set_back_stops_no_control(caplog):
    """It was five hours ahead; the house, its logger and its watchdog have clocks of their own."""
    house = SimulatedBuilding()
    now, wait, ahead = house.now, house.wait_until, [5 * HOUR]
    house.now = lambda: now() + ahead[0]

    def waited(at):
        until = at - ahead[0]
        if ahead[0] and until > START + 2.5 * HOUR:
            ahead[0] = 0 * HOUR
        wait(until)

    house.wait_until = waited
    told = controlled(house, 8)
    at_h = [round((decision.instant - START) / HOUR) for decision in told]
    assert at_h == [5, 6, 7, 3, 4, 5, 6, 7]
    assert [decision.plan.status for decision in told[3:]] == ["solved"] * 5
    assert "the clock was set back" in caplog.text


def test_the_clock_of_the_machine_waits_no_longer_where_it_is_set_back(monkeypatch):
    passed_s, set_back_s = [0.0], 3600.0
    monkeypatch.setattr(time, "sleep", lambda seconds: passed_s.__setitem__(0, passed_s[0] + seconds))
    monkeypatch.setattr(time, "monotonic", lambda: passed_s[0])
    clock = WallClock()
    back = lambda: START + pd.Timedelta(seconds=passed_s[0] - set_back_s * (passed_s[0] > 10.0))  # noqa: E731
    monkeypatch.setattr(clock, "now", back)
    clock.wait_until(START + pd.Timedelta("60s"))
    assert passed_s[0] == 60.0


@pytest.fixture
def files(tmp_path, monkeypatch):
    files_of_now(tmp_path)
    other = {**RULES, "zones": {"hall": RULES["zones"]["zone"]}}
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(other))
    monkeypatch.chdir(tmp_path)
    return tmp_path


OPTIONS = [
    "--set", "controller.step_s=3600", "--set", "controller.horizon_h=12",
    "--set", "controller.free_response.name=persistence", "--set", "controller.gate.enabled=false",
]  # fmt: skip


@pytest.mark.parametrize("how", [("--dry-run",), ("--mode", "advise", "--steps", "1", "--delay", "0")])
def test_what_goes_on_until_the_first_plan_is_said_with_what_is_set(files, monkeypatch, how):
    """It said nothing for most of a minute, on a computer that is busy, where programs are still compiled."""
    monkeypatch.setattr("thermoforce_mpc.report.display.SAID_AFTER_S", 0.0)
    monkeypatch.setattr(WallClock, "wait_until", lambda self, at: None)
    record = LiveBuilding.record

    def slowly(*told):
        time.sleep(0.3)
        return record(*told)

    monkeypatch.setattr(LiveBuilding, "record", slowly)
    done = CliRunner().invoke(cli, ["control", "--model", "model", "--map", "map.yaml", *how, *OPTIONS])
    assert done.exit_code == 0, done.output + str(done.exception)
    assert "measurements are read and a plan is made: " in done.output
    assert re.search(r"actuator \d+ % for [\d.]+ min", done.output)
    assert not (files / "levels.json").exists()
    steps = [json.loads(line) for line in (files / "control" / "log.jsonl").read_text().splitlines()]
    assert [step["status"] for step in steps if "status" in step] == ["solved"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--set", "controler.step_s=3600"], "write connection.KEY=VALUE, controller.KEY=VALUE or"),
        (["--connection", "fils"], "unknown connection 'fils', did you mean 'files'"),
        (["--set", "connection.levles=x.json"], "did you mean 'levels'"),
        (["--set", "connection.measurements=none.csv"], "connection.measurements: none.csv: no such file; name it by"),
        (["--set", "connection.forecast=none.csv"], "connection.forecast: none.csv: no such file; name it by"),
        (["--map", "other.yaml"], "another building?"),
    ],
)
def test_wrong_words_are_named(files, words, message):
    done = CliRunner().invoke(cli, ["control", "--model", "model", "--map", "map.yaml", "--dry-run", *OPTIONS, *words])
    assert message in str(done.exception)


class Killed(BaseException):
    """As SIGKILL: nothing is given back."""


def test_the_level_of_the_step_that_was_cut_off_is_kept(tmp_path):
    """Killed at the end of a step whose level nobody measures, the next run knows it all the same."""
    house = SimulatedBuilding()
    kept = KeptState(tmp_path / "state.npz", "this model")
    wait = house.wait_until

    def waited(at):
        killed = START + 5 * HOUR - pd.Timedelta("1s")
        wait(min(at, killed))
        if house.at >= killed:
            house.write = lambda levels, seconds: None
            kept.save = lambda value: None
            raise Killed

    house.wait_until = waited
    with pytest.raises(Killed):
        controlled(house, 24, kept=kept)
    applied = kept.load(START + 5 * HOUR).applied
    assert sum(one.duration_s for one in applied) == 5 * 3600.0
    assert [one.u for one in applied] == [(levels["actuator"],) for _, levels, _ in house.written]


def test_a_level_that_was_given_back_is_known_until_then(tmp_path):
    """Ended in the middle of a step whose level nobody measures; the next run begins in a later one."""
    house = SimulatedBuilding()
    kept = KeptState(tmp_path / "state.npz", "this model")
    wait = house.wait_until

    def interrupted(at):
        wait(min(at, START + 2.5 * HOUR))
        if house.at >= START + 2.5 * HOUR:
            raise KeyboardInterrupt

    house.wait_until = interrupted
    with pytest.raises(KeyboardInterrupt):
        controlled(house, 24, kept=kept, delay_s=0.0)
    found = kept.load(START + 4 * HOUR)
    assert sum(one.duration_s for one in found.applied) == 2.5 * 3600.0
    assert found.instant == (START + 2 * HOUR).isoformat()


def killed_and_run_again(tmp_path, at_h, again_h, of="this model", **options):
    """Decisions of a run that was killed at `at_h`, and of five steps of another one from `again_h` on."""
    house, runs = SimulatedBuilding(), []
    wait, write = house.wait_until, house.write

    def waited(at):
        killed = START + at_h * HOUR
        wait(min(at, killed))
        if house.at >= killed:
            house.wait_until, house.write, kept.save = wait, lambda levels, seconds: None, lambda value: None
            raise Killed

    house.wait_until = waited
    for steps, whose in ((24, "this model"), (5, of)):
        building = LiveBuilding(house, MeasurementMap.model_validate(RULES), 3600.0)
        runs.append([])
        kept = KeptState(tmp_path / "state.npz", whose)
        try:
            control(building, mpc(**options), clock=house, steps=steps, told=runs[-1].append, kept=kept)
        except Killed:
            house.write = write
            wait(START + again_h * HOUR)
    return runs


@pytest.mark.slow
@pytest.mark.parametrize(("at_h", "again_h", "then"), [(4.1, 4.1, 4), (4.999, 5.0, 5)])
def test_a_run_that_was_killed_goes_on_as_if_it_had_not_been(tmp_path, at_h, again_h, then):
    """Killed early in a step, the new run decides it once more; killed at its end, the new one begins with the next."""
    watch = {"watch": {"enabled": True}}
    house, whole = SimulatedBuilding(), []
    building = LiveBuilding(house, MeasurementMap.model_validate(RULES), 3600.0)
    control(building, mpc(**watch), clock=house, steps=12, told=whole.append)
    first, again = killed_and_run_again(tmp_path, at_h, again_h, **watch)
    assert [decision.instant for decision in again] == [decision.instant for decision in whole[then : then + 5]]
    assert len(first) == 5
    for one, other in zip(again, whole[then:], strict=False):
        assert one.plan.status == other.plan.status
        np.testing.assert_allclose(one.plan.u, other.plan.u, atol=1e-5)


def runs_of(decisions):
    """How long each stretch of on and of off is, min, of decisions in order."""
    blocks = [(block.u[0] > 0.0, block.duration_s / 60.0) for one in decisions for block in one.blocks]
    return [(on, sum(length for _, length in each)) for on, each in groupby(blocks, key=lambda block: block[0])]


@pytest.mark.slow
@pytest.mark.parametrize(("at_h", "again_h"), [(5.1, 5.1), (5.999, 6.0)])
def test_minimum_times_hold_over_a_kill(tmp_path, at_h, again_h):
    """Two and a half hours on and off at the least, in steps of one: a restart falls into each."""
    keeps = {"actuation": {"mode": "duty", "min_on_s": 9000.0, "min_off_s": 9000.0, "block_s": 900.0}}
    first, again = killed_and_run_again(tmp_path, at_h, again_h, **keeps)
    before = [one for one in first if one.instant < again[0].instant]
    inner = runs_of([*before, *again])[1:-1]
    assert inner, "it is switched"
    assert min(minutes for _, minutes in inner) >= 150.0


def test_the_state_of_another_model_is_not_gone_on_from(tmp_path, caplog):
    _, told = killed_and_run_again(tmp_path, 4.1, 4.1, of="another")
    assert [decision.plan.status for decision in told] == ["solved"] * 5
    assert "of another model or other options: begun anew" in caplog.text


def test_a_damaged_or_old_state_stops_no_control(tmp_path, caplog):
    path = tmp_path / "state.npz"
    path.write_bytes(b"PK\x03\x04 torn")
    assert KeptState(path, "x").load(START) is None
    assert "no state of this version" in caplog.text
    kept = Kept(START.isoformat(), START.isoformat(), None, "after", ())
    KeptState(path, "x").save(kept)
    assert KeptState(path, "x").load(START + HOUR).state_at(START + HOUR) == "after"
    assert KeptState(path, "x").load(START + 25 * HOUR) is None
    assert "more than a day ago" in caplog.text
    assert KeptState(path, "x").load(START - HOUR) is None
    assert "was the clock set back?" in caplog.text
    KeptState(tmp_path / "none" / "state.npz", "x").save(kept)
    assert "a restart begins anew" in caplog.text


@pytest.mark.slow
def test_the_command_keeps_its_state_where_its_log_is(files, monkeypatch):
    monkeypatch.setattr(WallClock, "wait_until", lambda self, at: None)
    words = ["control", "--model", "model", "--map", "map.yaml", "--steps", "1", "--delay", "0", *OPTIONS]
    first = CliRunner().invoke(cli, words)
    assert first.exit_code == 0, first.output + str(first.exception)
    for changed, said in (([], "goes on from the state of"), (["--set", "controller.horizon_h=10"], "begun anew")):
        done = CliRunner().invoke(cli, [*words, *changed])
        assert done.exit_code == 0, done.output + str(done.exception)
        assert said in (files / "control" / "log.jsonl").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), SystemExit(1)])
def test_an_output_that_is_lost_ends_no_control(files, monkeypatch, error):
    """A terminal under nohup that was closed, and a pipe that nobody reads any more."""
    monkeypatch.setattr(WallClock, "wait_until", lambda self, at: None)

    def lost(self, text):
        raise error

    monkeypatch.setattr(RunDisplay, "say", lost)
    words = ["control", "--model", "model", "--map", "map.yaml", "--steps", "2", "--delay", "0", *OPTIONS]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, str(done.exception)
    log = [json.loads(line) for line in (files / "control" / "log.jsonl").read_text().splitlines()]
    assert sum("status" in line for line in log) == 2
    assert sum("nothing is printed any more" in line["message"] for line in log) == 1
    assert json.loads((files / "levels.json").read_text())["levels"] == {"actuator": None}


@pytest.mark.slow
@pytest.mark.parametrize(("sent", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_to_end_gives_the_building_back(files, sent, code):
    """SIGHUP: the terminal was closed, or the connection to it lost."""
    words = [sys.executable, "-m", "thermoforce_mpc", "control", "--model", "model", "--map", "map.yaml", *OPTIONS]
    env = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    levels = files / "levels.json"
    ours = signal.signal(sent, signal.SIG_DFL)  # inherited, and ignored where the tests run under nohup
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([*words, "--delay", "0"], env=env, **pipes) as running:
        signal.signal(sent, ours)
        wait_for("the first levels are set", lambda: levels.exists() or running.poll() is not None)
        running.send_signal(sent)
        said = running.communicate(timeout=LONG_S)[1]
        assert running.returncode == code
    assert said.endswith("Terminated.\ngiven back to the building's own control: actuator\n")
    assert json.loads(levels.read_text())["levels"] == {"actuator": None}


WORDS = ["control", "--model", "model", "--map", "map.yaml", *OPTIONS]
CONTROL = [sys.executable, "-m", "thermoforce_mpc"]


def watchdogs(folder):
    """Numbers of the watchdogs that were started in a folder."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if b"connections.watchdog" in (place / "cmdline").read_bytes() and (place / "cwd").readlink() == folder:
                found.append(int(place.name))
    return found


@pytest.mark.slow
def test_two_controllers_do_not_set_one_building(files):
    """With folders of their own; the second is refused, and the first goes on. One that is killed is no hindrance."""
    (files / "elsewhere").mkdir()
    (files / "elsewhere" / "same.json").symlink_to(files / "levels.json")
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    other = [*WORDS, "--out", "other"]
    second = [*other, "--steps", "1", "--set", "connection.levels=elsewhere/same.json"]
    with subprocess.Popen([*CONTROL, *WORDS, "--delay", "0"], env=env, stdout=subprocess.DEVNULL) as first:
        try:
            wait_for("the first sets its level", (files / "levels.json").exists)
            before = (files / "levels.json").read_bytes()
            refused = CliRunner().invoke(cli, second).exception
            assert isinstance(refused, ConfigError)
            assert "levels.json is set by another controller" in str(refused)
            assert f"process {first.pid} since" in str(refused)
            assert (files / "levels.json").read_bytes() == before
            assert CliRunner().invoke(cli, [*other, "--dry-run"]).exit_code == 0, "it sets nothing"
            assert len(watchdogs(files)) == 1
        finally:
            first.kill()
    with subprocess.Popen([*CONTROL, *second, "--delay", "0"], env=env, stdout=subprocess.DEVNULL) as again:
        try:
            wait_for("the second sets its level", lambda: (files / "levels.json").read_bytes() != before)
            wait_for("that of the first leaves the building to it", lambda: len(watchdogs(files)) == 1)
        finally:
            again.terminate()
    wait_for("no watchdog is left", lambda: not watchdogs(files))
    assert json.loads((files / "levels.json").read_text())["levels"] == {"actuator": None}


def test_without_memory_the_building_gets_its_own_control_and_is_told_why(monkeypatch):
    """As after `ulimit -v`, or a leak of something else: a solver would hang until its time limit, at every step."""
    house, least = SimulatedBuilding(), [0]
    wait = house.wait_until

    def waited(at):
        least[0] = 1 if at >= START + 3 * HOUR else 0
        wait(at)

    house.wait_until = waited
    limit = resource.getrlimit(resource.RLIMIT_AS)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (1, 1) if least[0] else limit)
    told = controlled(house, 5)
    assert [decision.plan.status for decision in told] == ["solved"] * 3 + ["native"] * 2
    assert "0 MB of memory of this process's limit (ulimit -v) are left" in told[3].plan.why


def test_what_a_connection_sets_is_what_it_says_or_else_its_options(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    house = SimulatedBuilding()
    assert set_by(house) == "", "one of Python's that does not say"
    names = [set_by(house, "modbus", {"host": host}) for host in ("10.0.0.1", "10.0.0.2", "10.0.0.1")]
    assert names[0] == names[2] != names[1]
    with sole_control(names[0]):
        with sole_control(names[1]):
            pass
        said = rf"10\.0\.0\.1.* another controller \(process {os.getpid()} since"
        with pytest.raises(ConfigError, match=said), sole_control(names[2]):
            pass
        controlled(house, 1, sets="another")
        with pytest.raises(ConfigError, match="another controller"):
            controlled(house, 1, sets=names[0])
    with sole_control(("broker hall", "broker bath")):
        with pytest.raises(ConfigError, match="broker bath is set by another"), sole_control(("broker bath",)):
            pass
        with pytest.raises(ConfigError), sole_control(("broker attic", "broker hall")):
            pass
        with sole_control(("broker attic",)):  # the attempt before holds nothing
            pass
    with sole_control(names[2]):
        house.sets = lambda: 4
        with pytest.raises(ConfigError, match=r"sets\(\) is 4"):
            set_by(house, "modbus")
