"""The gate: no controller acts on an incompetent model, nor on none; it costs nothing where the model passes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.checks import ControllerConfigError
from controllers.registry import REGISTRY, build_controller, controller_config
from controllers.rules.native import NativeController
from thermoforce_mpc.experiment.identifying import SavedModel
from thermoforce_mpc.experiment.run_models import identify_all
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.card import Competence
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.report.display import RunDisplay

CONDEMNED = Competence(False, reasons=("6 h ahead it errs by 7.00 K, need 1 K",), effect_K=7.0, effect_sd_K=5.0)
TESTCASE = load_testcase("bestest_hydronic_heat_pump")
HOURLY = {"step_s": 3600.0, "horizon_h": 24.0}


def judged(competence):
    model = simple_model()
    return replace(model, cards=(replace(model.only.card, competence=competence),))


def mpc(competence, **options) -> ThermoForceMPC:
    return ThermoForceMPC(judged(competence), MPCConfig(**HOURLY, **options), free_response=OutdoorResponse())


def test_the_buildings_own_control_stays_for_a_condemned_model():
    house = SimpleHouse()
    ours = run_closed_loop(house, mpc(CONDEMNED), house.period("x"))
    assert {u for u, _ in house.applied} == {None}
    assert ours.fallback_levels()["gate"] == len(ours.steps) == 48
    assert "7.00 K" in ours.steps[0].plan.why
    native = run_closed_loop(house, NativeController(), house.period("x"))
    assert ours.kpis["ener_tot"] == pytest.approx(native.kpis["ener_tot"])
    assert ours.kpis["tdis_tot"] == pytest.approx(native.kpis["tdis_tot"])


def test_the_rule_acts_where_the_user_names_it():
    house = SimpleHouse()
    ours = run_closed_loop(house, mpc(CONDEMNED, fallback={"stand_back": "rule"}), house.period("x"))
    assert ours.fallback_levels()["gate"] == 48
    assert {u for u, _ in house.applied} == {0.0, 1.0}


@pytest.mark.slow
def test_the_gate_costs_nothing_where_the_model_passes():
    runs = []
    for competence in (None, Competence(True, effect_K=9.0, effect_sd_K=0.0)):  # nothing is kept for an unsure effect
        house = SimpleHouse()
        runs.append(run_closed_loop(house, mpc(competence), house.period("x")))
    assert runs[1].fallback_levels()["solved"] == 48
    np.testing.assert_array_equal([s.u_applied for s in runs[0].samples], [s.u_applied for s in runs[1].samples])


@pytest.mark.slow
def test_a_model_that_was_identified_but_not_judged_does_not_act_unless_the_user_says_so():
    """Of an older file, say; a model that was given by hand is its author's affair."""
    model = judged(None)
    identified = replace(model, cards=(replace(model.only.card, source="3 days of probing"),))
    for options, held in (({}, 48), ({"gate": {"enabled": False}}, 0)):
        house = SimpleHouse()
        controller = ThermoForceMPC(identified, MPCConfig(**HOURLY, **options), free_response=OutdoorResponse())
        ours = run_closed_loop(house, controller, house.period("x"))
        assert ours.fallback_levels()["gate"] == held
        assert ("identify it again" in ours.steps[0].plan.why) == (held > 0)


@pytest.mark.slow
def test_the_gate_can_be_turned_off_and_is_in_the_papers_configuration():
    house = SimpleHouse()
    ours = run_closed_loop(house, mpc(CONDEMNED, gate={"enabled": False}), house.period("x"))
    assert ours.fallback_levels()["gate"] == 0
    off = {name for name, entry in REGISTRY.own.items() if entry.needs_model and not _config(name).gate.enabled}
    assert off == {"thermoforce_paper", "rc_mpc_paper"}


def test_a_run_says_that_plans_act_where_the_gate_is_off(tmp_path, capsys):
    judged(CONDEMNED).save(tmp_path / "model")
    saved, said = SavedModel(str(tmp_path / "model"), 3600.0), []
    for has_gate in (True, False):
        one = SimpleNamespace(name="mpc", chosen=SimpleNamespace(has_gate=has_gate), model_from=saved)
        identify_all([one], None, RunDisplay())
        said.append(capsys.readouterr().out)
    assert [("plans act all the same" in text) for text in said] == [False, True]


def _config(name: str) -> MPCConfig:
    return controller_config(name, {}, TESTCASE)


@pytest.mark.parametrize("who", ["native", "rule"])
def test_a_controller_without_a_model_stands_back(who):
    house = SimpleHouse()
    options = {**HOURLY, "fallback": {"stand_back": who}}
    controller = build_controller("thermoforce_mpc", options, TESTCASE, "u is constant at 0.4")
    ours = run_closed_loop(house, controller, house.period("x"))
    assert controller.name == "thermoforce_mpc"
    assert ours.fallback_levels()["gate"] == 48
    assert {u for u, _ in house.applied} == ({None} if who == "native" else {0.0, 1.0})
    assert "u is constant at 0.4" in ours.steps[0].plan.why


def test_a_model_of_heating_is_refused_where_the_building_is_cooled():
    cooled = TESTCASE.model_copy(update={"mode": "cooling"})
    with pytest.raises(ControllerConfigError, match=r"identified for heating.*identify on data of cooling"):
        build_controller("thermoforce_mpc", HOURLY, cooled, judged(None))
