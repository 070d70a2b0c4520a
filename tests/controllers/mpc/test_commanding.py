"""Plans in commands: levels within what commands bring, zones that are left alone, and energy by what rooms ask for."""

from __future__ import annotations

from dataclasses import replace
from statistics import NormalDist
from types import SimpleNamespace

import numpy as np
import pytest
from home_by_curve import ROOMS, RULES, HomeByCurve, curve_model

from controllers.actuation.actuator import ActuationState
from controllers.mpc.commands.commanding import BuildingCommands
from controllers.mpc.commands.following import tank_first
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from controllers.optimisation.problem import Exchange, PowerCap, ProblemShape, every_step
from controllers.optimisation.solvers.qp import QPConfig, QPSolver
from thermoforce_mpc.commands.contacts import SGReady
from thermoforce_mpc.commands.heating_curve import CurveOffset
from thermoforce_mpc.commands.meter import MeterEffect
from thermoforce_mpc.data import HOUR_S, Observation
from thermoforce_mpc.measurements.forecast import read_forecast
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.model.card import MOST_ERROR_K
from thermoforce_mpc.model.machine.change import weight_of_demand
from thermoforce_mpc.model.operator.parameters import ZONE

LIVING, BEDROOM = range(2)
STATES = [ActuationState()] * 2


@pytest.fixture(scope="module")
def home():
    return HomeByCurve()


@pytest.fixture(scope="module")
def parts(home):
    """The commands as if each room had its own, its boundary, the problem of a plan, and its controller."""
    return parts_of(home, range(2))


def parts_of(home, commanded):
    measured = read_measurements(home.measurements(), RULES, step_s=HOUR_S).served()
    learned, model = learned_commands(measured), curve_model(home)
    options = {"step_s": HOUR_S, "horizon_h": 24.0, "free_response": {"name": "persistence"}}
    mpc = ThermoForceMPC(model, MPCConfig.model_validate(options), commands=learned)
    seen = Observation(measured.record, read_forecast(home.forecast(), measured).head(24))
    context = mpc.predictor.context(seen)
    own = {a: replace(learned[ROOMS[a]], machine="") for a in commanded}
    commands = BuildingCommands(measured.layout, own, model.cards, {})
    return commands, context.boundary, mpc.instance(context, seen.history), mpc


def commands_of(home):
    return learned_commands(read_measurements(home.measurements(), RULES, step_s=HOUR_S).served())


def begun(parts, left_alone=(), unknown=(), **changes):
    """Of a problem with `changes`; the person's bounds are the problem's."""
    commands, boundary, problem, mpc = parts
    problem = replace(problem, **changes)
    boundary = asked(boundary, problem.lower_C, problem.upper_C)
    return commands.begin(mpc.planning_operator, mpc.evaluator, problem, boundary, left_alone, None, STATES, unknown)


def asked(boundary, lower_C, upper_C):
    """With bounds (Z, N) of the ends of steps, °C."""
    lower_C, upper_C = (np.column_stack([one[:, :1], one]) for one in (lower_C, upper_C))
    return replace(boundary, lower_C=lower_C, upper_C=upper_C)


def brought(parts, u):
    """Temperatures at the ends of steps under levels, (Z, N), °C."""
    _, _, problem, mpc = parts
    return problem.T_free_C + mpc.evaluator.brings(problem, u).forced_K


@pytest.mark.slow
def test_what_is_left_alone_has_its_usual_levels_and_its_zone_is_asked_no_more(parts):
    """The other one, which follows the plan, is asked for its comfort though left alone it would miss it."""
    problem, left = parts[2], begun(parts, [LIVING])
    usual_u = left.without.realise(np.zeros((2, problem.n_steps))).u
    alone_C = brought(parts, usual_u)
    too_much = {"lower_C": alone_C + 0.5, "upper_C": alone_C + 1.0}
    within = begun(parts, [LIVING], **too_much).within_reach(None)
    for levels in (within.least_u, within.most_u):
        np.testing.assert_allclose(levels[LIVING], usual_u[LIVING], atol=1e-6)
    np.testing.assert_allclose(within.lower_C[LIVING], alone_C[LIVING], atol=1e-6)
    for z, bound in ((LIVING, "upper_C"), (BEDROOM, "lower_C"), (BEDROOM, "upper_C")):
        np.testing.assert_array_equal(getattr(within, bound)[z], too_much[bound][z])
    too_little = {"lower_C": alone_C - 1.0, "upper_C": alone_C - 0.5}
    within = begun(parts, [LIVING], **too_little).within_reach(None)
    np.testing.assert_allclose(within.upper_C[LIVING], alone_C[LIVING], atol=1e-6)
    np.testing.assert_array_equal(within.upper_C[BEDROOM], too_little["upper_C"][BEDROOM])


@pytest.mark.parametrize("shared", [0.0, 0.3])
def test_levels_of_the_usual_commands_are_what_loops_answer_to_the_rooms_that_they_bring(home, parts, shared):
    """In a building in which the radiator of one room warms the other too, from heat that is in both; and with water
    that is less warm while the other valve is open."""
    _, boundary, problem, mpc = parts
    measured = read_measurements(home.measurements(), RULES, step_s=HOUR_S).served()
    learned = {
        a: replace(one, machine="", loop=replace(one.loop, others={ROOMS[1 - a]: (shared, 0.6)}))
        for a, one in enumerate(learned_commands(measured).values())
    }
    commands = BuildingCommands(measured.layout, learned, curve_model(home).cards, {})
    (living, _), (_, bedroom) = mpc.planning_operator.pairs
    beside = replace(living, gains=0.3 * living.gains)
    coupled = replace(mpc.planning_operator, pairs=((living, None), (beside, bedroom)))
    forced_K = np.zeros(coupled.shape)
    forced_K[:, :, -1] = [[18.0, 0.0], [4.0, 12.0]]
    # It gets colder.
    features, T_free_C = problem.features.copy(), problem.T_free_C - 0.1 * np.arange(problem.n_steps)
    features[:, :, ZONE] -= 0.1 * np.arange(problem.n_steps)
    of_building = replace(problem, forced_state_K=forced_K, features=features, T_free_C=T_free_C)
    plan = commands.begin(coupled, mpc.evaluator, of_building, boundary, [], None, STATES).without
    u = plan.realise(np.zeros((2, problem.n_steps))).u
    brought_K = coupled.rollout(forced_K, u, features).sum(axis=(1, 3))
    T_now_C = features[:, 0, ZONE] + forced_K.sum(axis=(1, 2))
    T_C = np.concatenate([T_now_C[:, None], T_free_C + brought_K], axis=1)
    T_out_C = 0.5 * (boundary.T_out_C[1:] + boundary.T_out_C[:-1])
    for a, loop in plan.loops.items():
        part = (np.arange(loop.parts) + 0.5) / loop.parts
        other = plan.loops[1 - a].learned.loop
        for k in range(problem.n_steps):
            before = problem.last_u[a] if k == 0 else u[a, k - 1]
            room_C, other_C = (T_C[z, k] + part * (T_C[z, k + 1] - T_C[z, k]) for z in (a, 1 - a))
            one = loop.learned.loop
            taken = one.taken({ROOMS[1 - a]: other.opened(other_C)})
            answer = one.opened(room_C) * one.behind(loop.usual[k], room_C, T_out_C[k], before, taken=taken)
            assert u[a, k] == pytest.approx(float(np.mean(answer)), abs=2e-3)


@pytest.mark.parametrize("of_water", [True, False])
def test_while_a_machine_is_off_rooms_draw_on_its_water_where_levels_are_made_of_it(home, parts, of_water):
    """A valve alone says nothing of the water behind it: then no heat is said to come."""
    _, boundary, problem, mpc = parts
    measured = read_measurements(home.measurements(), RULES, step_s=HOUR_S).served()
    learned = {}
    for a, one in enumerate(learned_commands(measured).values()):
        assert one.loop.of_water, "its map has a flow"
        learned[a] = replace(one, usual=np.full_like(one.usual, -3.0), loop=replace(one.loop, of_water=of_water))
    off = MeterEffect(
        np.array([-3.0]), 0.0, 1.0, np.array([12.0]), np.zeros(4), np.zeros((4, 4)), 0.0, np.zeros(24),
        np.empty((0, 24)),
    )  # fmt: skip
    commands = BuildingCommands(measured.layout, learned, curve_model(home).cards, {"heat_pump": off})
    plan = commands.begin(mpc.planning_operator, mpc.evaluator, problem, boundary, [], None, STATES).without
    u = plan.realise(np.zeros((2, problem.n_steps))).u
    assert (u > 0.05).all() if of_water else (u == 0.0).all()


def test_the_water_of_a_room_that_is_shut_is_that_of_the_others(home, parts):
    """A level of nought is its valve; water that stays warm for hours is there when it opens."""
    _, boundary, problem, mpc = parts
    measured = read_measurements(home.measurements(), RULES, step_s=HOUR_S).served()
    learned = {}
    for a, one in enumerate(learned_commands(measured).values()):
        slow = replace(one.loop, carry=0.6, levels=0.4 * one.loop.levels)
        learned[a] = replace(one, loop=slow)
    commands = BuildingCommands(measured.layout, learned, curve_model(home).cards, {})

    def first_u(last_u):
        begun = replace(problem, last_u=np.array(last_u))
        plan = commands.begin(mpc.planning_operator, mpc.evaluator, begun, boundary, [], None, STATES).without
        return plan.realise(np.zeros((2, problem.n_steps))).u[:, 0]

    usual = first_u((0.0, 0.0))
    np.testing.assert_allclose(first_u((usual[LIVING], 0.0)), usual, rtol=0.15)
    assert (first_u((0.3 * usual[LIVING], 0.0)) < 0.75 * usual).all(), "after a block"


def test_of_actuators_that_exclude_each_other_none_must_act(parts):
    free = begun(parts).within_reach(None)
    assert (free.least_u > 0.01).any(axis=1).all(), "water comes at the lowest offset too"
    machinery = replace(parts[2].machinery, exclusive=((LIVING, BEDROOM),))
    excluded = begun(parts, machinery=machinery).within_reach(None)
    assert (excluded.least_u == 0.0).all()
    np.testing.assert_array_equal(excluded.most_u, free.most_u)


def test_no_more_is_asked_than_the_machine_of_each_can_give(parts):
    """Valves that stay open at the lowest offset ask for more than it has; one of another machine gets its own."""
    problem, free = parts[2], begun(parts).within_reach(None)
    asked = problem.machinery.share @ free.least_u
    gives = np.where(np.arange(problem.n_steps) % 2, 0.5, 2.0) * asked
    gives[4] = -0.1
    within = begun(parts, capacity=gives[None]).within_reach(None)
    given = problem.machinery.share @ within.least_u
    np.testing.assert_allclose(given, np.minimum(asked, 0.99 * np.maximum(gives, 0.0)))
    np.testing.assert_allclose(within.least_u * asked, free.least_u * given)
    each = replace(problem.machinery, machines=("heat pump", "stove"), machine_of=np.arange(2))
    rows = {name: np.repeat(getattr(problem, name), 2, axis=0) for name in ("price_per_kWh", "power_fixed_W")}
    gives = np.stack([np.ones(asked.size), 0.3 * gives])
    apart = begun(parts, machinery=each, capacity=gives, **rows).within_reach(None)
    np.testing.assert_array_equal(apart.least_u[LIVING], free.least_u[LIVING])
    assert (apart.least_u[BEDROOM, 1::2] < free.least_u[BEDROOM, 1::2]).all()


def test_levels_are_within_what_commands_bring_at_the_temperatures_of_the_plan(parts):
    """A warmer room shuts its valve: less comes of the same water. Levels are from 0 to the highest."""
    plan, problem = begun(parts), parts[2]
    cold, warm = (plan.within_reach(np.full((2, problem.n_steps), level)) for level in (0.0, 1.0))
    assert (warm.most_u[:, 6:] < cold.most_u[:, 6:]).all()
    assert warm.most_u.min() < 0.48
    assert (cold.least_u < cold.most_u - 0.1).any(axis=1).all()
    for within in (cold, warm):
        assert (within.least_u >= 0.0).all()
        assert (within.least_u <= within.most_u).all()
        assert (within.most_u <= problem.machinery.u_max[:, None]).all()
    low = replace(problem.machinery, u_max=np.full(2, 0.2))
    assert begun(parts, machinery=low).within_reach(None).most_u.max() == pytest.approx(0.2)


def test_a_plan_is_beyond_what_commands_bring_where_its_own_temperatures_say_so(parts):
    plan, n = begun(parts), parts[2].n_steps
    by_steps = ProblemShape(every_step(n))
    assert plan.beyond(np.ones((2, n)), by_steps)
    assert not plan.beyond(np.zeros((2, n)), by_steps)


def test_a_move_is_within_what_commands_bring_in_its_steps_on_average(parts):
    """What an offset brings falls within an hour by more than all offsets span: no level is within each part's."""
    operator, problem = parts[3].planning_operator, parts[2]
    falls = np.tile([0.36, 0.34, 0.20, 0.10], (2, problem.n_steps // 4))
    shape = ProblemShape(np.arange(problem.n_steps) // 4, problem.machinery)
    each = replace(problem, least_u=falls, most_u=falls + 0.05)
    solver = QPSolver(operator, shape, QPConfig())
    assert "leaves its bounds" in each.unfit(solver.solve(each).u)
    within = each.in_moves(shape)
    solution = solver.solve(within)
    assert solution.ok, solution.problem
    assert within.unfit(solution.u) == ""
    assert ((solution.u > 0.24) & (solution.u < 0.31)).all()


def test_energy_lies_between_the_law_of_power_and_what_the_rooms_ask_for(parts):
    """In the middle where the record tells nothing of it: what is lost to outdoors follows the temperature of rooms."""
    boundary, plan = parts[1], begun(parts)
    commanded = plan.realise(np.zeros((2, parts[2].n_steps)))
    usual_u = plan.without.realise(commanded.u).u
    T_out_C = 0.5 * (boundary.T_out_C[1:] + boundary.T_out_C[:-1])
    lost_K = [float((brought(parts, u) - T_out_C).mean()) for u in (commanded.u, usual_u)]
    by_law = plan.saving(commanded, 0.0)
    assert abs(lost_K[0] / lost_K[1] - by_law.energy_kWh / by_law.energy_alone_kWh) > 0.01, "they differ"
    by_demand_kWh = by_law.energy_alone_kWh * lost_K[0] / lost_K[1]
    for spread in (0.1, 1.0):
        share = 0.5 * weight_of_demand(spread)
        expected_kWh = (1.0 - share) * by_law.energy_kWh + share * by_demand_kWh
        found = plan.saving(commanded, spread)
        assert found.energy_kWh == pytest.approx(expected_kWh, rel=1e-5)
        assert found.energy_alone_kWh == pytest.approx(by_law.energy_alone_kWh)


@pytest.mark.slow
def test_rooms_are_next_to_never_colder_than_left_alone_for_what_that_saves(parts):
    """Where an hour's heat is dear and discomfort counts little: counted once, 0.25 K·h were worth what they saved."""
    problem = parts[2]
    dear = {"price_per_kWh": np.where(np.arange(problem.n_steps) % 8 < 4, 0.1, 2.0)[None]}
    usual_u = begun(parts, **dear).without.realise(np.zeros((2, problem.n_steps))).u
    alone_C = brought(parts, usual_u)
    dear |= {"lower_C": alone_C, "upper_C": alone_C + 3.0, "weights": replace(problem.weights, comfort=0.4)}
    plan = begun(parts, **dear)
    commanded = plan.realise(np.zeros((2, problem.n_steps)))
    assert np.maximum(alone_C - brought(parts, commanded.u), 0.0).sum() < 0.05
    assert plan.saving(commanded, 0.0).gain > 0.0


def test_what_is_on_the_meter_beside_levels_is_bought_above_a_surplus_and_adds_to_the_peak(home, parts):
    """The surplus is less than levels take: 1 kW of hot water in each hour costs what is bought, not what is fed in."""
    _, boundary, problem, mpc = parts
    learned = {a: commands_of(home)[name] for a, name in enumerate(ROOMS)}
    objective = {"at_the_meter": True, "peak_price_per_kW": 10.0}
    options = mpc.config.model_dump() | {"objective": objective}
    evaluator = ThermoForceMPC(mpc.model, MPCConfig.model_validate(options), commands=commands_of(home)).evaluator
    n = problem.n_steps
    at_meter = replace(
        problem,
        price_per_kWh=np.full((1, n), 0.05),
        exchange=Exchange(np.full(n, -200.0), np.full(n, 0.25)),
        power_cap=PowerCap(np.full(n, 1e7), 1.0),
        weights=replace(problem.weights, peak=0.01),
    )
    cost, peak = [], []
    for base_W in (0.0, 1000.0):
        base = MeterEffect(
            np.empty(0), 0.0, 1.0, np.full(1, np.nan), np.zeros(4), np.zeros((4, 4)), 0.0, np.full(24, base_W),
            np.empty((0, 24)),
        )  # fmt: skip
        of_home = BuildingCommands(mpc.model.layout, learned, mpc.model.cards, {"heat_pump": base})
        plan = of_home.begin(mpc.planning_operator, evaluator, at_meter, boundary, [], None, STATES).without
        levels = plan.realise(np.zeros((2, n)))
        assert evaluator.brings(at_meter, levels.u).power_W.sum(axis=0).min() > 200.0
        saving = plan.saving(levels, 0.0)
        cost.append(saving.cost_alone - saving.peak_alone)
        peak.append(saving.peak_alone)
    assert cost[1] - cost[0] == pytest.approx(0.30 * n)
    assert peak[1] - peak[0] == pytest.approx(10.0)


def test_what_a_plan_has_set_goes_on_on_the_meter_as_what_was_read_does(home, parts):
    """Commands are learned once and planned for weeks: what follows on the meter begins at what is set now."""
    _, boundary, problem, mpc = parts
    later = MeterEffect(
        np.empty(0), 0.0, 1.0, np.full(1, np.nan), np.array([0.0, 0.0, 0.0, 500.0]), np.zeros((4, 4)), 0.0,
        np.full(24, 500.0), np.empty((0, 24)),
    )  # fmt: skip
    held_s = 10.0 * HOUR_S

    def cost_alone(states, **read):
        learned = {a: replace(commands_of(home)[name], **read) for a, name in enumerate(ROOMS)}
        of_home = BuildingCommands(mpc.model.layout, learned, mpc.model.cards, {"heat_pump": later})
        plan = of_home.begin(mpc.planning_operator, mpc.evaluator, problem, boundary, [], None, states).without
        return plan.saving(plan.realise(np.zeros((2, problem.n_steps))), 0.0).cost_alone

    usual = cost_alone(STATES)
    by_plan = cost_alone([ActuationState(command=3.0, held_s=held_s)] * 2)
    assert by_plan > usual + 0.1
    assert by_plan == pytest.approx(cost_alone(STATES, last=3.0, held_s=held_s))


@pytest.mark.parametrize("side", ["lower_C", "upper_C"])
def test_a_margin_inside_the_bounds_is_asked_as_far_as_left_alone_keeps_it(parts, side):
    """Beyond that a plan would pay for warmth, or for cold, that nobody asked for; of the bounds themselves it does."""
    commands, boundary, problem, mpc = parts
    alone_C = begun(parts).left_alone_C
    inside = 1.0 if side == "lower_C" else -1.0
    n = problem.n_steps // 3
    # The person's bound lies outside what is kept, with its margin inside or outside too; then inside with its margin.
    bound_C = alone_C + inside * np.repeat([-0.3, -0.3, 0.2], [n, n, problem.n_steps - 2 * n])
    with_margin_C = bound_C + inside * np.repeat([0.5, 0.1, 0.5], [n, n, problem.n_steps - 2 * n])
    expected_C = np.concatenate([alone_C[:, :n], with_margin_C[:, n : 2 * n], bound_C[:, 2 * n :]], axis=1)
    wide = {"lower_C": alone_C - 9.0, "upper_C": alone_C + 9.0}
    of_person, of_problem = wide | {side: bound_C}, wide | {side: with_margin_C}
    moved = replace(problem, **of_problem), asked(boundary, **of_person)
    plan = commands.begin(mpc.planning_operator, mpc.evaluator, *moved, [], None, STATES)
    for name in wide:
        expected = expected_C if name == side else wide[name]
        np.testing.assert_allclose(getattr(plan.problem, name), expected, atol=1e-9)
        np.testing.assert_allclose(getattr(plan.within_reach(None), name), expected, atol=1e-9)


def test_of_a_room_without_a_command_margins_are_asked(home):
    """What left alone keeps there is not known: its levels are the plan's."""
    parts = parts_of(home, [LIVING])
    problem = parts[2]
    boundary = asked(parts[1], problem.lower_C, problem.upper_C)
    tight = replace(problem, lower_C=problem.lower_C + 3.0, upper_C=problem.upper_C + 3.0)
    plan = parts[0].begin(parts[3].planning_operator, parts[3].evaluator, tight, boundary, [], None, STATES)
    np.testing.assert_array_equal(plan.problem.lower_C[BEDROOM], tight.lower_C[BEDROOM])
    assert (plan.problem.lower_C[LIVING] < tight.lower_C[LIVING]).all()


def test_the_less_is_known_the_less_is_promised(parts):
    """The best of many plans by a model that errs saves less than that says: of a wild meter next to nothing is."""
    plan = begun(parts, price_per_kWh=np.where(np.arange(parts[2].n_steps) % 8 < 4, 0.1, 0.5)[None])
    commanded = plan.realise(np.zeros((2, parts[2].n_steps)))
    wild_W = np.where(np.arange(24) % 8 < 4, -1.0, 1.0) * np.array([[-1.0], [1.0]])
    calm, wild, wildest = (plan.saving(commanded, 0.0, [W * wild_W]) for W in (0.0, 300.0, 30000.0))
    assert abs(calm.saved) > 1.2 * abs(wild.saved) > 0.0
    assert abs(wildest.saved) < 0.01 * abs(calm.saved)
    for one in (calm, wild):
        assert one.low < one.saved < one.high
        assert one.cost + one.saved == pytest.approx(calm.cost + calm.saved), "what is not promised is a cost"
    assert wild.high - wild.low > 1.2 * (calm.high - calm.low)


def test_a_plan_that_moves_little_is_known_better_than_one_that_moves_much(parts):
    """Errors that it shares with the building left alone are none of what it saves."""
    plan = begun(parts)
    usual = [plan.loops[a].usual_row.reshape(plan.problem.n_steps, -1) for a in range(2)]

    def width(hours):
        values = tuple(row - np.where(np.arange(len(row)) < hours, 1.0, 0.0)[:, None] for row in usual)
        saving = plan.saving(replace(plan.without.realise(np.zeros((2, plan.problem.n_steps))), values=values), 0.0)
        return saving.high - saving.low

    assert width(0) < 1e-9
    assert 0.0 < width(2) < 0.6 * width(12)


def test_in_a_room_that_is_not_known_discomfort_counts_as_it_is_on_average_over_errors(parts):
    """Where a plan makes it worse than left alone does; by summing over the errors instead of in closed form."""
    problem, plan = parts[2], begun(parts)
    usual_u = plan.without.realise(np.zeros((2, problem.n_steps))).u
    alone_C = brought(parts, usual_u)
    # Beside a bound, so that errors matter; a night of another bound takes the plan away from what is usual.
    bounds = {"lower_C": alone_C - 0.3, "upper_C": alone_C + 1.5}
    plan, unsure = begun(parts, **bounds), begun(parts, unknown=[BEDROOM], **bounds)
    commanded = plan.realise(np.zeros((2, problem.n_steps)))
    T_C = brought(parts, commanded.u)[BEDROOM]
    away_K = T_C - alone_C[BEDROOM]
    assert np.abs(away_K).max() > 0.05, "the plan differs"
    errors = NormalDist().inv_cdf
    z = np.array([errors((k + 0.5) / 4000.0) for k in range(4000)])[:, None]

    def discomfort_K(C, sd_K):
        lower_C, upper_C = (bounds[name][BEDROOM] for name in ("lower_C", "upper_C"))
        mean = sum(np.maximum(out + sd_K * z, 0.0).mean(axis=0) for out in (lower_C - C, C - upper_C))
        return mean - np.maximum(lower_C - C, 0.0) - np.maximum(C - upper_C, 0.0)

    error_K = MOST_ERROR_K[6.0]
    worse_K = discomfort_K(T_C, np.hypot(error_K, away_K)) - discomfort_K(alone_C[BEDROOM], error_K)
    cost = problem.comfort_price.max() * np.maximum(worse_K, 0.0).sum()
    assert cost > 0.0
    gains = [one.saving(commanded, 0.0).gain for one in (plan, unsure)]
    assert gains[0] - gains[1] == pytest.approx(cost, rel=1e-2)


def test_a_tank_gets_the_first_hour_of_a_recommended_state():
    """Hot water comes first: rooms that were to be warmed before they are used were colder for hours."""
    command = SGReady(kind="sg_ready", column="contact")
    loop = SimpleNamespace(learned=SimpleNamespace(command=command), usual=np.full(3, 2.0), step_s=3600.0)
    held = {0: (np.array([2.0]), np.array([7200.0]))}
    rows = np.array(
        [[[2, 2, 3, 3], [3, 3, 3, 3], [3, 3, 3, 3]], [[2, 2, 2, 2], [1, 1, 2, 2], [2, 2, 2, 2]]], dtype=float
    )
    came = np.ones((3, 2, 1))
    for k in range(3):
        held = tank_first({0: loop}, k, {0: rows[:, k]}, came[k], held)
    half = 1.0 - 0.5 * command.tank_first
    np.testing.assert_allclose(came[:, 0, 0], [half, half, 1.0], err_msg="one hour in two steps")
    np.testing.assert_array_equal(came[:, 1, 0], 1.0, err_msg="usual and blocked")
    going_on = np.ones((1, 1))
    tank_first({0: loop}, 0, {0: np.full((1, 4), 3.0)}, going_on, {0: (np.array([3.0]), np.array([3600.0]))})
    assert going_on[0, 0] == 1.0, "it has had it"
    assert CurveOffset(kind="curve_offset", column="offset").tank_first == 0.0
