"""The ladder: whatever solver, forecaster or the controller itself does, a checked action is applied and named."""

from __future__ import annotations

import threading
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from faults import ChangedResponse, ChangedSolver, FaultyHouse
from simple_house import OutdoorResponse, SimpleHouse, simple_model
from waiting import wait_for

from controllers import ThermoForceMPC
from controllers.mpc.config import DeadlineConfig, MPCConfig
from controllers.mpc.readings import ReadingsFilter
from controllers.mpc.state import MPCState
from controllers.optimisation.solution import Solution
from controllers.optimisation.solvers.qp import Piqp, QPConfig, QPSolver
from controllers.safety.fallback_policy import FallbackConfig
from thermoforce_mpc.data import HOUR_S, FreeForecast, Observation, Plan, PlanStatus
from thermoforce_mpc.loop.closed_loop import run_closed_loop

CONFIG = MPCConfig(step_s=None, horizon_h=24.0)
# Long enough for what does answer, on any machine.
SOON_S = 3.0


class Panic(BaseException):
    """As a compiled library raises it."""


def mpc(free=None, changed=lambda n, found: found, **options) -> ThermoForceMPC:
    """A controller whose solutions are `changed(number of the solve, solution)`."""
    config = MPCConfig(**{"step_s": None, "horizon_h": 24.0, **options})
    solver = ChangedSolver(config, changed)
    return ThermoForceMPC(simple_model(), config, free_response=free or OutdoorResponse(), solver=solver)


def observation() -> Observation:
    house = SimpleHouse()
    house.reset(10 * 86400.0, 2 * 86400.0)
    return Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S))


def raising(error: BaseException):
    raise error


def applied(plan: Plan) -> float:
    return sum(block.u[0] * block.duration_s for block in plan.blocks) / HOUR_S


@pytest.fixture
def released():
    event = threading.Event()
    yield event
    event.set()


@pytest.mark.parametrize(
    ("acts", "says"),
    [
        (lambda n, found: raising(KeyError("status")), "KeyError: 'status'"),
        (lambda n, found: raising(MemoryError("too much")), "MemoryError: too much"),
        (lambda n, found: raising(SystemExit(1)), "SystemExit"),
        (lambda n, found: raising(Panic("index out of bounds")), "Panic (index out of bounds)"),
        (lambda n, found: None, "AttributeError"),
        (lambda n, found: replace(found, u=found.u * np.nan), "levels that are not finite"),
        (lambda n, found: replace(found, u=found.u + 1.2), "leaves its bounds"),
        (lambda n, found: replace(found, u=-found.u - 0.1), "leaves its bounds"),
        (lambda n, found: replace(found, u=found.u[:, :5]), "levels of shape (1, 5), expected (1, 24)"),
        (lambda n, found: Solution(False, np.empty(0), "Infeasible", 3, "ended with Infeasible"), "Infeasible"),
    ],
    ids=["key", "memory", "exit", "panic", "nothing", "nan", "above", "below", "short", "status"],
)
def test_no_answer_of_a_solver_acts_unchecked(acts, says):
    plan = mpc(changed=acts).plan(observation())
    assert plan.status is PlanStatus.THERMOSTAT
    assert plan.acting == (PlanStatus.THERMOSTAT,)
    assert says in plan.why
    assert "°C against" in plan.why
    assert all(u in (0.0, 1.0) for block in plan.blocks for u in block.u)


@pytest.mark.slow
def test_a_solver_that_hangs_is_left_behind_within_its_time_and_another_one_takes_over(released, monkeypatch):
    monkeypatch.setattr(DeadlineConfig, "solve_s", SOON_S)
    hanging = lambda n, found: found if n else released.wait(30.0)  # noqa: E731
    controller = mpc(changed=hanging)
    seen = observation()
    plan = controller.plan(seen)
    assert plan.status is PlanStatus.THERMOSTAT
    assert "the solver failed (no answer within 3 s)" in plan.why
    assert controller.plan(seen, plan.state).status is PlanStatus.SOLVED


@pytest.mark.slow
def test_a_forecaster_that_hangs_is_replaced_within_its_time_until_it_returns(released):
    hanging = ChangedResponse(lambda n, found: found if n else released.wait(30.0) and found)
    controller = mpc(hanging, deadline={"forecast_s": SOON_S})
    seen = observation()
    first = controller.plan(seen)
    assert first.status is PlanStatus.BRIDGED
    assert "free forecast by linear_weather instead (no answer within" in first.why
    second = controller.plan(seen, first.state)
    assert second.status is PlanStatus.BRIDGED
    assert "has not returned" in second.why
    released.set()
    solved = lambda: controller.plan(seen, second.state).status is PlanStatus.SOLVED  # noqa: E731
    wait_for("the forecaster is asked again", solved)


def test_it_ends_in_time_without_substitutes_too(released):
    controller = mpc(
        ChangedResponse(lambda n, found: released.wait(30.0)),
        deadline={"forecast_s": 0.3},
        free_response={"substitutes": False},
    )
    plan = controller.plan(observation())
    assert plan.status is PlanStatus.THERMOSTAT
    assert plan.why.startswith("no prediction (no answer within")


@pytest.mark.parametrize("error", [Panic("thread panicked"), SystemExit(2), RecursionError()])
def test_a_forecaster_may_raise_anything(error):
    plan = mpc(ChangedResponse(lambda n, found: raising(error))).plan(observation())
    assert plan.status is PlanStatus.BRIDGED
    assert type(error).__name__ in plan.why
    assert np.isfinite(plan.T_zone_C).all()


@pytest.mark.slow
def test_a_forecast_that_is_absurd_for_good_costs_no_comfort():
    def absurd(n: int, found: FreeForecast) -> FreeForecast:
        return replace(found, quantiles_C=found.quantiles_C * 0.0 - 50.0 + found.levels[:, None])

    house = SimpleHouse()
    result = run_closed_loop(house, mpc(ChangedResponse(absurd)), house.period("x"))
    assert {step.plan.status for step in result.steps} == {PlanStatus.BRIDGED}
    assert all("to -49.5 °C" in step.plan.why for step in result.steps)
    assert result.kpis["tdis_tot"] < 1.0
    believed = run_closed_loop(
        house, mpc(ChangedResponse(absurd), free_response={"substitutes": False}), house.period("x")
    )
    assert believed.kpis["cost_tot"] > 1.2 * result.kpis["cost_tot"], "it would be heated for the cold that never comes"


def ended_early(solution_of):
    """A back end that ends at its iteration limit with `solution_of(its answer)`."""
    return lambda inner: lambda data: replace(solution_of(inner(data)), solved=False, status="max_iterations")


def test_levels_of_a_solver_that_stopped_early_act_where_they_cost_no_more_than_what_else_there_is():
    config = QPConfig()

    def planned(acts) -> Plan:
        def solver(operator, shape):
            return QPSolver(operator, shape, config, None, acts(Piqp(config)))

        return ThermoForceMPC(simple_model(), CONFIG, free_response=OutdoorResponse(), solver=solver).plan(
            observation()
        )

    optimal = mpc().plan(observation())
    plan = planned(ended_early(lambda found: found))
    assert plan.status is PlanStatus.ACCEPTABLE
    assert "max_iterations" in plan.why
    np.testing.assert_allclose(plan.u, optimal.u, atol=1e-4)
    # Half the heat in the cold: dearer than to heat all the time.
    plan = planned(ended_early(lambda found: replace(found, x=found.x * 0.02)))
    assert plan.status is PlanStatus.THERMOSTAT
    assert "dearer than without it" in plan.why
    plan = planned(ended_early(lambda found: replace(found, x=found.x * np.nan)))
    assert plan.status is PlanStatus.THERMOSTAT


@pytest.mark.slow
def test_the_ladder_is_climbed_down_and_up_again_and_each_level_is_named():
    controller = mpc(changed=lambda n, found: raising(RuntimeError("broken")) if 10 <= n < 20 else found)
    house = SimpleHouse()
    result = run_closed_loop(house, controller, house.period("x"))
    status = [step.plan.status for step in result.steps]
    assert status[10:20] == [PlanStatus.SHIFTED] * 3 + [PlanStatus.THERMOSTAT] * 7
    assert set(status[:10] + status[20:]) == {PlanStatus.SOLVED}
    assert "following the previous plan" in result.steps[10].plan.why
    assert isinstance(result.state, MPCState)
    assert result.state.failures == 0
    assert result.kpis["tdis_tot"] < 2.0


def test_after_failures_on_end_it_starts_without_what_it_kept(monkeypatch):
    kept = []

    class Following(ChangedResponse):
        def follow(self, free_C, history, boundary, state):
            kept.append(state)
            return self.forecast(free_C, history, boundary), len(kept)

    broken = lambda n, found: raising(RuntimeError("broken")) if n in (1, 2) else found  # noqa: E731
    monkeypatch.setattr(FallbackConfig, "cold_after", 2)
    controller = mpc(Following(lambda n, found: found), broken)
    state, seen = None, observation()
    for _ in range(5):
        state = controller.plan(seen, state).state
    assert [item is None for item in kept] == [True, False, False, True, False]


def test_an_error_of_the_controller_itself_releases_the_building(monkeypatch):
    monkeypatch.setattr(ReadingsFilter, "clean", lambda *given, **options: raising(ZeroDivisionError("a defect")))
    plan = mpc().plan(observation())
    assert plan.status is PlanStatus.NATIVE
    assert plan.why == "no decision was made (ZeroDivisionError: a defect): native control"
    assert [block.u for block in plan.blocks] == [(None,)]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_minimum_times_hold_over_all_levels_and_every_action_is_inside_limits(seed):
    rng = np.random.default_rng(seed)

    def broken(n, found):
        return rng.choice(
            [
                lambda: found,
                lambda: raising(RuntimeError("broken")),
                lambda: replace(found, u=found.u * np.nan),
                lambda: replace(found, u=rng.random(found.u.shape)),
                lambda: replace(found, optimal=False, problem="stopped"),
            ]
        )()

    def noisy(house, seen):
        return replace(seen, T_zone_C=seen.T_zone_C + rng.choice([0.0, 0.0, 0.0, np.nan, 3.0, -300.0]))

    controller = mpc(
        ChangedResponse(lambda n, found: found if rng.random() < 0.7 else raising(ValueError("broken"))),
        broken,
        actuation={"mode": "duty", "min_on_s": 900.0, "min_off_s": 900.0},
        fallback={"stand_back": "rule"},
    )
    house = FaultyHouse(noisy)
    result = run_closed_loop(house, controller, house.period("x"))
    found = {step.plan.status for step in result.steps}
    assert len(found) >= 4, found
    assert not any(step.refused for step in result.steps)
    blocks = [(sample.u_applied[0], sample.duration_s) for sample in result.samples]
    assert all(u is None or 0.0 <= u <= 1.0 for u, _ in blocks)
    runs = groupby(blocks, key=lambda block: None if block[0] is None else block[0] > 0)
    spells = [(on, sum(seconds for _, seconds in some)) for on, some in runs]
    for before, (on, seconds), after in zip(spells, spells[1:], spells[2:], strict=False):
        if None not in (before[0], on, after[0]):
            assert seconds >= 900.0 - 1e-6, "a machine that was switched stays so for its minimum time"
