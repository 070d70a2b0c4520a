"""Modes of control: advice and shadow set nothing, and a shadow says what it would have saved."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from simple_house import simple_model
from simulated_building import RULES, START, SimulatedBuilding, files_of_now, mpc

from controllers.mpc.config import MPCConfig
from thermoforce_mpc.cli import cli
from thermoforce_mpc.connections.sole import sole_control
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.live import KeptState, LiveBuilding, WallClock, control
from thermoforce_mpc.live.building import real_run
from thermoforce_mpc.live.probing import ProbingPlan, probe_building, probing_key
from thermoforce_mpc.live.shadow import ShadowBook, judged_day
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.records.live_journal import LiveJournal
from thermoforce_mpc.report.live_view import LiveRun
from thermoforce_mpc.scenario.scenario import ProbingSpec

MAP = MeasurementMap.model_validate(RULES)
DAY = pd.Timedelta("1D")


def shadowed(folder, house, steps, told=lambda decision: None):
    controller = mpc(horizon_h=24.0)
    simple_model().save(folder / "given", overwrite=True)
    journal = LiveJournal(folder, real_run(folder, folder / "given", Path("h.yaml"), MAP, controller.config, "x"))
    kept = KeptState(folder / "state.npz", "k")
    building = LiveBuilding(house, MAP, 3600.0)
    control(
        building, controller, clock=house, steps=steps, journal=journal, kept=kept, told=told, acts=False, sets="house"
    )


def test_what_is_not_to_act_sets_nothing_and_takes_no_lock(tmp_path):
    house, plans = SimulatedBuilding(), []
    with sole_control("house"):
        shadowed(tmp_path, house, 3, plans.append)
    assert house.written == []
    assert [decision.plan.status for decision in plans] == ["solved"] * 3
    view = LiveRun(tmp_path).now()
    measured = [row["u"] for row in house.rows[house.begun :]]
    assert view.past[-1].u[0] == pytest.approx(np.mean(measured[60:120]), abs=0.02)


@pytest.mark.slow
def test_a_shadow_says_what_its_plans_would_have_saved(tmp_path, monkeypatch):
    """The house is left alone, and kept warmer than it has to be; one day is judged once more from the journal."""
    monkeypatch.setattr("thermoforce_mpc.live.shadow.LEAST_AFTER", 2)
    house, words = SimulatedBuilding(), []
    book = ShadowBook(tmp_path, simple_model())

    def told(decision):
        words.append(book.day_over(decision.instant))

    shadowed(tmp_path, house, 51, told)
    said = [text for text in words if text]
    assert said[0] == "shadow: 1 day of the 2 that an account needs"
    assert said[1].startswith("shadow, 2 days: ")
    kept = json.loads((tmp_path / "shadow.json").read_text())
    assert kept["said"] == said[1]
    assert ShadowBook(tmp_path, simple_model()).days == book.days
    day = judged_day(tmp_path, simple_model(), START + DAY)
    assert day == book.days[1]
    rows = pd.DataFrame(house.rows[house.begun :]).set_index("time")
    kWh = rows["P"] * rows.index.to_series().diff().shift(-1).dt.total_seconds() / 3.6e6
    measured_kWh = kWh[START + DAY : START + 2 * DAY - pd.Timedelta("1s")].sum()
    assert day.energy_kWh > 0.0
    assert abs(day.left_K) < 0.1
    assert day.planned_low_kWh <= day.planned_kWh <= day.planned_high_kWh
    assert day.cost == pytest.approx(0.25 * day.energy_kWh)
    assert day.energy_kWh == pytest.approx(measured_kWh, rel=0.02)


class KilledError(BaseException):
    """The process is killed: nothing more is done."""


def probed(folder, kill_at_h=None, days=1.0, most_days=1.0):
    """Probe a house, killed once; returns it and the model, None where nothing could be identified."""
    house, rules = SimulatedBuilding(), MAP.model_copy(update={"step": "15min"})
    spec = ProbingSpec(
        days=days,
        most_days=most_days,
        probing={"candidates": 4, "trial_levels": [0.5]},
        options={"modulation": "linear", "order": 1},
    )
    plan = ProbingPlan.of(spec, MPCConfig(), rules)
    run = real_run(folder, None, Path("h.yaml"), rules, MPCConfig(), "x", "probing")

    def go():
        return probe_building(
            LiveBuilding(house, rules, 900.0),
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
    assert len(drawn) == 96
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


def test_advice_is_written_and_nothing_is_set(files):
    done = CliRunner().invoke(cli, [*WORDS, *PLANNED, "--mode", "advise"])
    assert done.exit_code == 0, str(done.exception)
    assert not (files / "levels.json").exists()
    advice = json.loads((files / "control" / "advice.json").read_text())
    assert sum(block["seconds"] for block in advice["blocks"]) == 3600.0
    assert 0.0 <= advice["blocks"][0]["levels"]["actuator"] <= 1.0
    assert len(advice["planned"]["u"][0]) == 12


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
