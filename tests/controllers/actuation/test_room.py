"""Heating and cooling of one zone: the signed programme, room set-points, and a closed loop on an office."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy_problem
import pytest
from mpc_problems import N, random_operator, random_problem, unit_responses
from scipy.optimize import linprog

from benchmarks.detectors.air_unit import LightOffice
from controllers.actuation.actuator import Actuation
from controllers.actuation.actuators import Actuators
from controllers.actuation.room_setpoints import room_blocks
from controllers.checks import ControllerConfigError
from controllers.monitoring.zone_sensors import Sensed, Zones
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from controllers.mpc.margins import LearnedMargin, Margins
from controllers.mpc.readings import Readings
from controllers.mpc.solved import first_demands
from controllers.mpc.state import MPCState
from controllers.optimisation.problem import Cooling, EquipmentLayout, ProblemShape, Weights, every_step
from controllers.optimisation.solvers.ipopt import IpoptConfig, IpoptSolver
from controllers.optimisation.solvers.qp import QPConfig, QPSolver
from controllers.registry import controller_config
from thermoforce_mpc.data import DAY_S, HOUR_S, Block, Boundary, Layout, Observation, Period, Plan, PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.loop.loop import checked_blocks
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.thermal_model import ThermalModel, load_model
from thermoforce_mpc.plants.testcases import load_testcase

LOWEST = -0.6


def signed(operator: OperatorParameters) -> OperatorParameters:
    return replace(operator, heat_input=HeatInput(u_min=LOWEST))


def both_ways(rng: np.random.Generator, order: int):
    """A problem that is too cold at first and too warm later, with cooling at a price of its own."""
    problem = random_problem(rng, order)
    warm = np.where(np.arange(N) < N // 2, rng.uniform(12, 16, N), rng.uniform(24, 28, N))
    cooling = Cooling(rng.uniform(0.1, 0.4, (1, N)), rng.uniform(500, 1500, (1, N)))
    machinery = EquipmentLayout.one(u_min=LOWEST)
    return replace(
        problem, forced_state_K=np.zeros((1, 1, order)), T_free_C=warm[None], cooling=cooling, machinery=machinery
    )


def test_the_signed_programme_is_solved_to_its_optimum_and_never_heats_and_cools_at_once():
    rng = np.random.default_rng(3)
    operator = single(signed(random_operator(rng, 2)))
    solver = QPSolver(operator, ProblemShape(every_step(N), EquipmentLayout.one(u_min=LOWEST)), QPConfig())
    directions = set()
    for _ in range(5):
        problem = both_ways(rng, 2)
        T_rest, effect = unit_responses(problem, operator)
        both = np.hstack([effect, -effect])
        heat, cold = numpy_problem.energy_cost(problem, np.ones((1, N))), problem.cooling_cost_per_u[0]
        cost = np.concatenate([heat, cold, np.full(N, problem.comfort_price[0])])
        A = np.block([[-both, -np.eye(N)], [both, -np.eye(N)]])
        b = np.concatenate([T_rest - problem.lower_C[0], problem.upper_C[0] - T_rest])
        bounds = [(0, 1)] * N + [(0, -LOWEST)] * N + [(0, None)] * N
        best = linprog(cost, A_ub=A, b_ub=b, bounds=bounds, method="highs").fun
        found = solver.solve(problem)
        assert found.ok, found.problem
        assert float(numpy_problem.cost(problem, operator, found.u)) == pytest.approx(best, rel=1e-5)
        assert found.u.min() >= LOWEST
        directions |= set(np.sign(found.u[np.abs(found.u) > 0.05]))
    assert directions == {-1.0, 1.0}


def test_the_peak_counts_power_in_both_directions():
    rng = np.random.default_rng(4)
    operator, problem = single(signed(random_operator(rng, 2))), both_ways(rng, 2)
    problem = replace(problem, weights=Weights(5.0, 1e-6, 2e-2))
    shape = ProblemShape(every_step(N), EquipmentLayout.one(u_min=LOWEST), peak=True)
    ours, reference = (solver.solve(problem) for solver in both_solvers(operator, shape))
    assert ours.ok, ours.problem
    assert reference.ok, reference.problem
    best = float(numpy_problem.cost(problem, operator, reference.u))
    assert float(numpy_problem.cost(problem, operator, ours.u)) == pytest.approx(best, rel=1e-5)
    unpriced = QPSolver(operator, replace(shape, peak=False), QPConfig()).solve(
        replace(problem, weights=Weights(5.0, 1e-6))
    )
    assert numpy_problem.power_W(problem, ours.u).max() < numpy_problem.power_W(problem, unpriced.u).max() - 50.0


def both_solvers(operator, shape):
    return QPSolver(operator, shape, QPConfig()), IpoptSolver(operator, shape, IpoptConfig(tolerance=1e-10))


def blocks(u: float, T_end_C: float, T_now_C: float, *, u_last: float = 0.0, bounds=(15.0, 30.0)) -> tuple[Block, ...]:
    return room_blocks(
        u, T_end_C, T_now_C=T_now_C, u_last=u_last, bounds_C=bounds, u_min=LOWEST, step_s=900.0, block_s=60.0
    )


def test_a_move_starts_as_late_as_it_can():
    idle, moving = blocks(0.3, 21.05, 18.0)
    assert (idle.u, idle.command) == ((0.0,), ((15.0, 30.0),))
    assert moving.command == ((21.05, 30.0),)
    assert moving.duration_s == 360.0  # 0.3 · 900 s, a quarter more, whole minutes
    assert moving.u == pytest.approx((0.75,))
    assert idle.duration_s + moving.duration_s == 900.0
    cooled = blocks(-0.3, 24.0, 27.0)
    assert cooled[-1].command == ((15.0, 24.0),)
    assert LOWEST <= cooled[-1].u[0] < 0.0


def test_heat_that_holds_the_zone_is_no_part_of_a_move():
    holding, moving = blocks(0.4, 21.05, 15.03, u_last=0.2, bounds=(15.03, 29.97))
    assert holding.u == pytest.approx((0.2,))
    assert moving.duration_s == 300.0  # a quarter of the 0.8 that are left, not 0.4 of the step


def test_a_loop_at_its_bound_goes_on_where_nothing_is_planned():
    (block,) = blocks(0.0, 24.1, 23.95, u_last=-0.15, bounds=(21.03, 23.97))
    assert block.u == pytest.approx((-0.15,))
    assert block.command == ((21.03, 23.97),)
    (idle,) = blocks(0.0, 22.0, 22.5, u_last=-0.15, bounds=(21.03, 23.97))
    assert idle.u == (0.0,)


@pytest.mark.parametrize("T_now_C", [math.nan, -5.0, 21.0, 45.0])
@pytest.mark.parametrize("u", [-0.6, -1e-9, 0.0, 0.2, 1.0])
def test_set_points_stay_within_the_bounds_in_force_whatever_the_plan_says(u, T_now_C):
    for T_end_C in (-40.0, 22.0, 90.0):
        for u_last in (math.nan, -0.5, 0.9):
            planned = blocks(u, T_end_C, T_now_C, u_last=u_last, bounds=(21.0, 24.0))
            found, refused = checked_blocks(Plan(planned, PlanStatus.SOLVED, ""), 900.0, 900.0, LOWEST)
            assert refused == ""
            for block in found:
                (band,) = block.command
                assert band is not None
                assert 21.0 <= band[0] <= band[1] <= 24.0


def test_a_level_or_band_that_is_not_possible_never_reaches_the_plant():
    for block in (
        Block(-0.7, 900.0, (21.0, 24.0)),
        Block(0.2, 900.0, (24.0, 21.0)),
        Block(0.2, 900.0, (math.nan, 24.0)),
    ):
        found, refused = checked_blocks(Plan((block,), PlanStatus.SOLVED, ""), 900.0, 900.0, LOWEST)
        assert found[0].u == (None,)
        assert "refused" in refused


@pytest.fixture(scope="module")
def probed():
    return probe(LightOffice(), 20 * DAY_S, 3.0, seed=1, layout=Layout.single("both", LOWEST))


@pytest.fixture(scope="module")
def model(probed) -> ThermalModel:
    return identify(probed, mode="both", u_min=LOWEST, floor_area_m2=48.0)


def test_probing_heats_and_cools_inside_the_band(probed):
    lower, upper = LightOffice.bounds_C(probed.time_s[1:])
    assert probed.u.min() < -0.02
    assert probed.u.max() > 0.02
    out = np.maximum(lower - probed.T_zone_C[0, 1:], probed.T_zone_C[0, 1:] - upper)
    assert out.max() < 0.3, "K beyond the band"


@pytest.mark.slow
def test_a_model_knows_the_floor_area_that_it_was_identified_for(model):
    assert model.floor_area_m2 == model.layout.floor_area_m2 == (48.0,)


def test_probing_by_rooms_asks_for_nothing_that_only_levels_need():
    class WithoutPast(LightOffice):
        def past(self, step_s):
            raise AssertionError("the past bounds the effect of a level, and no level is drawn")

    assert probe(WithoutPast(), 20 * DAY_S, 0.25, seed=1, layout=Layout.single("both", LOWEST)).n_steps == 24


@pytest.mark.slow
def test_one_operator_for_both_directions_is_found(model, tmp_path):
    office = LightOffice()
    full = np.array([1.0])
    u = np.zeros(4)
    u[0] = 1.0
    step = float(model.only.operator.impulse(1)[0])
    assert step == pytest.approx(office.step_response_K(900.0), rel=0.15)
    assert float(model.only.power(full, 0.0)[0]) == pytest.approx(11000.0 / 0.9, rel=0.02)
    assert float(model.only.power(-full, 0.0)[0]) == pytest.approx(11000.0 / 3.0, rel=0.02)
    model.save(tmp_path / "office")
    again = load_model(tmp_path / "office")
    assert again.only.operator.heat_input.u_min == LOWEST
    assert again.power == model.power


@pytest.mark.slow
def test_in_a_record_without_cooling_it_is_taken_to_cost_as_heating_does(probed):
    """A winter's three days need not keep the building from being heated."""
    heated = replace(probed, u=np.maximum(probed.u, 0.0), power_W=np.where(probed.u > 0, probed.power_W, 0.0))
    (power,) = identify(heated, mode="both", u_min=LOWEST, floor_area_m2=48.0).power
    assert power is not None
    assert power.cooling == power.load
    assert "the other direction was hardly used" in power.source


def test_levels_of_both_directions_and_modes_belong_together(probed):
    with pytest.raises(DataError, match="mode both needs one below 0"):
        identify(probed, mode="both", floor_area_m2=48.0)
    with pytest.raises(DataError, match=r"expected \[0, 1\]|not a number between"):
        identify(probed, mode="heating", floor_area_m2=48.0)


@pytest.mark.slow
def test_closed_loop_is_far_more_comfortable_than_native_control_at_nearly_its_cost(model):
    testcase = load_testcase("bestest_air")
    config = controller_config("thermoforce_mpc", {"free_response": {"name": "rc"}, "horizon_h": 24.0}, testcase)
    assert isinstance(config, MPCConfig)
    office = LightOffice()
    period = Period("day 30", 30 * DAY_S, 3 * DAY_S, 2 * DAY_S)
    ours = run_closed_loop(office, ThermoForceMPC(model, config), period)
    assert {step.plan.status for step in ours.steps} == {PlanStatus.SOLVED}
    native = office.native_kpis(period)
    assert ours.kpis["tdis_tot"] < 0.3 * native["tdis_tot"]
    assert ours.kpis["cost_tot"] < 1.03 * native["cost_tot"]


def test_a_room_that_fell_below_its_reserve_does_not_wait_for_its_heat(model):
    config = controller_config("thermoforce_mpc", {"free_response": {"name": "rc"}}, load_testcase("bestest_air"))
    assert isinstance(config, MPCConfig)
    mpc, office = ThermoForceMPC(model, config), LightOffice()
    office.reset(30 * DAY_S, DAY_S)
    night = Observation(office.past(mpc.step_s), office.forecast(mpc.horizon_s, mpc.step_s))
    assert night.boundary.lower_C[0, 0] == 15.0

    actuators = Actuators(model.layout, [Actuation(config.actuation)])
    plan = Plan(
        (), PlanStatus.SOLVED, "", u=np.array([[0.1]]), T_free_C=np.array([[16.1]]), T_forced_K=np.zeros((1, 1))
    )
    readings = Readings(night, night.boundary, Zones((Sensed(15.2),)), None)

    def first_band(missed: LearnedMargin) -> tuple[float, float]:
        known = missed.meeting(night.boundary.lower_C, night.boundary.upper_C)
        kept = MPCState(night.time_s, margins=Margins(learned=known))
        ((first, *_),) = first_demands(config, actuators, mpc.step_s, replace(plan, state=kept), readings)
        return first.command[0]

    assert first_band(LearnedMargin.nothing(1))[0] == pytest.approx(15.03)
    assert first_band(replace(LearnedMargin.nothing(1), reserve_K=np.array([[1.0], [0.0]])))[0] == pytest.approx(16.03)


def test_loops_are_sent_to_the_end_of_a_move_of_several_steps(model):
    config = controller_config("thermoforce_mpc", {"free_response": {"name": "rc"}}, load_testcase("bestest_air"))
    assert isinstance(config, MPCConfig)
    office = LightOffice()
    office.reset(30 * DAY_S, DAY_S)
    night = Observation(office.past(900.0), office.forecast(DAY_S, 900.0))
    learned = LearnedMargin.nothing(1).meeting(night.boundary.lower_C, night.boundary.upper_C)
    state = MPCState(night.time_s, margins=Margins(learned=learned))
    readings = Readings(night, night.boundary, Zones((Sensed(16.0),)), None)

    def sent_to_C(*u: float) -> float:
        T_C = np.array([[17.0, 18.0, 19.0]])
        plan = Plan((), PlanStatus.SOLVED, "", u=np.array([u]), T_free_C=T_C, T_forced_K=0.0 * T_C, state=state)
        actuators = Actuators(model.layout, [Actuation(config.actuation)])
        ((*_, last),) = first_demands(config, actuators, 900.0, plan, readings)
        return last.command[0][0]

    assert sent_to_C(0.9, 0.8, 0.1) == 18.0
    assert sent_to_C(0.3, 0.8, 0.1) == 17.0


@pytest.mark.parametrize("solver", ["auto", "ipopt"])
def test_a_negative_price_is_no_reason_to_heat_and_cool_at_once(model, solver):
    options = {"free_response": {"name": "rc"}, "solver": solver, "horizon_h": 24.0}
    config = controller_config("thermoforce_mpc", options, load_testcase("bestest_air"))
    assert isinstance(config, MPCConfig)
    mpc, office = ThermoForceMPC(model, config), LightOffice()
    office.reset(30 * DAY_S, DAY_S)
    record, ahead = office.past(mpc.step_s), office.forecast(mpc.horizon_s, mpc.step_s)

    def at(price: float) -> Plan:
        prices = np.where(np.arange(ahead.time_s.size) // 12 == 2, price, 0.2)
        there = replace(ahead, price_per_kWh=prices[None], heating_price_per_kWh=prices[None])
        return mpc.plan(Observation(record, there))

    plan, free = at(-0.05), at(0.0)
    assert plan.status is PlanStatus.SOLVED, plan.why
    np.testing.assert_array_equal(plan.u, free.u)


class DroppingOffice(LightOffice):
    """The office whose loops fail it for a moment every hour of the night, as a fan that pauses."""

    def advance(self, u, duration_s, command=None):
        found = super().advance(u, duration_s, command)
        if self.now_s % HOUR_S == 0 and self.now_s % DAY_S < 7 * HOUR_S:
            self.T -= 0.8
            found = replace(found, T_zone_C=np.array([self.T]))
        return found


@pytest.mark.slow
def test_what_loops_miss_at_night_is_kept_off_the_bound_of_the_night(model):
    testcase = load_testcase("bestest_air")
    period = Period("two cold nights", 29 * DAY_S, 2 * DAY_S, 2 * DAY_S)

    def course(corrections: bool):
        options = {"free_response": {"name": "linear_weather"}, "horizon_h": 6.0, "corrections": corrections}
        config = controller_config("thermoforce_mpc", options, testcase)
        assert isinstance(config, MPCConfig)
        return run_closed_loop(DroppingOffice(), ThermoForceMPC(model, config), period)

    def too_cold_K(run) -> float:
        """Sum over the readings in the second night."""
        late = [step for step in run.steps if step.time_s > period.start_s + DAY_S]
        below_K = [15.0 - float(step.T_zone_C[0]) for step in late if step.boundary.lower_C[0, 0] == 15.0]
        return sum(max(K, 0.0) for K in below_K)

    learning, without = course(True), course(False)
    assert too_cold_K(without) > 2.0
    assert too_cold_K(learning) < 0.1 * too_cold_K(without)
    assert learning.kpis["cost_tot"] < 1.08 * without.kpis["cost_tot"]


def test_a_model_of_one_direction_does_not_run_room_setpoints(model):
    zone = model.only
    one = ThermalModel.of_zone(replace(zone, operator=replace(zone.operator, heat_input=HeatInput())))
    with pytest.raises(ControllerConfigError, match="does not both heat and cool: leave mode out"):
        ThermoForceMPC(one, MPCConfig.model_validate({"actuation": {"mode": "room_setpoints"}}))
    ThermoForceMPC(model, MPCConfig())  # a model of both directions runs them without being told


def test_the_weights_of_a_boundary_price_heating_at_its_own_carrier():
    n = np.zeros(3)
    plain = Boundary(np.arange(3.0) * 900, n, n, n, n + 15, n + 30, n + 0.2, n)
    assert plain.heating_price_per_kWh.tolist() == [[0.2] * 3]
    assert replace(plain, heating_price_per_kWh=n + 0.05).head(1).heating_price_per_kWh.tolist() == [[0.05] * 2]
    assert Weights(5.0, 0.0).peak == 0.0
