"""Modes of control: advice and shadow set nothing, and a shadow says what it would have saved."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from simple_house import POLE, simple_model
from simulated_building import RULES, START, SimulatedBuilding, files_of_now, mpc

from controllers.mpc.config import MPCConfig
from thermoforce_mpc.cli import cli
from thermoforce_mpc.connections.sole import sole_control
from thermoforce_mpc.errors import ConfigError, DataError, PlantError
from thermoforce_mpc.live import KeptState, LiveBuilding, WallClock, control
from thermoforce_mpc.live.building import real_run
from thermoforce_mpc.live.probing import ProbingPlan, probe_building, probing_key
from thermoforce_mpc.live.shadow import ShadowBook
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.records.live_journal import LiveJournal
from thermoforce_mpc.report.live_view import LiveRun
from thermoforce_mpc.scenario.scenario import ProbingSpec

MAP = MeasurementMap.model_validate(RULES)
BILLS = Path(__file__).parents[2] / "configs" / "bills"
DAY = pd.Timedelta("1D")


def controlled(folder, house, steps, told=lambda decision: None, acts=False):
    controller = mpc()
    if not (folder / "given").exists():
        simple_model(0.1).save(folder / "given")
    journal = LiveJournal(folder, real_run(folder, folder / "given", Path("h.yaml"), MAP, controller.config, "x"))
    kept = KeptState(folder / "state.npz", "k")
    building = LiveBuilding(house, MAP, 3600.0)
    sets = "house" if not acts else f"{folder}"
    control(building, controller, clock=house, steps=steps, journal=journal, kept=kept, told=told, acts=acts, sets=sets)


def shadow(folder, house, steps, book=None):
    """What a shadow says over some steps, '' left out, and its book."""
    words, book = [], book or ShadowBook(folder, simple_model(0.1), mpc(), key="k")
    controlled(folder, house, steps, lambda decision: words.append(book.day_over(decision.instant)))
    return [text for text in words if text], book


def test_what_is_not_to_act_sets_nothing_and_takes_no_lock(tmp_path):
    house, plans = SimulatedBuilding(), []
    with sole_control("house"):
        controlled(tmp_path, house, 3, plans.append)
    assert house.written == []
    assert [decision.plan.status for decision in plans] == ["solved"] * 3
    view = LiveRun(tmp_path).now()
    measured = [row["u"] for row in house.rows[house.begun :]]
    assert view.past[-1].u[0] == pytest.approx(np.mean(measured[60:120]), abs=0.02)


def test_a_table_that_keeps_its_last_days_is_not_written_anew_in_each_step(tmp_path):
    """Means of a table that begins later differ in their last digits."""

    class LastDays(SimulatedBuilding):
        def measurements(self):
            told = super().measurements().iloc[-2 * 1440 :]
            return told.assign(u=0.3 + 0.2 * np.sin(told["time"].dt.minute))

    controlled(tmp_path, LastDays(), 6)
    entries = [json.loads(line) for line in (tmp_path / "journal.jsonl").read_text().splitlines()]
    tails = [len(json.dumps(entry)) for entry in entries if entry["kind"] == "tail"]
    (whole,) = [len(json.dumps(entry)) for entry in entries if entry["kind"] == "past"]
    assert len(tails) >= 4
    assert max(tails) < 0.5 * whole


def test_what_a_shadow_learns_of_readings_stays(tmp_path):
    house = SimulatedBuilding()
    controlled(tmp_path, house, 3)
    kept = KeptState(tmp_path / "state.npz", "k").load(house.now())
    assert kept.after.first_s == pytest.approx((START - pd.Timestamp("2025-01-01", tz="UTC")).total_seconds())
    assert kept.after.predictor is not None
    assert kept.after.peak_W > 0.0
    # Its plan did not act: it is not followed later, and nothing is held.
    assert kept.after.good is None
    assert all(state.native for state in kept.after.actuation)
    assert kept.after.failures == 0


@pytest.mark.slow
def test_a_shadow_says_what_control_then_does(tmp_path, monkeypatch):
    """The house is left alone, and kept warmer than it has to be; then the same days are controlled."""
    monkeypatch.setattr("thermoforce_mpc.live.shadow.LEAST_AFTER", 2)
    monkeypatch.setattr("simple_house.native_level", lambda T_C: float(T_C < 21.2))
    left_alone, acting = SimulatedBuilding(), SimulatedBuilding()
    (tmp_path / "shadow").mkdir()
    said, book = shadow(tmp_path / "shadow", left_alone, 26)
    assert said == ["shadow: 1 day of the 2 that an account needs"]
    # Started again it goes on where house and controller stood.
    said, book = shadow(tmp_path / "shadow", left_alone, 25)
    assert said[-1].startswith("shadow, 2 days: ")
    assert [day.goes_on for day in book.days] == [False, True]
    kept = json.loads((tmp_path / "shadow" / "shadow.json").read_text())
    assert kept["said"] == said[-1]
    (tmp_path / "control").mkdir()
    controlled(tmp_path / "control", acting, 50, acts=True)

    def lived(house):
        rows = pd.DataFrame(house.rows[house.begun :]).set_index("time")[START : START + 2 * DAY - pd.Timedelta("1s")]
        outside_K = np.maximum(20.0 - rows["T"], 0.0) + np.maximum(rows["T"] - 24.0, 0.0)
        return rows["P"].sum() / 60e3, outside_K.sum() / 60.0, rows["T"].iloc[-1]

    (was_kWh, was_Kh, was_C), (did_kWh, did_Kh, did_C) = map(lived, (left_alone, acting))
    assert sum(day.energy_was_kWh for day in book.days) == pytest.approx(was_kWh, rel=0.02)
    assert sum(day.energy_kWh for day in book.days) == pytest.approx(did_kWh, rel=0.1)
    assert sum(day.outside_was_Kh for day in book.days) == pytest.approx(was_Kh, abs=0.05)
    assert sum(day.outside_Kh for day in book.days) == pytest.approx(did_Kh, abs=0.5)
    # A kelvin that is missing at the end costs what it does in the record, as long as its effect lasts.
    stored_kWh = (did_C - was_C) / -np.log(POLE) * was_kWh / 48.0 / 18.0
    saved = sum(day.saved[0] for day in book.days)
    low, high = map(float, re.search(r"90 % band (\S+) to ([-+0-9.]+)", said[-1]).groups())
    assert low < 0.25 * (was_kWh - did_kWh + stored_kWh) < high
    assert saved == pytest.approx(0.25 * (was_kWh - did_kWh + stored_kWh), abs=0.1 * 0.25 * was_kWh)


@pytest.mark.parametrize("steps", [1, 2], ids=["before midnight", "after midnight"])
def test_a_day_is_judged_where_a_shadow_is_started_again_around_midnight(tmp_path, steps):
    """Else one that a timer starts again each night would count none; here too little of it was decided."""
    house = SimulatedBuilding()
    house.wait_until(START + pd.Timedelta("23h"))
    assert shadow(tmp_path, house, steps)[0] == []
    with pytest.raises(DataError, match="12 Jan: 1 of 24 decisions were made in it: the day does not count"):
        shadow(tmp_path, house, 3)


def test_a_day_in_which_control_acted_is_no_day_of_a_shadow(tmp_path):
    """What was is then what control did, and nothing is told of what it saves."""
    house = SimulatedBuilding()
    house.wait_until(START + pd.Timedelta("21h"))
    controlled(tmp_path, house, 2, acts=True)
    with pytest.raises(DataError, match="12 Jan: control acted in 2 of 3 steps: the day does not count"):
        shadow(tmp_path, house, 3)


class KilledError(BaseException):
    """The process is killed: nothing more is done."""


def probed(folder, kill_at_h=None, days=1.0, most_days=1.0):
    """Probe a house, killed once; returns it and the model, None where nothing could be identified."""
    house, rules = SimulatedBuilding(), MAP.model_copy(update={"step": "30min"})
    spec = ProbingSpec(
        days=days,
        most_days=most_days,
        probing={"candidates": 4, "trial_levels": [0.5]},
        options={"modulation": "linear", "order": 1, "sun_on_sensor": False, "late_sensor": False},
    )
    config = MPCConfig(step_s=1800.0)
    plan = ProbingPlan.of(spec, config, rules)
    run = real_run(folder, None, Path("h.yaml"), rules, config, "x", "probing")

    def go():
        return probe_building(
            LiveBuilding(house, rules, 1800.0),
            plan,
            clock=house,
            kept=KeptState(folder / "state.npz", probing_key(plan, rules)),
            journal=LiveJournal(folder, run),
        )

    if kill_at_h is not None:
        wait, write = house.wait_until, house.write

        def killed(until):
            if until > START + pd.Timedelta(hours=kill_at_h):
                house.write = house.wait_until = nothing
                raise KilledError
            wait(until)

        def nothing(*_):
            raise KilledError

        house.wait_until = killed
        with pytest.raises((KilledError, PlantError)):
            go()
        house.wait_until, house.write = wait, write
    return house, go()


@pytest.mark.slow
def test_a_real_building_is_probed_politely_and_goes_on_where_it_was_killed(tmp_path):
    house, model = probed(tmp_path)
    levels = [(at, levels["actuator"]) for at, levels, _ in house.written]
    drawn = [level for _, level in levels if level is not None]
    assert len(drawn) == 48
    assert 0.2 < np.mean(drawn) < 0.9
    assert levels[-1][1] is None
    T = [row["T"] for row in house.rows[house.begun :]]
    assert min(T) > 20.0 - 1.0
    assert max(T) < 24.0 + 1.0
    assert "probing ended after 1 days: enough is known" in " ".join(model.only.card.notes)
    (tmp_path / "killed").mkdir()
    again, same = probed(tmp_path / "killed", kill_at_h=9.4)
    repeated = [(at, levels["actuator"]) for at, levels, _ in again.written]
    assert dict(repeated) | {levels[-1][0]: None} == dict(levels)
    assert same.only.operator.steady_gains_K == pytest.approx(model.only.operator.steady_gains_K, rel=1e-3)
    assert LiveRun(tmp_path / "killed").now().controller == "probing"


def test_a_building_that_is_set_by_commands_is_not_probed_by_levels():
    command = {"kind": "setpoint", "column": "T", "minimum": 18, "maximum": 24}
    rules = MeasurementMap.model_validate(RULES | {"actuators": {"actuator": {"level": "u", "command": command}}})
    with pytest.raises(ConfigError, match=r"actuators\.actuator: is set by its set-point, and probing sets levels"):
        ProbingPlan.of(ProbingSpec(), MPCConfig(), rules)
    with pytest.raises(ConfigError, match="at most 27"):
        ProbingPlan.of(ProbingSpec(most_days=40), MPCConfig(), MAP)


WORDS = [
    "control", "--map", "map.yaml", "--steps", "2", "--delay", "0", "--set", "controller.step_s=3600",
]  # fmt: skip
PLANNED = [
    "--model", "model", "--set", "controller.horizon_h=12", "--set", "controller.free_response.name=persistence",
    "--set", "controller.gate.enabled=false",
]  # fmt: skip


@pytest.fixture
def files(tmp_path, monkeypatch):
    files_of_now(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(WallClock, "wait_until", lambda self, at: None)
    return tmp_path


def test_advice_is_written_and_nothing_is_set(files, monkeypatch):
    monkeypatch.setattr(ThermalModel, "claims", property(lambda self: ("another load",)))
    done = CliRunner().invoke(cli, [*WORDS, *PLANNED, "--mode", "advise"])
    assert done.exit_code == 0, str(done.exception)
    assert "Found: another load\n" in done.output
    assert not (files / "levels.json").exists()
    advice = json.loads((files / "control" / "advice.json").read_text())
    assert sum(block["seconds"] for block in advice["blocks"]) == 3600.0
    assert 0.0 <= advice["blocks"][0]["levels"]["actuator"] <= 1.0
    assert len(advice["planned"]["u"][0]) == 12


def test_a_shadow_says_what_of_a_bill_its_account_leaves_out(files):
    (files / "bill.yaml").write_text((BILLS / "norway.yaml").read_text())
    done = CliRunner().invoke(cli, [*WORDS, *PLANNED, "--mode", "shadow", "--prices", "bill.yaml"])
    assert done.exit_code == 0, str(done.exception)
    assert "bill.yaml: peak: not counted in what it would have saved" in done.output.replace("\n", " ")
    log = [json.loads(line) for line in (files / "control" / "log.jsonl").read_text().splitlines()]
    assert next(line["status"] for line in log if "status" in line) == "solved"


def test_probing_by_the_command_sets_levels_that_it_draws(files):
    done = CliRunner().invoke(cli, [*WORDS, "--probe", "--set", "identification.probing.candidates=2"])
    assert done.exit_code == 0, str(done.exception)
    log = [json.loads(line) for line in (files / "control" / "log.jsonl").read_text().splitlines()]
    assert next(line["message"] for line in log if "status" in line) == "probing, 0.00 of 3 days"
    assert json.loads((files / "levels.json").read_text())["levels"] == {"actuator": None}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "--model: missing; give the folder"),
        (["--probe", "--mode", "shadow"], "--probe: is --mode probe, and --mode is shadow"),
        (["--probe", "--model", "model"], "--model: leave it out; a model is found by --mode probe"),
        (["--probe", "--dry-run"], "nothing is decided once"),
        ([*PLANNED, "--set", "identification.days=2"], "is for --mode probe"),
        (["--probe", "--set", "identification.model=x"], "leave them out"),
        (["--probe", "--set", "identification.days=0"], "days"),
    ],
)
def test_what_a_mode_has_no_use_for_is_refused(files, words, message):
    assert message in str(CliRunner().invoke(cli, [*WORDS, *words]).exception)
