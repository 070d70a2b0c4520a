"""The record of a run says who planned how often, what was solved, and how many of the operator's parameters it had."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from controllers.mpc.readings import ReadingsFilter
from controllers.optimisation.solution import Solution, failed
from controllers.optimisation.solvers.qp import QPSolver
from controllers.rules.thermostat import Thermostat
from thermoforce_mpc.data.plan import NOT_ECONOMICAL
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.report.findings import planning_of

RNG = np.random.default_rng(2)


def networked(*, feedback: bool = False):
    """The simple house's model with a network that is kept: 195 parameters."""
    model = simple_model()
    pair = model.operator.of_actuator(0)
    pair = replace(
        pair,
        hidden_weight=0.1 * RNG.standard_normal(pair.hidden_weight.shape),
        output_weight=0.01 * RNG.standard_normal(pair.output_weight.shape),
        feature_mean=np.array([15.0, 3.0, 0.0, 0.0]),
        feature_scale=np.array([5.0, 5.0, 100.0, 1.0]),
        feedback=feedback,
    )
    return replace(model, operator=single(pair))


def closed_loop(model, build=None, **options) -> RunResult:
    house = SimpleHouse()
    config = MPCConfig(step_s=None, horizon_h=24.0, **options)
    mpc = ThermoForceMPC(model, config, free_response=OutdoorResponse(), solver=build)
    return run_closed_loop(house, mpc, replace(house.period("x"), scored_s=12 * 3600.0))


@pytest.mark.parametrize(
    ("solver", "words", "feedback"),
    [
        ("auto", "nonlinear programmes by Ipopt", False),
        ("qp", "quadratic programmes by PIQP", False),
        ("sqp", "nonlinear programmes by SQP", True),
    ],
)
def test_every_plan_counts_once_and_says_what_was_solved(solver, words, feedback):
    model = networked(feedback=feedback)
    counts = planning_of(closed_loop(model, solver=solver), model)
    assert counts.in_words().startswith(
        f"solved 12 {words}, {counts.variables} variables, 195 parameters of the operator in each"
    )
    assert (counts.steps, counts.failed) == (12, 0)
    assert counts.variables >= 4 * 12, "level, response, below and above of each step"


def test_a_network_that_was_not_kept_is_not_said_to_be_used():
    model = simple_model()
    assert planning_of(closed_loop(model), model).in_words().endswith("2 parameters of the operator in each")


def test_solvers_that_took_turns_and_solves_that_failed_are_told_apart():
    class Turns:
        """Fails once, solves four times under another name, then as it is."""

        solves = 0

        def __init__(self, operator, shape):
            self._solver = QPSolver(operator, shape, MPCConfig().qp)

        def solve(self, problem, guess=None) -> Solution:
            self.solves += 1
            if self.solves == 1:
                return failed("ipopt:Infeasible_Problem_Detected", 3, "Ipopt ended with Infeasible_Problem_Detected")
            solution = self._solver.solve(problem, guess)
            return solution if self.solves > 5 else replace(solution, status="ipopt:Solve_Succeeded")

    model = networked()
    counts = planning_of(closed_loop(model, Turns), model)
    assert counts.plans == {"piqp": 7, "ipopt": 4}
    assert counts.in_words() == (
        f"solved 7 quadratic programmes by PIQP and 4 nonlinear programmes by Ipopt, {counts.variables} variables, 195 "
        "parameters of the operator in each; 1 solve without a plan"
    )


def accepting(run: RunResult, plans: int, beyond_K: float = 0.2) -> RunResult:
    """The run whose plans leave the band by `beyond_K`; the last ones accept what heat would avoid, others cannot."""
    whys = ["0.2 K below the comfort band cannot be avoided at full level"] * len(run.steps)
    whys[len(run.steps) - plans :] = [f"0.2 K below the comfort band {NOT_ECONOMICAL} in 1 h"] * plans
    steps = []
    for step, why in zip(run.steps, whys, strict=True):
        T_free_C = step.plan.T_free_C.copy()
        T_free_C[:, 0] = step.boundary.lower_C[:, 1] - beyond_K - step.plan.T_forced_K[:, 0]
        steps.append(replace(step, plan=replace(step.plan, why=why, T_free_C=T_free_C)))
    return replace(run, steps=steps)


def test_discomfort_that_plans_accept_is_told():
    model, found = simple_model(), closed_loop(simple_model())
    told, quiet = (planning_of(accepting(found, plans), model) for plans in (3, 0))
    assert (told.uncomfortable, quiet.uncomfortable) == (3, 0)
    assert told.in_words().endswith(
        "; in 25 % of the steps discomfort in the next 6 h cannot be avoided economically "
        "(controller.options.objective.comfort_weight_per_m2)"
    )
    assert "discomfort" not in quiet.in_words()
    assert told.to_json()["uncomfortable"] == 3
    margins = planning_of(accepting(found, 3, beyond_K=0.0), model)
    assert margins.uncomfortable == 0, "the band is kept, only a margin is not"


def test_a_hundredth_of_the_steps_is_not_worth_telling():
    some = replace(planning_of(closed_loop(simple_model()), None), steps=200)
    assert "discomfort" not in replace(some, uncomfortable=2).in_words()
    assert "in 2 % of the steps discomfort" in replace(some, uncomfortable=3).in_words()


def test_steps_without_a_decision_are_told_in_capitals(monkeypatch):
    clean, calls = ReadingsFilter.clean, []

    def sometimes(self, *given, **options):
        calls.append(given)
        if len(calls) <= 3:
            raise ZeroDivisionError("a defect")
        return clean(self, *given, **options)

    monkeypatch.setattr(ReadingsFilter, "clean", sometimes)
    model = simple_model()
    counts = planning_of(closed_loop(model), model)
    assert (counts.undecided, counts.plans, counts.failed) == (3, {"ipopt": 9}, 0)
    assert counts.in_words().startswith(
        "NO DECISION WAS MADE IN 3 OF 12 STEPS, NATIVE CONTROL ACTED INSTEAD (ZeroDivisionError: a defect); solved 9 "
    )
    assert "DECISION" not in replace(counts, undecided=2).in_words()


def test_rules_plan_nothing():
    house = SimpleHouse()
    counts = planning_of(run_closed_loop(house, Thermostat(), house.period("x")), None)
    assert counts.in_words() == "nothing was planned"
    assert counts.to_json()["variables"] == 0
