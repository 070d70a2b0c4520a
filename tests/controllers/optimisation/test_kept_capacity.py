"""What plans leave unused of a shared machine's capacity, and what they may ask for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from faults import ChangedSolver
from mpc_problems import N, machinery_of, random_building, random_building_problem
from simple_house import OutdoorResponse
from two_houses import TwoHouses, two_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.mpc.margins import cool_emitters, learned_share
from thermoforce_mpc.data import HOUR_S, Observation, PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.heat_input import HeatInput

STEP_S = 900.0
FULL_W, MOST_W = np.array([1700.0, 420.0, 1200.0]), 2850.0
WARM = np.zeros(3, dtype=bool)


def learned(heat_W: list[float], u: list[float], before: float = 0.05, cool=WARM) -> float:
    expected_W = FULL_W * u
    load = float(expected_W.sum() / MOST_W)
    return learned_share(before, load, MOST_W, np.array(heat_W), expected_W, np.array(u), STEP_S, np.asarray(cool))


def test_it_grows_where_one_lacks_heat_at_the_limit_and_fades_where_none_does():
    levels = [1.0, 1.0, 0.6]
    assert learned([1850.0, 240.0, 740.0], levels) > 0.05, "what one takes too much another lacks"
    assert learned([1700.0, 410.0, 720.0], levels) < 0.05
    assert learned([1850.0, 0.0, 740.0], [1.0, 0.02, 0.6]) < 0.05, "a valve that is hardly open lacks nothing"


def test_warm_floors_that_take_less_are_no_limit():
    assert learned([1200.0, 300.0, 600.0], [1.0, 1.0, 0.6]) < 0.05


def test_a_cool_emitter_that_lacks_heat_shows_a_limit_below_the_capacity_of_the_record():
    """Probing in mild weather does not reach a machine's limit, which falls with the weather."""
    heat_W, levels = [1450.0, 210.0, 640.0], [1.0, 1.0, 0.6]
    assert learned(heat_W, levels, cool=[False, True, False]) > 0.05
    assert learned(heat_W, levels, cool=[True, False, True]) < 0.05, "the one that lacks is warm"


def test_emitters_are_cool_in_the_first_hour_of_their_valves_while_the_machine_ran_before():
    hour = np.ones(4)
    u = np.array([np.r_[0 * hour, 0 * hour, hour], np.r_[hour, hour, hour], np.r_[hour, 0 * hour, hour]])
    assert cool_emitters(u, STEP_S).tolist() == [True, False, True]
    assert cool_emitters(u[:, :9], STEP_S).tolist() == [True, False, True], "the second ran"
    assert not cool_emitters(u[[0, 2], :9], STEP_S).any(), "nothing ran: the water is to be warmed first"
    assert not cool_emitters(u[:, :1], STEP_S).any()


def test_nothing_is_learned_far_from_the_limit_or_without_a_meter():
    assert learned([850.0, 50.0, 0.0], [0.5, 1.0, 0.0]) == 0.05
    assert learned([1850.0, float("nan"), 740.0], [1.0, 1.0, 0.6]) == 0.05


def test_it_stays_between_nothing_and_a_quarter():
    kept = 0.0
    for _ in range(96):
        kept = learned_share(kept, 1.0, MOST_W, np.array([2750.0, 100.0]), FULL_W[:2], np.ones(2), STEP_S, WARM[:2])
    assert kept == 0.25
    assert learned([1700.0, 420.0, 720.0], [1.0, 1.0, 0.6], before=0.0) == 0.0, "not below nothing"


def test_a_machine_that_gives_more_than_was_seen_has_more():
    """Probing in mild weather does not reach a machine's limit."""
    more = learned([2400.0, 600.0, 1100.0], [0.5, 0.5, 0.5], before=0.0)
    assert -0.45 < more < -0.2
    assert learned([2400.0, 600.0, 1100.0], [0.5, 0.5, 0.5], before=more) < more, "half of it a step"
    assert learned([1700.0, 420.0, 720.0], [1.0, 1.0, 0.6], before=more) == more, "less is no limit"


def test_a_machine_that_had_more_is_at_its_limit_only_near_that():
    """One that gave a tenth more than was seen: at 0.97 of what was seen it is not at its limit, at 1.07 it is."""
    levels = [1.0, 1.0, 0.6]
    assert learned([2300.0, 240.0, 220.0], levels, before=-0.1) == -0.1
    assert learned([2300.0, 240.0, 510.0], levels, before=-0.1) > -0.1


def test_a_capacity_of_another_shape_is_refused():
    rng = np.random.default_rng(3)
    operator = random_building(rng, 2, (1, 1))
    problem = random_building_problem(rng, operator, machinery_of(operator, (0, 0), share=np.array([0.9, 0.8])))
    with pytest.raises(DataError, match="capacity has shape"):
        replace(problem, capacity=np.ones(N))


def metered(changed=lambda n, found: found) -> ThermoForceMPC:
    """Control of two houses on one machine that cannot feed both at full level; their heat falls with T_out."""
    model = two_model(shared=True)
    heat = HeatInput(heat=MachineLoad((0.0, 0.0, 5000.0, -100.0), (-20.0, 20.0)))
    operator = model.operator.map(lambda pair: replace(pair, heat_input=heat))
    config = MPCConfig(step_s=None, horizon_h=24.0)
    shares = (0.8, 0.6)
    solver, model = ChangedSolver(config, changed), replace(model, operator=operator, shares=shares)
    return ThermoForceMPC(model, config, free_response=OutdoorResponse(), solver=solver)


def seen(plant: TwoHouses, mpc: ThermoForceMPC, levels: list[float], heat_W: list[float]) -> Observation:
    """The plant now, after a last step with these levels and this heat."""
    parts = [house.past(HOUR_S) for house in plant.houses]
    rows = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ("T_zone_C", "u", "heat_W")}
    rows["u"][:, -1], rows["heat_W"][:, -1] = levels, heat_W
    rows["power_W"] = sum(part.power_W for part in parts)
    rows["T_return_C"] = parts[0].T_return_C
    past = replace(parts[0], **rows, names=plant.names)
    return Observation(past, plant.forecast(mpc.horizon_s, HOUR_S))


def test_the_limit_follows_the_outdoor_temperature_and_what_was_lacking():
    plant, mpc = TwoHouses(shared=True), metered()
    plant.reset(10 * 86400.0, 2 * 86400.0)
    first = mpc.plan(seen(plant, mpc, [0.5, 0.5], [2500.0, 2500.0]))
    assert first.state.margins.unused.tolist() == [0.0]
    plant.advance([1.0, 0.4], HOUR_S)
    # The capacity is 5000 W / 0.8 at 0 °C in one house and 5000 W / 0.6 in the other; all of their mean is given.
    T_C = float(plant.houses[0].past(HOUR_S).T_out_C[-2])
    full_W, most_W = 5000.0 - 100.0 * T_C, (5000.0 / 0.8 + 5000.0 / 0.6) / 2
    lacking = [most_W - 0.5 * 0.7 * full_W, 0.5 * 0.7 * full_W]
    observation = seen(plant, mpc, [1.0, 0.7], lacking)
    limited = mpc.plan(observation, first.state)
    kept = limited.state.margins.unused
    assert kept.tolist() == pytest.approx([0.12])
    assert limited.news == "boiler: it did not give all that was asked for at its limit: plans leave 12 % of it unused"
    enough = [0.9 * most_W - 0.5 * full_W, 0.5 * full_W]
    whole = mpc.plan(seen(plant, mpc, [1.0, 0.6], enough), first.state)
    assert whole.state.margins.unused.tolist() == [0.0]
    assert whole.news == "", "nothing began, nothing ended"

    context = mpc.predictor.context(observation)
    problem = mpc.instance(context, observation.history, replace(first.state.margins, unused=kept))
    ahead_C = observation.boundary.T_out_C[:-1]
    np.testing.assert_allclose(problem.capacity[0], 0.88 / (1.0 - ahead_C / 50.0), rtol=1e-9)


@pytest.mark.parametrize(
    ("before", "given", "said"),
    [
        (0.01, 0.9, "boiler: it gives what is asked for again: plans count on all of it"),
        (0.05, 0.9, ""),
        (0.0, 1.2, "boiler: it gave 10 % more than the capacity of the record: plans count on that"),
        (-0.1, 1.2, ""),
    ],
)
def test_a_limit_that_ends_and_more_than_was_seen_are_said_when_they_do(before, given, said):
    plant, mpc = TwoHouses(shared=True), metered()
    plant.reset(10 * 86400.0, 2 * 86400.0)
    first = mpc.plan(seen(plant, mpc, [0.5, 0.5], [2500.0, 2500.0])).state
    first = replace(first, margins=replace(first.margins, unused=np.array([before])))
    plant.advance([1.0, 0.4], HOUR_S)
    full_W = 5000.0 - 100.0 * float(plant.houses[0].past(HOUR_S).T_out_C[-2])
    most_W = (5000.0 / 0.8 + 5000.0 / 0.6) / 2
    heat_W = [given * most_W - 0.5 * full_W, 0.5 * full_W]
    assert mpc.plan(seen(plant, mpc, [1.0, 0.6], heat_W), first).news == said


def test_a_plan_for_more_than_the_machine_gives_is_not_followed_whatever_solver_it_is_from():
    plant, mpc = TwoHouses(shared=True), metered(lambda n, found: replace(found, u=np.ones_like(found.u)))
    plant.reset(10 * 86400.0, 2 * 86400.0)
    plan = mpc.plan(seen(plant, mpc, [0.5, 0.5], [2500.0, 2500.0]))
    assert plan.status is PlanStatus.THERMOSTAT
    assert "more than the capacity of boiler" in plan.why
