"""`tf-mpc inspect` of a building with several zones: every actuator, machine and pair by name."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from thermoforce_mpc.cli import cli
from thermoforce_mpc.experiment import run_models
from thermoforce_mpc.experiment.identifying import may_act
from thermoforce_mpc.model.card import Competence, HorizonScore, ModelCard
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import LevelCost, PowerModel
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel

KNOWN_K = {h: 4.0 * (1.0 - 0.9**h) for h in (1, 2, 4, 8, 12, 24, 48)}
JUDGED = tuple(HorizonScore(hours, 0.1, 0.5, 0.4, 3.0, 9) for hours in (1.0, 6.0))
GOOD = Competence(True, horizons=JUDGED, effect_K=KNOWN_K[8], effect_sd_K=0.2)
POOR = Competence(False, ("too weak",), ("hold full level",), effect_K=KNOWN_K[8], effect_sd_K=2.0)


def card(verdict: Competence) -> ModelCard:
    known = {f"step_response_{h}h_K": of for h, of in KNOWN_K.items()}
    sds = {f"step_response_{h}h_sd_K": 0.01 * h for h in (1, 2, 4, 8, 12, 24, 48)}
    return ModelCard(source="3 days of probing", uncertainty=known | sds, competence=verdict)


def building(*verdicts: Competence) -> ThermalModel:
    """The radiator heats the bath and, less, the hall; the floor heats the hall alone; one boiler feeds both."""
    own = linear_operator(np.array([0.9]), np.array([0.4]), step_s=3600.0)
    less = replace(own, gains=0.25 * own.gains)
    operator = BuildingOperator(("bath", "hall"), ("radiator", "floor"), ((own, None), (less, own)), (0, 1))
    power = PowerModel(MachineLoad((100.0, 0.0, 900.0, 0.0), (-20.0, 30.0), lowest_level=1.0))
    return ThermalModel(
        operator, (power,), (None, None), tuple(card(v) for v in verdicts), ("boiler",), (0, 0), (0.5, 0.5)
    )


def test_every_actuator_machine_and_pair_is_told(tmp_path):
    folder = building(GOOD, POOR).save(tmp_path / "model")
    done = CliRunner().invoke(cli, ["inspect", str(folder)], catch_exceptions=False)
    assert done.exit_code == 0
    told = done.output
    assert "zones: 2, actuators: 2, machines: 1; 3 pairs with an effect" in told
    assert "boiler feeds radiator, floor" in told
    assert "every pair CERTIFIED" in told
    bath, hall = (line for line in told.splitlines() if line.lstrip("│ ").startswith(("bath", "hall")))
    assert "no effect" in bath
    assert "3.97 (3.18 to 4.76)" in bath
    assert hall.count("(") == 1, "the radiator's effect on the hall has no band on its card"
    for head in ("radiator in bath", "floor in hall"):
        assert head in told
    assert told.count("Power of boiler:") == 1
    assert told.index("Competence: COMPETENT") < told.index("floor in hall") < told.index("NOT COMPETENT")


def test_notes_of_a_kind_are_told_once(tmp_path):
    bridged = tuple(f"run: bridged T_out_C: {n} of 400 by linear interpolation" for n in (3, 8, 2))
    model = building(GOOD, GOOD)
    cards = tuple(replace(card, notes=(*bridged, "probing went on")) for card in model.cards)
    folder = replace(model, cards=cards).save(tmp_path / "model")
    told = " ".join(CliRunner().invoke(cli, ["inspect", str(folder)], catch_exceptions=False).output.split())
    assert told.count("bridged T_out_C") == 1
    assert "3 of 400 by linear interpolation (and 2 more of its kind)" in told
    assert told.count("note: probing went on") == 1
    assert "notes above" in told


def test_what_heat_costs_at_the_levels_that_were_tried_is_told(tmp_path):
    tried = LevelCost(0.25, 0.88, 0.1, 1.57, 0.17).numbers()
    model = building(GOOD, GOOD)
    cards = tuple(replace(card, uncertainty={**card.uncertainty, **tried}) for card in model.cards)
    warm = PowerModel(MachineLoad((100.0, 0.0, 900.0, 0.0), (-20.0, 30.0), 0.25, curve_W=50.0), water_s=3600.0)
    folder = replace(model, cards=cards, power=(warm,)).save(tmp_path / "model")
    told = CliRunner().invoke(cli, ["inspect", str(folder)], catch_exceptions=False).output
    assert "+ u^2 x 50 W, the last part in water that follows u in 1 h" in " ".join(told.split())
    assert (
        told.count("Tried: at level 0.25 heat costs 0.88 ± 0.10 times as much as at full level; heat per level 1.57")
        == 2
    )
    assert told.count("heat per level 1.57 ± 0.17 times that of full level; so it takes 35 % of its full power") == 2
    assert "t: by how many standard errors the model's are smaller" in " ".join(told.split())
    assert re.search(
        r"ahead +model +unchanged +t +weather alone +t *\n[ ─]+\n +1 +0\.10 +0\.50 +nan +0\.40 +3\.0", told
    )


@pytest.mark.parametrize(("verdicts", "may"), [((GOOD, GOOD), True), ((GOOD, POOR), False), ((POOR, GOOD), False)])
def test_a_model_acts_only_if_all_its_cards_are_competent(verdicts, may):
    assert may_act(building(*verdicts)) == may


def test_the_manifest_tells_of_every_actuator():
    origin = run_models.origin(building(GOOD, POOR))
    assert {name: of["competence"]["competent"] for name, of in origin["actuators"].items()} == {
        "radiator": True,
        "floor": False,
    }
    assert origin["pairs"] == 3


def test_the_folder_of_a_run_shows_its_model(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    assert "holds no model" in str(CliRunner().invoke(cli, ["inspect", str(run)]).exception)
    (run / "journal.jsonl").touch()
    assert "a file; give the folder" in str(CliRunner().invoke(cli, ["inspect", str(run / "journal.jsonl")]).exception)
    told = CliRunner().invoke(cli, ["inspect", str(run)])
    assert "this run identified no model" in str(told.exception)
    building(GOOD, POOR).save(run / "model")
    shown = CliRunner().invoke(cli, ["inspect", str(run)], catch_exceptions=False).output
    assert shown == CliRunner().invoke(cli, ["inspect", str(run / "model")], catch_exceptions=False).output
