"""Two zones, each with an actuator of its own: what happens to the one is no business of the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from faults import FAILED, ChangedSolver, FaultyHouse, shifted
from simple_house import OutdoorResponse, SimpleHouse, simple_model
from two_houses import SHARED, TWO, TwoHouses, reordered, two_model, two_observation

from controllers import MPCConfig, ThermoForceMPC
from controllers.monitoring.single_actuator import single_actuator_records
from controllers.monitoring.watch import WatchState, applied_levels
from controllers.mpc.acting import NoModelController
from controllers.mpc.readings import later_state
from controllers.mpc.state import MPCState
from controllers.rules.pi import PIController
from controllers.rules.thermostat import Thermostat
from thermoforce_mpc.data import DAY_S, HOUR_S, Layout, Observation, PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.card import Competence
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.predictor import PredictorState
from thermoforce_mpc.model.thermal_model import ThermalModel

CONDEMNED = Competence(False, reasons=("6 h ahead it errs by 7.00 K, need 1 K",), effect_K=7.0, effect_sd_K=5.0)
LAYOUT = Layout(TWO, (1, 1), (0, 1), (0, 1), (0.0,) * 2, (0.0,) * 2, (60.0, 40.0))
RADIATOR, FLOOR = range(2)


def mpc(model: ThermalModel | None = None, free=None, fails=False, **options) -> ThermoForceMPC:
    """A controller; `fails`: its solver does, but for the first solve."""
    config = MPCConfig(**{"step_s": None, "horizon_h": 24.0, **options})
    solver = ChangedSolver(config, lambda n, found: FAILED if fails and n else found)
    return ThermoForceMPC(model or two_model(), config, free_response=free or OutdoorResponse(), solver=solver)


def level(plan, actuator: int) -> float | None:
    """Mean level of an actuator over the step; None under native control."""
    levels = [block.u[actuator] for block in plan.blocks]
    if None in levels:
        assert set(levels) == {None}
        return None
    return sum(u * block.duration_s for u, block in zip(levels, plan.blocks, strict=True)) / HOUR_S


def silenced(observation: Observation, zone: int) -> Observation:
    T = observation.history.T_zone_C.copy()
    T[zone] = np.nan
    return replace(observation, history=replace(observation.history, T_zone_C=T))


def test_each_zone_follows_its_own_bound_as_if_it_were_alone():
    seen = two_observation(houses=TwoHouses(lower_K=1.0))
    both = mpc().plan(seen)
    assert both.status is PlanStatus.SOLVED
    assert both.acting == (PlanStatus.SOLVED,) * 2
    for z in range(2):
        boundary = {
            name: getattr(seen.boundary, name)[z]
            for name in ("occupancy", "lower_C", "upper_C", "price_per_kWh", "emission_kg_per_kWh")
        }
        weather = {name: getattr(seen.boundary, name) for name in ("time_s", "T_out_C", "solar_W_m2")}
        alone = mpc(simple_model()).plan(
            Observation(seen.history.part(z, [z], [z]), type(seen.boundary)(**weather, **boundary))
        )
        np.testing.assert_allclose(both.u[z], alone.u[0], atol=1e-3)
        np.testing.assert_allclose(both.T_zone_C[z], alone.T_zone_C[0], atol=2e-3)


@pytest.mark.slow
def test_in_closed_loop_both_zones_are_warm_and_names_say_which_binds():
    result = run_closed_loop(TwoHouses(lower_K=1.0), mpc(), SimpleHouse().period("x"))
    assert {step.plan.acting for step in result.steps[24:]} == {(PlanStatus.SOLVED,) * 2}
    T = np.array([sample.T_zone_C for sample in result.samples[len(result.samples) // 2 :]])
    lower = np.array([sample.lower_C for sample in result.samples[len(result.samples) // 2 :]])
    assert (T - lower).min() > -0.25
    night = lower[:, 0] > 20
    assert (T - lower)[night].mean(axis=0) == pytest.approx([0.2, 0.2], abs=0.2), "no warmer than need be"
    assert any(" in bath" in step.plan.why for step in result.steps)
    assert any(" in hall" in step.plan.why for step in result.steps)


def test_plans_count_on_the_part_of_a_neighbours_heat_that_is_known():
    plain, seen = two_model(), two_observation(houses=TwoHouses(lower_K=1.0))
    (own, _), (_, other) = plain.operator.pairs
    across = replace(own, gains=0.3 * own.gains)  # of the radiator on the hall
    both = replace(plain.operator, pairs=((own, None), (across, other)))

    def controller(sd: float | None) -> ThermoForceMPC:
        known = {} if sd is None else {"step_response_24h_K[radiator]": 2.0, "step_response_24h_sd_K[radiator]": 2 * sd}
        cards = (plain.cards[RADIATOR], replace(plain.cards[FLOOR], uncertainty=known))
        return mpc(replace(plain, operator=both, cards=cards))

    for sd, share in ((None, 1.0), (0.4, 1.0), (0.75, 0.5), (1.3, 0.0)):
        used = controller(sd)
        np.testing.assert_allclose(used.planning_operator.gains[1, RADIATOR], share * across.gains)
        np.testing.assert_allclose(used.planning_operator.gains[0, RADIATOR], own.gains)
        assert used.model.operator.gains[1, RADIATOR].any(), "what acted is followed by the whole model"
    unknown, alone = controller(1.3).plan(seen), mpc().plan(seen)
    assert unknown.status is PlanStatus.SOLVED
    np.testing.assert_allclose(unknown.u, alone.u, atol=1e-3)
    assert controller(0.4).plan(seen).u[FLOOR].sum() < alone.u[FLOOR].sum() - 0.5


@pytest.mark.slow
def test_zones_of_different_order_are_controlled_as_those_of_one():
    """A mode of the second zone in two halves: nothing else changes, in no station of a step."""

    def halved(a: int, pair):
        if a == RADIATOR:
            return pair
        (pole,), (gain,) = pair.poles, pair.gains
        poles = np.array([pole - 1e-9, pole])
        return replace(pair, poles=poles, gains=0.5 * np.full(2, gain))

    plain, options = two_model(), {"watch": {"enabled": True}}
    other = replace(plain, operator=plain.operator.map_actuators(halved))
    assert [pair.order for *_, pair in other.operator.each()] == [1, 2]
    runs = [run_closed_loop(TwoHouses(), mpc(m, **options), SimpleHouse().period("x")) for m in (plain, other)]
    one, two = (np.array([step.plan.u[:, 0] for step in run.steps]) for run in runs)
    np.testing.assert_allclose(two, one, atol=2e-3)
    assert not any("could not be judged" in step.plan.news for step in runs[1].steps)


@pytest.mark.parametrize("closed", [RADIATOR, FLOOR])
def test_a_condemned_model_of_one_leaves_the_other_to_the_plan(closed):
    seen = two_observation()
    verdicts = tuple(CONDEMNED if a == closed else None for a in range(2))
    plan, free = mpc(two_model(verdicts)).plan(seen), mpc().plan(seen)
    other = 1 - closed
    assert plan.status is PlanStatus.GATE
    assert (plan.acting[closed], plan.acting[other]) == (PlanStatus.GATE, PlanStatus.SOLVED)
    assert plan.why.startswith(f"{TWO.actuators[closed]}: gate: This model may not act")
    assert ": native control; " in plan.why
    assert level(plan, closed) is None
    assert level(plan, other) == level(free, other)
    assert plan.state.actuation[closed].native
    assert not plan.state.actuation[other].native


def test_no_zone_is_heated_for_another_whose_own_actuator_does_not_follow_the_plan():
    """The radiator warms the hall too, whose floor is left to native control however far below its bound it stays."""
    plain = two_model((None, CONDEMNED))
    ((radiator, _), (_, floor)) = plain.operator.pairs
    operator = replace(plain.operator, pairs=((radiator, None), (radiator, floor)))
    levels = []
    for lower_K in (2.0, 8.0):
        plan = mpc(replace(plain, operator=operator)).plan(two_observation(houses=TwoHouses(lower_K=lower_K)))
        assert plan.acting == (PlanStatus.SOLVED, PlanStatus.GATE)
        levels.append(level(plan, RADIATOR))
    assert levels[1] == pytest.approx(levels[0], abs=0.01)
    assert levels[0] < 1.0


def test_where_all_stand_back_each_has_its_own_reason_and_level():
    controller = mpc(two_model((None, CONDEMNED)), fallback={"stand_back": "rule"})
    seen = two_observation()
    T = seen.history.T_zone_C.copy()
    T[:, -1] = 19.0, 23.0
    seen = replace(seen, history=replace(seen.history, T_zone_C=T))
    alarmed = WatchState(alarm="it is colder than predicted", since_s=seen.time_s, wait_h=12.0)
    state = replace(first_state(seen), watch=(alarmed, WatchState()))
    plan = controller.plan(seen, state)
    assert plan.acting == (PlanStatus.WATCH, PlanStatus.GATE)
    assert plan.status is PlanStatus.WATCH
    assert plan.why.index("radiator: watch: it is colder") < plan.why.index("floor: gate: ")
    assert [level(plan, a) for a in range(2)] == [1.0, 0.0], "the cold zone is heated, not the other"
    gated = mpc(two_model((CONDEMNED, CONDEMNED))).plan(seen)
    assert gated.acting == (PlanStatus.GATE,) * 2
    assert [block.u for block in gated.blocks] == [(None, None)]


def first_state(seen: Observation) -> MPCState:
    state = mpc().plan(seen).state
    assert isinstance(state, MPCState)
    return state


def stuck(house: FaultyHouse, u: float | None) -> float | None:
    """On the second day the actuator does nothing, which is measured."""
    return 0.0 if 11 * DAY_S <= house.now_s < 12 * DAY_S else u


@pytest.mark.slow
def test_an_actuator_that_fails_is_handed_back_alone_and_returns():
    period = replace(SimpleHouse().period("x"), scored_s=5 * DAY_S)
    result = run_closed_loop(TwoHouses(first=FaultyHouse(gives=stuck)), mpc(), period)
    held = [step for step in result.steps if step.plan.acting[RADIATOR] is PlanStatus.WATCH]
    assert held
    assert 11 * DAY_S < held[0].time_s <= 12 * DAY_S
    assert held[-1].time_s < result.steps[-1].time_s, "control returned"
    for step in held:
        assert step.plan.status is PlanStatus.WATCH
        assert "radiator: watch: the actuator does not follow" in step.plan.why
        assert all(sample.u_applied[RADIATOR] is None for sample in step.samples)
    assert {step.plan.acting[FLOOR] for step in result.steps} == {PlanStatus.SOLVED}
    lower = np.array([s.lower_C[1] for s in result.samples[24:]])
    assert (np.array([s.T_zone_C[1] for s in result.samples[24:]]) - lower).min() > -0.3


@pytest.mark.parametrize("cold", [RADIATOR, FLOOR])
def test_the_guard_acts_in_the_zone_that_is_outside_and_in_no_other(cold):
    houses = [SimpleHouse(), SimpleHouse()]
    houses[cold] = SimpleHouse(T_start_C=17.0)
    plant = TwoHouses(*houses)
    plant.reset(10 * DAY_S, 0.0)
    seen = Observation(plant.past(900.0), plant.forecast(DAY_S, HOUR_S))
    free = [OutdoorResponse(), OutdoorResponse()]
    free[cold] = shifted(12.0)
    plan = mpc(free=free, actuation={"mode": "modulating", "lowest_level": 0.0}).plan(seen)
    other = 1 - cold
    assert plan.status is PlanStatus.GUARD
    assert (plan.acting[cold], plan.acting[other]) == (PlanStatus.GUARD, PlanStatus.SOLVED)
    assert plan.why.startswith(f"{TWO.actuators[cold]}: guard: ")
    assert level(plan, cold) == 1.0
    assert plan.u[cold, 0] < 0.5, "the plan itself stays readable"
    assert level(plan, other) == pytest.approx(plan.u[other, 0], abs=0.01)


@pytest.mark.parametrize("silent", [0, 1])
def test_a_zone_without_a_reading_goes_to_native_control_and_the_other_follows_the_plan(silent):
    seen = two_observation()
    plan, healthy = mpc().plan(silenced(seen, silent)), mpc().plan(seen)
    other = 1 - silent
    assert plan.status is PlanStatus.NATIVE
    assert (plan.acting[silent], plan.acting[other]) == (PlanStatus.NATIVE, PlanStatus.SOLVED)
    assert level(plan, silent) is None
    assert level(plan, other) == pytest.approx(level(healthy, other), abs=1e-6)
    np.testing.assert_allclose(plan.u[other], healthy.u[other], atol=1e-3)
    zone = TWO.zones[silent]
    assert f"{TWO.actuators[silent]}: the temperature of {zone} was never measured: native control" in plan.why
    assert f"T_zone_C[{zone}]: never measured, the mean free response of the other zones" in plan.why
    assert np.isfinite(plan.T_zone_C).all()
    assert np.isnan(plan.state.good.T_zone_C[silent]).all(), "nothing that was not predicted is held against a reading"
    assert not plan.state.watch[silent].tracks[0].pending
    assert plan.state.watch[other].tracks[0].pending


@pytest.mark.slow
def test_a_sensor_that_is_silent_for_a_whole_run_and_one_that_comes_back():
    def silent_until(until_s):
        return lambda house, seen: replace(seen, T_zone_C=np.nan) if house.now_s < until_s else seen

    for until_s in (np.inf, 11 * DAY_S):
        house = FaultyHouse(silent_until(until_s))
        result = run_closed_loop(TwoHouses(first=house), mpc(), SimpleHouse().period("x"))
        assert {step.plan.acting[FLOOR] for step in result.steps[24:]} == {PlanStatus.SOLVED}
        radiator = [step.plan.acting[RADIATOR] for step in result.steps]
        n = len(radiator) if until_s == np.inf else 24
        assert set(radiator[:n]) == {PlanStatus.NATIVE}
        assert set(radiator[n:]) <= {PlanStatus.SOLVED}
        hall = [(s.T_zone_C[1] - s.lower_C[1]) for step in result.steps[24:] for s in step.samples]
        assert min(hall) > -0.3


def test_two_silent_sensors_leave_the_building_to_native_control():
    seen = silenced(silenced(two_observation(), 0), 1)
    plan = mpc().plan(seen)
    assert plan.acting == (PlanStatus.NATIVE,) * 2
    for actuator, zone in zip(TWO.actuators, TWO.zones, strict=True):
        assert f"{actuator}: the temperature of {zone} was never measured: native control" in plan.why
    assert [block.u for block in plan.blocks] == [(None, None)]
    with pytest.raises(DataError, match="never measured"):
        mpc().predictor.context(seen)


def test_after_a_failed_solve_each_actuator_falls_back_by_its_own_zone():
    controller, seen = mpc(fails=True), two_observation()
    plan = controller.plan(seen)
    later = replace(
        seen,
        history=replace(seen.history, time_s=seen.history.time_s + HOUR_S),
        boundary=replace(seen.boundary, time_s=seen.boundary.time_s + HOUR_S),
    )
    T = later.history.T_zone_C.copy()
    T[:, -1] = plan.T_zone_C[:, 0]
    T[1, -1] -= 0.9
    later = replace(later, history=replace(later.history, T_zone_C=T))
    after = controller.plan(later, plan.state)
    assert after.acting == (PlanStatus.SHIFTED, PlanStatus.THERMOSTAT)
    assert after.status is PlanStatus.THERMOSTAT
    assert "radiator: following the previous plan" in after.why
    assert f"floor: {T[1, -1]:.2f} °C against" in after.why


@pytest.mark.parametrize(
    ("zones", "actuators", "machines"),
    [((1, 0), (0, 1), (0, 1)), ((0, 1), (1, 0), (0, 1)), ((0, 1), (0, 1), (1, 0)), ((1, 0), (1, 0), (1, 0))],
)
def test_the_order_of_zones_actuators_and_machines_does_not_matter(zones, actuators, machines):
    seen = two_observation(houses=TwoHouses(lower_K=1.0))
    model = two_model((None, CONDEMNED))
    # A cheaper second machine and a weak effect of each on the other's zone.
    weak = replace(simple_model().only.operator, gains=0.2 * simple_model().only.operator.gains)
    pairs = ((model.operator.pairs[0][0], weak), (weak, model.operator.pairs[1][1]))
    model = replace(model, operator=replace(model.operator, pairs=pairs))
    seen = replace(
        seen, boundary=replace(seen.boundary, price_per_kWh=seen.boundary.price_per_kWh * np.array([[1.0], [0.5]]))
    )
    turned = ThermalModel(
        BuildingOperator(
            tuple(TWO.zones[z] for z in zones),
            tuple(TWO.actuators[a] for a in actuators),
            tuple(tuple(pairs[z][a] for a in actuators) for z in zones),
            tuple(zones.index(model.operator.home[a]) for a in actuators),
        ),
        tuple(model.power[m] for m in machines),
        model.free,
        tuple(model.cards[a] for a in actuators),
        tuple(TWO.machines[m] for m in machines),
        tuple(machines.index(model.machine_of[a]) for a in actuators),
        (0.0, 0.0),
    )
    plan = mpc(model).plan(seen)
    other = mpc(turned).plan(reordered(seen, zones, actuators, machines))
    np.testing.assert_allclose(other.u, plan.u[list(actuators)], atol=2e-3)
    np.testing.assert_allclose(other.T_zone_C, plan.T_zone_C[list(zones)], atol=2e-3)
    np.testing.assert_allclose(other.power_W, plan.power_W[list(machines)], atol=10.0)
    assert other.acting == tuple(plan.acting[a] for a in actuators)
    assert [level(other, i) for i in range(2)] == pytest.approx([level(plan, a) for a in actuators], abs=1e-6)


def test_a_building_of_other_names_is_refused():
    seen = two_observation()
    other = reordered(seen, (1, 0), (0, 1), (0, 1))
    with pytest.raises(DataError, match="another building"):
        mpc().plan(other)
    with pytest.raises(DataError, match="another building"):
        two_model().predict(other.history, other.boundary, 0.0, free_response=OutdoorResponse())


def test_the_state_of_a_building_of_another_size_is_refused():
    seen, house = two_observation(), SimpleHouse()
    house.reset(10 * DAY_S, 2 * DAY_S)
    alone = Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S))
    kinds = (
        lambda layout: mpc() if layout else mpc(simple_model()),
        lambda layout: NoModelController("", mpc().config, layout or Layout.single("heating"), HOUR_S, name=""),
        lambda layout: PIController(None, layout),
        lambda layout: Thermostat(None, layout),
    )
    for build in kinds:
        both, one = build(LAYOUT), build(None)
        with pytest.raises(DataError, match=r"state is of 1 (zones|actuators), .*'bath'.*: another building\?"):
            both.plan(seen, one.plan(alone).state)
        with pytest.raises(DataError, match=r"state is of 2 (zones|actuators), .* another building\?"):
            one.plan(alone, both.plan(seen).state)


def test_what_the_other_actuator_did_is_taken_out_of_a_zones_record():
    model, seen = two_model(), two_observation()
    forced_K = mpc(model).predictor.followed(seen.history).forced_K
    apart = single_actuator_records(model, seen.history, forced_K)[RADIATOR]
    np.testing.assert_array_equal(apart.T_zone_C[0], seen.history.T_zone_C[0])
    pair = model.operator.pairs[0][0]
    coupled = replace(model, operator=replace(model.operator, pairs=((pair, pair), (None, pair))))
    forced_K = mpc(coupled).predictor.followed(seen.history).forced_K
    own = single_actuator_records(coupled, seen.history, forced_K)[RADIATOR]
    np.testing.assert_allclose(own.T_zone_C[0], seen.history.T_zone_C[0] - forced_K[0, FLOOR].sum(axis=-1))
    assert np.abs(own.T_zone_C - seen.history.T_zone_C[:1]).max() > 0.5
    assert own.names.actuators == ("radiator",)
    assert np.isnan(single_actuator_records(coupled, seen.history, None)[RADIATOR].T_zone_C).all(), (
        "not known, so not judged"
    )


@pytest.mark.parametrize("kind", [Thermostat, PIController])
def test_rules_act_zone_by_zone(kind):
    plant = TwoHouses(SimpleHouse(T_start_C=17.0), SimpleHouse(T_start_C=17.0))
    plant.reset(10 * DAY_S, 0.0)
    seen = Observation(plant.past(900.0), plant.forecast(DAY_S, kind().step_s))
    plan = kind(layout=LAYOUT).plan(silenced(seen, 0))
    assert [block.u for block in plan.blocks] == [(None, 1.0)]
    assert "radiator: zone temperature missing: native control" in plan.why


@pytest.mark.slow
def test_a_shared_machine_feeds_both_at_once_and_its_meter_accuses_neither():
    plant = TwoHouses(lower_K=1.0, shared=True)
    result = run_closed_loop(plant, mpc(two_model(shared=True)), replace(SimpleHouse().period("x"), scored_s=4 * DAY_S))
    assert {step.plan.acting for step in result.steps[24:]} == {(PlanStatus.SOLVED,) * 2}
    together = 0
    for step in result.steps:
        on_s = np.array([np.array(s.u_applied, dtype=float) * s.duration_s for s in step.samples])
        union_s = sum(s.duration_s for s in step.samples if any(s.u_applied))
        assert union_s == pytest.approx(on_s.sum(axis=0).max()), "as long as the longest of them"
        together += on_s.sum(axis=0).min() > 0
    assert together > 10
    u = result.steps[-1].plan.u
    weather = result.steps[-1].boundary.T_out_C[: u.shape[1]]
    fixed_W, per_u_W = two_model(shared=True).power[0].parts(weather)
    planned_W = fixed_W * u.max(axis=0) + 0.5 * per_u_W * u.sum(axis=0)
    np.testing.assert_allclose(result.steps[-1].plan.power_W[0], planned_W, rtol=1e-6)


def test_what_a_shared_machine_uses_is_in_no_actuators_record():
    seen = two_observation()
    boiler = replace(seen.history.names, machines=("boiler",))
    both = replace(seen.history, power_W=seen.history.power_W[:1], T_return_C=seen.history.T_return_C[:1], names=boiler)
    assert np.isnan(single_actuator_records(two_model(shared=True), both, None)[RADIATOR].power_W).all()
    own = single_actuator_records(two_model(), seen.history, None)[FLOOR]
    np.testing.assert_array_equal(own.power_W[0], seen.history.power_W[1])


@pytest.mark.parametrize("metered", [False, True])
def test_what_a_shared_machine_cannot_give_accuses_no_actuator(metered):
    """Both at once ask for more than it has: only a meter tells what each of them got."""
    model, seen = two_model(shared=True), two_observation().history
    T_out, u = np.full(seen.n_steps + 1, 5.0), np.zeros((2, seen.n_steps))
    u[:, 12:24], u[0, 24:36] = [[1.0], [0.4]], 1.0
    heat = np.where(u > 0, 2000.0, 0.0)
    heat[:, 12:24] = [[1800.0], [900.0]]
    names = replace(seen.names, machines=("boiler",))
    seen = replace(
        seen, T_out_C=T_out, u=u, heat_W=heat, power_W=seen.power_W[:1], T_return_C=seen.T_return_C[:1], names=names
    )
    if metered:
        full = HeatInput(MachineLoad((0.0, 0.0, 2000.0, 0.0), (-10.0, 15.0)))
        operator = model.operator.map_actuators(lambda a, pair: replace(pair, heat_input=full))
        model = replace(model, operator=operator)
    else:
        model = replace(model, shares=(0.7, 0.7))
    assert single_actuator_records(model, seen.slice(0, 0), None)[RADIATOR].n_steps == 0
    own = single_actuator_records(model, seen, None)[RADIATOR]
    expected = u[RADIATOR].copy()
    expected[12:24] = np.nan
    np.testing.assert_array_equal(own.u[0], expected)
    levels = applied_levels([(float(t), 1.0) for t in seen.time_s[:-1]], own, model.operator.pairs[0][0].heat_input)
    expected[12:24] = 0.9 if metered else np.nan
    np.testing.assert_allclose(levels, expected, atol=1e-6)


def test_the_predictor_of_those_that_went_on_is_kept_when_one_returns():
    """At steps below an hour the shadow of the one is older than the plans of the other."""
    seen = two_observation()
    state = first_state(seen).predictor
    history, weather = seen.history.slice(0, seen.history.n_steps - 1), seen.boundary
    before = Observation(history, replace(weather, time_s=weather.time_s - HOUR_S))
    older = mpc().predictor.context(before, None).state
    assert later_state(state, older) == replace(state, forced=None)
    assert later_state(older, state) is state
    assert later_state(None, older) is older


def test_a_plan_made_without_a_reading_is_not_followed_when_the_sensor_is_back():
    controller, seen = mpc(fails=True), two_observation()
    blind = controller.plan(silenced(seen, 0))
    later = replace(
        seen,
        history=replace(seen.history, time_s=seen.history.time_s + HOUR_S),
        boundary=replace(seen.boundary, time_s=seen.boundary.time_s + HOUR_S),
    )
    T = later.history.T_zone_C.copy()
    T[:, -1] = blind.T_zone_C[:, 0]
    later = replace(later, history=replace(later.history, T_zone_C=T))
    assert controller.plan(later, blind.state).acting == (PlanStatus.THERMOSTAT, PlanStatus.SHIFTED)


def test_the_gain_in_a_zone_without_a_reading_sees_the_mean_of_the_others():
    model, seen = two_model(), two_observation()
    weights = np.zeros_like(model.operator.pairs[0][0].hidden_weight)
    weights[0, 0] = 1.0
    output = np.zeros(weights.shape[0])
    output[0] = -0.3
    pair = replace(
        model.operator.pairs[0][0],
        hidden_weight=weights,
        output_weight=output,
        feature_mean=np.array([8.0, 0.0, 0.0, 0.0]),
        feature_scale=np.array([8.0, 5.0, 100.0, 1.0]),
    )
    operator = replace(model.operator, pairs=((pair, None), (None, pair)))
    predictor = mpc(replace(model, operator=operator)).predictor
    # The same levels in both zones, so that their control-free temperatures are the same where the readings are.
    u = np.repeat(seen.history.u[:1], 2, axis=0)
    known = replace(seen.history, u=u, T_zone_C=np.repeat(seen.history.T_zone_C[1:], 2, axis=0))
    silent = silenced(replace(seen, history=known), 0).history
    cut = known.n_steps - 5
    for begun in (known.n_steps, cut):
        states = []
        for history in (known, silent):
            state = predictor.followed(history.slice(0, begun))
            states.append(predictor.followed(history, PredictorState(state)).forced_K)
        np.testing.assert_allclose(states[1], states[0], atol=1e-12)
        assert np.abs(states[0]).max() > 1.0


def test_cooling_of_a_zone_costs_its_share_of_the_machine():
    both = two_model(shared=True)
    operator = both.operator.map_actuators(lambda _, pair: replace(pair, heat_input=HeatInput(u_min=-1.0)))
    law = replace(both.power[0].load, coefficients=(0.0, 0.0, 6000.0, 0.0))
    power = replace(both.power[0], load=law, cooling=replace(law, coefficients=(0.0, 0.0, 2000.0, 10.0)))
    model = replace(both, operator=operator, power=(power,), shares=(0.75, 0.25))
    seen, warm = two_observation(), TwoHouses(shared=True)
    warm.reset(10 * DAY_S, 2 * DAY_S)
    history = replace(
        seen.history,
        T_zone_C=seen.history.T_zone_C + np.array([[9.0], [7.0]]),
        power_W=seen.history.power_W[:1],
        T_return_C=seen.history.T_return_C[:1],
        names=SHARED,
    )
    rooms = {"mode": "room_setpoints", "block_s": 60.0}
    plan = mpc(model, actuation=rooms).plan(Observation(history, warm.forecast(24 * HOUR_S, HOUR_S)))
    assert plan.status is PlanStatus.SOLVED
    assert (plan.u.min(axis=1) < -0.1).all()
    level = np.array([0.75, 0.25]) @ np.maximum(-plan.u, 0.0)
    heating_W = 6000.0 * np.array([0.75, 0.25]) @ np.maximum(plan.u, 0.0)
    T_out_C = warm.forecast(24 * HOUR_S, HOUR_S).T_out_C[:-1]
    np.testing.assert_allclose(plan.power_W[0], heating_W + level * (2000.0 + 10.0 * T_out_C), rtol=1e-6, atol=0.1)


@pytest.mark.parametrize(("lowest_level", "cycles"), [(1.0, False), (0.4, True)])
def test_a_shared_machine_cycles_in_plans_below_the_load_of_its_law(lowest_level, cycles):
    model = two_model(shared=True)
    load = replace(model.power[0].load, lowest_level=lowest_level)
    model = replace(model, power=(replace(model.power[0], load=load),), shares=(0.3, 0.3))
    controller = ThermoForceMPC(model, MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    assert bool(controller.solver.model.structure.part_load) is cycles


def test_nothing_is_asked_for_in_hours_in_which_nothing_comes():
    """Of one actuator alone: the other one's hours are its own."""
    model, blocked = two_model(), (2, 3, 4)
    card = replace(model.cards[RADIATOR], blocked_hours=blocked)
    model = replace(model, cards=(card, model.cards[FLOOR]))
    plan = mpc(model).plan(two_observation(24, TwoHouses(SimpleHouse(18.0), SimpleHouse(18.0))))
    assert plan.u[RADIATOR, list(blocked)] == pytest.approx(0.0, abs=1e-6)
    free = [hour for hour in range(7) if hour not in blocked]
    assert (plan.u[RADIATOR, free] > 0.01).any()
    assert (plan.u[FLOOR, list(blocked)] > 0.01).any()


@pytest.mark.parametrize("warmer_K", [0.0, 9.0])
def test_where_levels_are_signed_hours_are_those_of_the_direction_that_a_zone_needs(warmer_K):
    """No heat comes from one actuator at night and no cold from the other."""
    both, night = two_model(), (2, 3, 4)
    operator = both.operator.map_actuators(lambda _, pair: replace(pair, heat_input=HeatInput(u_min=-1.0)))
    power = tuple(replace(one, cooling=replace(one.load, coefficients=(0.0, 0.0, 2000.0, 0.0))) for one in both.power)
    cards = (
        replace(both.cards[RADIATOR], blocked_hours=night),
        replace(both.cards[FLOOR], blocked_cooling_hours=night),
    )
    seen = two_observation(24, TwoHouses(SimpleHouse(18.0), SimpleHouse(18.0)))
    T_zone_C, nothing = seen.history.T_zone_C + warmer_K, np.zeros(seen.history.u.shape)
    history = replace(seen.history, T_zone_C=T_zone_C, u=nothing, power_W=nothing)
    plan = mpc(replace(both, operator=operator, power=power, cards=cards), actuation={"mode": "room_setpoints"}).plan(
        replace(seen, history=history)
    )
    shut, free = (FLOOR, RADIATOR) if warmer_K else (RADIATOR, FLOOR)
    assert plan.u[shut, list(night)] == pytest.approx(0.0, abs=1e-6)
    assert (np.abs(plan.u[free, list(night)]) > 0.01).all()
    assert (plan.u[free, list(night)] < 0.0).all() == (warmer_K > 0.0)
