"""ThermoForceMPC on a house whose model is exact: it saves, it holds comfort, and it survives what goes wrong."""

from __future__ import annotations

import gc
import re
import threading
import weakref
from dataclasses import replace

import numpy as np
import pytest
from faults import ChangedResponse, ChangedSolver, shifted
from simple_house import OutdoorResponse, SimpleHouse, simple_model
from waiting import wait_for

from controllers import ThermoForceMPC
from controllers.checks import ControllerConfigError
from controllers.mpc.config import MPCConfig
from controllers.optimisation.solution import Solution
from controllers.registry import build_controller
from controllers.rules.thermostat import Thermostat
from thermoforce_mpc.data import HOUR_S, Observation, PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.machine.power import ReturnWater
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.testcases import load_testcase


def controller(free=None, changed=None, **options) -> ThermoForceMPC:
    """A controller; its solutions may be `changed(number of the solve, solution)`."""
    config = MPCConfig(**{"step_s": None, "horizon_h": 24.0, **options})
    solver = changed and ChangedSolver(config, changed)
    return ThermoForceMPC(simple_model(), config, free_response=free or OutdoorResponse(), solver=solver)


def observation(house: SimpleHouse | None = None) -> Observation:
    house = house or SimpleHouse()
    house.reset(10 * 86400.0, 2 * 86400.0)
    return Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S))


@pytest.mark.parametrize("off_K", [59_574.0, -80.0])
def test_a_plan_that_predicts_what_no_room_can_be_is_none(off_K):
    """ "59,574 K above the comfort band cannot be avoided" was a plan that was solved."""
    plan = controller(free=shifted(off_K), free_response={"substitutes": False}).plan(observation())
    assert plan.status.fallen_back
    assert plan.u.size == 0
    assert plan.blocks
    assert re.search("no plan can be right that predicts .* h ahead .*beyond -30 to 60 °C", plan.why)


def test_a_model_whose_heat_cannot_be_is_refused():
    zone = simple_model().only
    strong = ThermalModel.of_zone(replace(zone, operator=replace(zone.operator, gains=1e6 * zone.operator.gains)))
    with pytest.raises(ControllerConfigError, match=r"the model of .* cannot be right: 8 h at full level change"):
        ThermoForceMPC(strong, MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())


@pytest.mark.slow
def test_in_closed_loop_it_is_comfortable_and_cheaper_than_the_thermostat():
    house = SimpleHouse()
    ours = run_closed_loop(house, controller(), house.period("x"))
    theirs = run_closed_loop(house, Thermostat(), house.period("x"))
    assert ours.kpis["tdis_tot"] < 0.3
    assert ours.kpis["cost_tot"] < 0.98 * theirs.kpis["cost_tot"]
    assert {name: n for name, n in ours.fallback_levels().items() if n} == {"solved": 48}


def test_predictions_of_an_exact_model_come_true():
    house = SimpleHouse()
    result = run_closed_loop(house, controller(comfort_margin_K=0.0), house.period("x"))
    actual = np.array([step.T_zone_C[0] for step in result.steps[1:]])
    predicted = np.array([step.plan.T_zone_C[0, 0] for step in result.steps[:-1]])
    owed = np.array(
        [step.plan.u[0, 0] - np.mean([s.u_measured[0] for s in step.samples]) for step in result.steps[:-1]]
    )
    # What is left is the share that five-minute blocks could not realise, and where in the hour it was put.
    assert np.abs(actual - predicted).max() < 0.9 * np.abs(owed).max() + 0.05


def test_a_controller_that_is_let_go_leaves_no_thread_behind():
    before = set(threading.enumerate())  # those of other tests may end meanwhile
    gc.collect()
    gc.disable()  # so that only what nothing refers to any more is freed
    try:
        mpc = controller()
        mpc.plan(observation())
        its = set(threading.enumerate()) - before
        assert its
        kept = weakref.ref(mpc)
        del mpc
        assert kept() is None
    finally:
        gc.enable()
    wait_for("its threads end", lambda: not any(thread.is_alive() for thread in its))


@pytest.mark.parametrize("solver", ["ipopt", "qp"])
@pytest.mark.parametrize("mode", ["duty", "modulating"])
def test_every_plan_is_finite_inside_limits_and_one_step_long(solver, mode):
    if mode == "modulating":
        model = simple_model()
        load = replace(model.only.power.load, lowest_level=0.3)
        mpc = ThermoForceMPC(
            replace(model, power=(replace(model.only.power, load=load),)),
            MPCConfig(step_s=None, solver=solver, actuation={"mode": mode}, horizon_h=24),
            free_response=OutdoorResponse(),
        )
    else:
        mpc = controller(solver=solver)
    plan = mpc.plan(observation())
    assert plan.status is PlanStatus.SOLVED
    assert sum(block.duration_s for block in plan.blocks) == HOUR_S
    assert all(0.0 <= block.u[0] <= 1.0 for block in plan.blocks)
    assert np.isfinite(plan.T_zone_C).all()
    assert plan.why


def failing(steps: set[int]) -> ThermoForceMPC:
    """A controller whose solver fails in some steps."""
    failed = Solution(False, np.empty(0), "Restoration_Failed", 7, "Ipopt ended with Restoration_Failed")
    return controller(changed=lambda n, found: failed if n in steps else found)


def test_failed_solves_go_down_the_ladder_and_are_counted_and_explained():
    house, mpc = SimpleHouse(), failing(set(range(10, 16)))
    result = run_closed_loop(house, mpc, house.period("x"))
    status = [step.plan.status for step in result.steps]
    assert status[10:16] == [PlanStatus.SHIFTED] * 3 + [PlanStatus.THERMOSTAT] * 3
    assert set(status[:10] + status[16:]) == {PlanStatus.SOLVED}
    assert "Restoration_Failed" in result.steps[10].plan.why
    assert result.steps[10].plan.solver_status == "Restoration_Failed"
    assert result.kpis["tdis_tot"] < 1.0


def test_the_shifted_plan_is_dropped_when_the_zone_is_not_where_it_was_predicted():
    mpc = failing({1})
    state = mpc.plan(observation()).state
    later = observation(SimpleHouse(T_start_C=12.0))
    later = Observation(
        replace(later.history, time_s=later.history.time_s + HOUR_S),
        replace(later.boundary, time_s=later.boundary.time_s + HOUR_S),
    )
    plan = mpc.plan(later, state)
    assert plan.status is PlanStatus.THERMOSTAT
    assert [block.u for block in plan.blocks] == [(1.0,)], "the zone is cold"


def _raise(error):
    raise error


broken = pytest.mark.parametrize(
    "action",
    [
        lambda f: _raise(DataError("no weather")),
        lambda f: _raise(RuntimeError("tensor trouble")),
        lambda f: replace(f, quantiles_C=f.quantiles_C * np.nan),
        lambda f: replace(f, quantiles_C=f.quantiles_C[:, :3]),
        lambda f: None,
        lambda f: replace(f, quantiles_C=f.quantiles_C + np.array([[np.nan], [0.0], [0.0]])),
        lambda f: _raise(KeyError("sun")),
        lambda f: _raise(AttributeError("no such thing")),
        lambda f: _raise(MemoryError()),
    ],
    ids=["refused", "crashed", "not finite", "too short", "none", "a quantile", "key", "attribute", "memory"],
)


@broken
def test_a_broken_forecast_is_replaced_by_the_weather_models_with_a_reason(action):
    plan = controller(free=ChangedResponse(lambda n, found: action(found))).plan(observation())
    assert plan.status is PlanStatus.BRIDGED
    assert "free forecast by linear_weather instead (" in plan.why
    assert np.isfinite(plan.T_zone_C).all()


@broken
def test_a_broken_forecast_without_a_substitute_falls_back_with_a_reason(action):
    plan = controller(free=ChangedResponse(lambda n, found: action(found)), free_response={"substitutes": False}).plan(
        observation()
    )
    assert plan.status is PlanStatus.THERMOSTAT
    assert plan.why.startswith("no prediction (")
    assert plan.blocks[0].u in ((0.0,), (1.0,))


def test_a_solver_that_raises_is_a_failed_solve():
    plan = controller(changed=lambda n, found: _raise(KeyError("no such status"))).plan(observation())
    assert plan.status is PlanStatus.THERMOSTAT
    assert plan.why.startswith("the solver failed (KeyError: 'no such status')")


def test_mistakes_of_the_caller_raise_before_anything_else():
    seen, mpc = observation(), controller(free=ChangedResponse(lambda n, found: _raise(AssertionError("too late"))))
    with pytest.raises(DataError, match=r"boundary forecast has 23 steps, the horizon needs 24 of 3600 s"):
        mpc.plan(Observation(seen.history, seen.boundary.head(23)))
    old = replace(seen.boundary, time_s=seen.boundary.time_s - 6 * HOUR_S)
    with pytest.raises(DataError, match=r"begins at 842400\.0, 21600 s before now, .* the history, 864000\.0: give"):
        mpc.plan(Observation(seen.history, old))
    quarter = SimpleHouse()
    quarter.reset(10 * 86400.0, 2 * 86400.0)
    with pytest.raises(DataError, match=r"boundary forecast: step 0 of 24 is 900 s long, expected 3600 s"):
        mpc.plan(Observation(seen.history, quarter.forecast(24 * HOUR_S, 900.0)))
    fine = replace(seen.history, time_s=seen.history.time_s[-1] + 900.0 * np.arange(-seen.history.n_steps, 1))
    with pytest.raises(DataError, match=r"history: step 0 of 48 is 900 s long, expected 3600 s, the .*step_s=900"):
        mpc.plan(Observation(fine, seen.boundary))
    with pytest.raises(DataError, match=r"history: step 0 of 48 is 900 s long"):  # not the forecast, which is short too
        mpc.plan(Observation(fine, seen.boundary.head(23)))


@pytest.mark.slow
def test_the_class_without_a_configuration_is_the_controller_of_the_command_line():
    testcase = load_testcase("bestest_hydronic_heat_pump")
    ours = ThermoForceMPC(simple_model(), free_response=OutdoorResponse())
    theirs = build_controller("thermoforce_mpc", {}, testcase, simple_model())
    assert ours.config == theirs.config
    assert (ours.name, ours.step_s, ours.horizon_s) == (theirs.name, theirs.step_s, theirs.horizon_s)
    assert ours.step_s == 900.0


def test_a_silent_sensor_is_survived_without_inventing_a_temperature():
    seen = observation()
    silent = replace(seen.history, T_zone_C=np.append(seen.history.T_zone_C[0, :-1], np.nan))
    mpc = controller()
    plan = mpc.plan(Observation(silent, seen.boundary))
    (level,) = plan.blocks[0].u
    assert level is None or 0.0 <= level <= 1.0
    assert plan.why


def test_a_horizon_shorter_than_a_step_is_refused_with_advice():
    with pytest.raises(ControllerConfigError, match=r"horizon_h: 0\.25 h is shorter than one control step"):
        controller(horizon_h=0.25)


def test_a_model_without_power_is_refused():
    with pytest.raises(ControllerConfigError, match="without measured power"):
        ThermoForceMPC(replace(simple_model(), power=(None,)), free_response=OutdoorResponse())


def test_same_observation_same_plan():
    a, b = controller().plan(observation()), controller().plan(observation())
    assert a.blocks == b.blocks
    np.testing.assert_array_equal(a.u, b.u)


@pytest.mark.parametrize(("sign", "inside"), [(1, (0.22, 0.17)), (-1, (0.17, 0.22))])
def test_comfort_is_planned_for_quantiles_and_the_side_that_acting_keeps_has_its_own(sign, inside, monkeypatch):
    monkeypatch.setattr(MPCConfig, "backoff_violation_K", 9.0)
    zone = simple_model().only
    model = ThermalModel.of_zone(
        replace(zone, operator=replace(zone.operator, gains=sign * zone.operator.gains, sign=sign))
    )
    # Discomfort that counts next to nothing counts five times the heat: the other level is a fifth.
    options = {"backoff_level": 0.1, "objective": {"comfort_weight_per_m2": 1e-6}}
    # A heated house under a model that cools: the weather model would not believe this forecast.
    config = MPCConfig(step_s=None, horizon_h=24.0, free_response={"substitutes": False}, **options)
    mpc = ThermoForceMPC(model, config, free_response=OutdoorResponse())
    seen = observation()
    problem = mpc.instance(mpc.predictor.context(seen), seen.history)
    np.testing.assert_allclose(problem.lower_C - seen.boundary.lower_C[:, 1:], inside[0], atol=1e-9)
    np.testing.assert_allclose(seen.boundary.upper_C[:, 1:] - problem.upper_C, inside[1], atol=1e-9)


def test_power_stays_below_a_cap_whose_excess_is_dear():
    free = controller().plan(observation())
    dear = {"power_cap_kW": 0.4e-3 * free.power_W.max(), "power_cap_price_per_kWh": 1e3}
    capped = controller(objective=dear).plan(observation())
    assert {free.status, capped.status} == {PlanStatus.SOLVED}
    assert capped.power_W.max() <= 0.401 * free.power_W.max()


def test_planned_power_follows_the_return_water_expected_over_the_zone():
    model = simple_model()
    water = ReturnWater(0.01, reference_C=30.0, range_C=(0.0, 60.0), above_zone_K=9.0)
    powered = replace(model, power=(replace(model.only.power, water=water),))
    seen = observation()
    history = replace(seen.history, T_return_C=seen.history.T_zone_C[:, :-1] + 5.0)
    plain = controller().plan(seen)
    mpc = ThermoForceMPC(powered, MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    context = mpc.predictor.context(seen)
    problem = mpc.instance(context, history)
    zone = np.clip(context.free.median_C[0], seen.boundary.lower_C[0, 1:], seen.boundary.upper_C[0, 1:])
    above = 5.0 if (history.u > 0.02).any() else 9.0
    expected = model.only.power.parts(seen.boundary.T_out_C[:-1])[1] * (1 + 0.01 * (zone + above - 30.0))
    np.testing.assert_allclose(problem.power_per_u_W[0], expected)
    assert plain.status is PlanStatus.SOLVED
    assert mpc.plan(Observation(history, seen.boundary)).status is PlanStatus.SOLVED


def test_the_rules_levels_act_where_the_plans_own_model_prices_them_clearly_lower():
    """A solver whose checked levels leave the house cold, as one at a poor local optimum would."""

    def idle(number: int, solution: Solution) -> Solution:
        return replace(solution, u=np.zeros_like(solution.u))

    house = SimpleHouse()
    mpc, seen = controller(changed=idle), observation(house)
    plan = mpc.plan(seen)
    assert "the on/off rule's levels act: by the same model and prices they cost" in plan.why
    assert "discomfort" in plan.why
    assert plan.status is PlanStatus.ACCEPTABLE
    rule, _ = mpc.rules[0].rule(seen)
    assert rule == 1.0
    assert plan.u[0, 0] == rule
    assert plan.blocks[0].u == (rule,)
    quarter = replace(plan.state, ruled=False)
    assert quarter != plan.state, "it is looked at again in the next step, whatever its time"
    best = controller().plan(seen)
    assert "rule's levels" not in best.why
    assert not best.state.ruled
