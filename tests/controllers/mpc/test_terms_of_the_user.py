"""Terms of the user in the controller's problem: from a file or a subclass, refused with the place of what is wrong."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.checks import ControllerConfigError
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import HOUR_S, Observation, Plan, PlanStatus
from thermoforce_mpc.experiment.experiment import Experiment, check_contestants
from thermoforce_mpc.plants.testcases import load_scenario

TESTCASE = "bestest_hydronic_heat_pump"
OPTIONS = {"step_s": None, "horizon_h": 24.0}

RAMP = """
import casadi as ca

def ramp(plan):
    before = ca.horzcat(plan.last_u, plan.u[:, :-1])
    plan.add_cost(2.0 * ca.sumsqr(plan.u - before))
"""


def seen(last_u: float = 0.0, price: tuple[float, ...] = (0.25,)) -> Observation:
    house = SimpleHouse()
    house.reset(10 * 86400.0, 2 * 86400.0)
    record, boundary = house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S)
    record = replace(record, u=np.append(record.u[0, :-1], last_u)[None])
    prices = np.resize(np.repeat(price, 6), boundary.time_s.size)
    return Observation(record, replace(boundary, price_per_kWh=prices[None], heating_price_per_kWh=prices[None]))


def plan(terms=None, observation: Observation | None = None, terms_: str | None = None, **options) -> Plan:
    config = MPCConfig(**{**OPTIONS, "terms": terms_, **options})

    class Ours(ThermoForceMPC):
        def terms(self):
            return (*super().terms(), *(terms or ()))

    return Ours(simple_model(), config, free_response=OutdoorResponse()).plan(observation or seen())


def roughness(plan: Plan, last_u: float = 0.0) -> float:
    return float(np.square(np.diff(plan.u[0], prepend=last_u)).sum())


@pytest.mark.parametrize("solver", ["auto", "qp", "sqp"])
def test_a_ramp_from_a_file_makes_plans_smoother(solver, tmp_path, monkeypatch):
    (tmp_path / "my_terms.py").write_text(RAMP)
    monkeypatch.chdir(tmp_path)
    without, smooth = plan(solver=solver), plan(solver=solver, terms_="my_terms.py:ramp")
    assert smooth.status is PlanStatus.SOLVED, smooth.why
    assert roughness(smooth) < 0.5 * roughness(without)


def test_a_ramp_begins_at_the_level_of_the_step_before():
    def keep(plan):
        plan.add_cost(1000.0 * ca.sumsqr(plan.u[:, 0] - plan.last_u))

    for last_u in (0.0, 0.4, 1.0):
        assert plan([keep], seen(last_u)).u[0, 0] == pytest.approx(last_u, abs=0.01)
    assert plan([keep], seen(float("nan"))).u[0, 0] == pytest.approx(0.0, abs=0.01), "not known counts as 0"


def battery(plan):
    """5 kWh that are charged when it is cheap and feed the machine when it is dear."""
    n, hours = plan.u.shape[1], plan.step_s / 3600.0
    charge_kW = plan.variable("charge_kW", n, 0.0, 2.0)
    feed_kW = plan.variable("feed_kW", n, 0.0, 2.0)
    stored_kWh = plan.variable("stored_kWh", n, 0.0, 5.0)
    before = ca.horzcat(0.0, stored_kWh[:, :-1])
    plan.equal(stored_kWh - before - hours * (0.95 * charge_kW - feed_kW), "battery")
    plan.require(plan.power_W / 1000.0 - feed_kW, "feeding the machine only")
    price = ca.DM(np.resize(np.repeat([0.1, 0.5], 6), n)).T
    plan.add_cost(hours * ca.dot(price, charge_kW - feed_kW))


@pytest.mark.parametrize("solver", ["auto", "qp", "sqp"])
def test_a_battery_is_charged_when_it_is_cheap_and_keeps_its_books(solver):
    found = plan([battery], seen(price=(0.1, 0.5)), solver=solver)
    assert found.status in (PlanStatus.SOLVED, PlanStatus.ACCEPTABLE), found.why  # Ipopt: to its acceptable level
    charge, feed, stored = (found.own[name] for name in ("charge_kW", "feed_kW", "stored_kWh"))
    np.testing.assert_allclose(np.diff(stored, prepend=0.0), 0.95 * charge - feed, atol=1e-5)
    assert (feed <= found.power_W[0] / 1000.0 + 1e-5).all()
    dear = np.resize(np.repeat([False, True], 6), 24)
    assert feed[dear].sum() > 1.0
    assert charge[dear].sum() < 1e-4


def test_what_cannot_be_kept_leads_to_the_fallback_with_a_reason():
    def impossible(plan):
        plan.require(plan.T_zone_C - 60.0, "60 °C in every step")

    found = plan([impossible])
    assert found.status is PlanStatus.THERMOSTAT
    assert "Ipopt ended with Infeasible_Problem_Detected" in found.why
    assert found.u.size == 0


def test_a_requirement_that_can_be_kept_is_kept():
    found = plan([lambda plan: plan.require(0.4 - plan.u, "at most 0.4")])
    assert found.status is PlanStatus.SOLVED
    assert found.u.max() <= 0.4 + 1e-6


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (lambda plan: plan.no_such_thing, "AttributeError: .*no_such_thing"),
        (lambda plan: plan.u, "returned something; a term adds by"),
        (lambda plan: None, "added nothing"),
        (lambda plan: plan.add_cost("dear"), "add_cost: expected an expression of CasADi's SX, got str"),
        (lambda plan: plan.add_cost(ca.MX.sym("x")), "got MX"),
        (lambda plan: plan.add_cost(ca.SX.sym("mine")), "unknown symbols mine; decisions are made by variable"),
        (lambda plan: plan.add_cost(float("nan")), "not finite"),
        (lambda plan: plan.require(plan.u <= 0.5), "a comparison is 0 or 1"),
        (lambda plan: plan.variable("x", 3, 1.0, 0.0), "'x': 3 values from 1.0 to 0.0"),
        (lambda plan: [plan.variable("x", 3, 0.0, 1.0), plan.variable("x", 3, 0.0, 1.0)], "one of this name already"),
        (lambda plan: plan.equal(plan.u[:, :5] - plan.T_zone_C), "dimension|Dimension"),
    ],
)
def test_nonsense_is_refused_when_the_controller_is_built(term, message):
    with pytest.raises(ControllerConfigError, match=message) as refused:
        plan([term])
    assert "test_terms_of_the_user.py" in str(refused.value)


@pytest.mark.parametrize(
    ("text", "where", "message"),
    [
        (RAMP, "my_terms.py", "expected path/to/file.py:name"),
        (RAMP, "my_terms.txt:ramp", "expected path/to/file.py:name"),
        (RAMP, "others.py:ramp", "'others.py:ramp': no such file in "),
        (RAMP, "my_terms.py:rampe", "has no 'rampe'; it has"),
        ("def ramp(:", "my_terms.py:ramp", "raised SyntaxError"),
        ("raise SystemExit(3)", "my_terms.py:ramp", "raised SystemExit: 3"),
        ("def ramp(plan):\n    plan.add_cost(1 / 0)\n", "my_terms.py:ramp", "my_terms.py:ramp, line 2: ZeroDivision"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_the_key(text, where, message, tmp_path, monkeypatch):
    (tmp_path / "my_terms.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ControllerConfigError, match=message) as refused:
        plan(terms_=where)
    assert str(refused.value).startswith("controller.options.terms: ")


def test_a_file_that_was_changed_is_read_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "limit.py").write_text("def most(plan):\n    plan.require(0.5 - plan.u)\n")
    assert plan(terms_="limit.py:most").u.max() == pytest.approx(0.5, abs=1e-4)
    (tmp_path / "limit.py").write_text("def most(plan):\n    plan.require(0.25 + 0.05 - plan.u)\n")
    assert plan(terms_="limit.py:most").u.max() == pytest.approx(0.3, abs=1e-4)


def test_a_run_refuses_a_file_of_terms_before_the_building_is_probed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario(None, {"testcase": TESTCASE, "controller": {"options": {"terms": "none.py:ramp"}}})
    with pytest.raises(ControllerConfigError, match=r"controller\.options\.terms: 'none\.py:ramp': no such file"):
        check_contestants(Experiment.of(scenario))
