"""A room with a heating and a cooling coil that exclude one another: whoever decides, one of them acts in a step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from faults import FAILED, ChangedSolver
from hypothesis import example, given, settings
from hypothesis import strategies as st
from simple_house import GAIN_K, POLE, OutdoorResponse, SimpleHouse, simple_model

from controllers.actuation.actuator import Actuation, ActuationConfig, ActuationState
from controllers.actuation.actuators import Actuators
from controllers.mpc.acting import NoModelController
from controllers.mpc.controller import ThermoForceMPC
from controllers.optimisation.solution import Solution
from controllers.registry import build_controller
from controllers.rules.pi import PIController
from controllers.rules.thermostat import Thermostat
from thermoforce_mpc.data import CONDITIONS, DAY_S, HOUR_S, Layout, Measurement, Names, Observation, PlanStatus, Record
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.identification.probing.probe import ProbingConfig
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.model.card import Competence
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel, load_model
from thermoforce_mpc.plants.shell import check_levels
from thermoforce_mpc.scenario.settings import validate
from thermoforce_mpc.scenario.testcase import TestCase

NAMES = Names(("room",), ("heating_coil", "cooling_coil"), ("boiler", "chiller"))
HEAT, COOL = range(2)
TESTCASE = {
    "name": "coils",
    "description": "a room with two coils",
    "step_s": 3600,
    "measurements": {"outdoor_temperature": "T_out", "solar": "sun"},
    "zones": {
        "room": {"temperature": "T", "floor_area_m2": 50, "occupancy": "n", "lower": "low", "upper": "high"},
    },
    "actuators": {
        "heating_coil": {"point": "uHea", "zone": "room", "machine": "boiler"},
        "cooling_coil": {"point": "uCoo", "zone": "room", "machine": "chiller", "mode": "cooling"},
    },
    "machines": {"boiler": {"power": ["PBoi"]}, "chiller": {"power": ["PChi"]}},
    "exclusive": [["heating_coil", "cooling_coil"]],
}


class Room(SimpleHouse):
    """The simple house with a cooling coil as strong; the band, 0.4 K wide and 2 K lower by day, needs both."""

    names = NAMES

    def measure(self, u=np.nan, cooling=np.nan):
        one = super().measure(u)
        both = [super(Room, self).measure(level) for level in (u, cooling)]

        def rows(name):
            return np.array([getattr(part, name)[0] for part in both])

        return Measurement(
            one.time_s, one.T_zone_C, one.T_out_C, 0.0, rows("u"), rows("power_W"), rows("heat_W"), names=NAMES
        )

    def step(self, u, duration_s):
        heating, cooling = (None, None) if u is None else u
        cooling = 0.0 if cooling is None else cooling
        super().step(heating, duration_s)
        share = duration_s / HOUR_S
        self.T -= GAIN_K / (1 - POLE) * (1 - POLE**share) * cooling
        used = self._rows[-1][1].u[0]
        self._rows[-1] = (duration_s, self.measure(used, cooling))
        return self._rows[-1][1]

    def advance(self, u, duration_s):
        levels = check_levels(u, duration_s, names=NAMES).u
        self.applied.append((levels, duration_s))
        return self.step(levels, duration_s)

    def forecast(self, horizon_s, interval_s):
        one = super().forecast(horizon_s, interval_s)
        rows = {name: getattr(one, name) for name in CONDITIONS}
        for name in ("price_per_kWh", "emission_kg_per_kWh", "heating_price_per_kWh"):
            rows[name] = np.repeat(rows[name], 2, axis=0)
        night = rows["lower_C"] > 20.0
        rows["lower_C"], rows["upper_C"] = np.where(night, 21.0, 19.0), np.where(night, 21.4, 19.4)
        return replace(one, **rows, names=NAMES)

    def past(self, step_s):
        m = [self._first, *(row for _, row in self._rows)] if step_s == HOUR_S else [self.measure()]
        weather = {name: np.array([getattr(x, name) for x in m]) for name in ("time_s", "T_out_C", "solar_W_m2")}
        acting = {name: np.array([getattr(x, name) for x in m[1:]]).T for name in ("u", "power_W", "heat_W")}
        acting = {name: rows.reshape(2, -1) for name, rows in acting.items()}
        return Record(**weather, T_zone_C=np.array([x.T_zone_C for x in m]).T, **acting, names=NAMES)


def model(verdicts=(None, None), exclusive=()) -> ThermalModel:
    zone = simple_model().only
    cooling = replace(zone.operator, sign=-1, gains=-zone.operator.gains)
    operator = BuildingOperator(NAMES.zones, NAMES.actuators, ((zone.operator, cooling),), (0, 0))
    cards = tuple(replace(zone.card, competence=one) for one in verdicts)
    return ThermalModel(operator, (zone.power,) * 2, (None,), cards, NAMES.machines, (0, 1), (0.0, 0.0), exclusive)


def coils(**changes) -> TestCase:
    return validate(TestCase, {**TESTCASE, **changes}, "coils.yaml")


def mpc(verdicts=(None, None), case=None, changed=lambda n, found: found, **options):
    options = {"step_s": None, "horizon_h": 24.0, "free_response": {"name": "persistence"}, **options}
    built = build_controller("thermoforce_mpc", options, case or coils(), model(verdicts))
    solver = ChangedSolver(built.config, changed)
    return ThermoForceMPC(built.model, built.config, free_response=OutdoorResponse(), solver=solver)


def observation(plant=None, T_C=None, start_s=10 * DAY_S) -> Observation:
    plant = plant or Room()
    plant.reset(start_s, DAY_S)
    history = plant.past(HOUR_S)
    if T_C is not None:
        T = history.T_zone_C.copy()
        T[:, -1] = T_C
        history = replace(history, T_zone_C=T)
    return Observation(history, plant.forecast(DAY_S, HOUR_S))


def acting(plan) -> set[int]:
    return {a for block in plan.blocks for a, u in enumerate(block.u) if u}


@pytest.mark.parametrize(
    ("exclusive", "message"),
    [
        (
            [["heating_coil", "cooling_coi"]],
            r"coils.yaml.*exclusive\[0\]: there is no actuator 'cooling_coi'.*cooling_",
        ),
        ([["heating_coil"]], r"coils.yaml.*exclusive\[0\]: \['heating_coil'\]: name two or more"),
        ([["heating_coil", "cooling_coil"], []], r"coils.yaml.*exclusive\[1\]: \[\]: name two or more"),
        ([["heating_coil", "heating_coil"]], r"coils.yaml.*exclusive\[0\]: 'heating_coil' stands there twice"),
        ("heating_coil", r"coils.yaml.*exclusive"),
    ],
    ids=["unknown", "one", "none", "twice", "no list"],
)
def test_a_group_that_is_none_is_refused_by_file_and_key(exclusive, message):
    with pytest.raises(ConfigError, match=f"(?s){message}"):
        coils(exclusive=exclusive)


def test_room_setpoints_and_a_file_of_one_actuator_exclude_nothing():
    rooms = {
        "kind": "room_setpoints", "heating": "a", "cooling": "b", "minimum": 285, "maximum": 305, "heating_W": 1000,
        "cooling_W": 1000, "zone": "room", "machine": "chiller", "heat": ["Q"],
    }  # fmt: skip
    with pytest.raises(ConfigError, match=r"exclusive\[0\]: 'cooling_coil' is of kind room_setpoints"):
        coils(actuators={**TESTCASE["actuators"], "cooling_coil": rooms})
    single = {name: TESTCASE[name] for name in ("name", "description", "exclusive", "measurements")}
    with pytest.raises(ConfigError, match="exclusive belong to zones"):
        validate(TestCase, single, "one.yaml")
    layout = coils().layout
    with pytest.raises(DataError, match="cooling_coil is run by room set-points"):
        replace(layout, u_min=(0.0, -1.0))
    with pytest.raises(DataError, match="expected two or more of 2 actuators"):
        replace(layout, exclusive=((0, 2),))


def test_the_group_reaches_model_file_layout_and_programme(tmp_path):
    assert coils().layout.exclusive == ((HEAT, COOL),)
    model(exclusive=((HEAT, COOL),)).save(tmp_path / "model")
    assert load_model(tmp_path / "model").layout.exclusive == ((HEAT, COOL),)
    seen = observation()

    def exclusive(controller):
        return controller.instance(controller.predictor.context(seen), seen.history).machinery.exclusive

    assert exclusive(mpc()) == ((HEAT, COOL),), "also to a model that was identified without it"
    assert exclusive(mpc(case=coils(exclusive=[]))) == ()


@pytest.mark.slow
@pytest.mark.parametrize("actuation", [{"mode": "duty"}, {"mode": "modulating", "lowest_level": 0.3}])
def test_in_closed_loop_one_coil_acts_in_a_step_and_the_room_is_kept(actuation):
    period = replace(SimpleHouse().period("x"), scored_s=1.5 * DAY_S)
    result = run_closed_loop(Room(), mpc(actuation=actuation), period)
    used = [acting(step.plan) for step in result.steps]
    assert all(len(one) <= 1 for one in used)
    assert {HEAT} in used
    assert {COOL} in used
    assert {status for step in result.steps for status in step.plan.acting} <= {
        PlanStatus.SOLVED, PlanStatus.ACCEPTABLE, PlanStatus.GUARD,
    }  # fmt: skip
    T, low, high = (np.array([getattr(s, name) for s in result.samples]) for name in ("T_zone_C", "lower_C", "upper_C"))
    outside_K = np.maximum(np.maximum(low - T, T - high), 0.0)
    assert np.median(outside_K) < 0.05, "the band moves by 2 K in an instant, the room by 0.6 K/h"
    assert outside_K.mean() < 0.3
    for step in result.steps:
        assert np.count_nonzero(step.plan.u[:, 0]) <= 1


# At whole hours the on/off rule's levels would act, which cost less than these.
_BETWEEN_HOURS_S = 10 * DAY_S + 900.0


def always(*levels: float):
    """Every solution is these levels."""
    return lambda n, found: Solution(True, np.repeat(np.array(levels)[:, None], 24, axis=1), "given", 1, "")


def test_a_rule_that_would_heat_and_cool_does_one_of_them():
    """The set-points of the on/off rules, 0.3 K inside a band of 0.4 K, overlap."""
    seen = observation(T_C=21.2)
    free, bound = (mpc(case=case, changed=lambda n, found: FAILED) for case in (coils(exclusive=[]), coils()))
    assert acting(free.plan(seen)) == {HEAT, COOL}, "else this tries nothing"
    plan = bound.plan(seen)
    assert plan.status is PlanStatus.THERMOSTAT
    assert acting(plan) == {HEAT}
    assert "cooling_coil: excluded by heating_coil" in plan.why


def test_a_solution_that_has_both_on_is_not_followed_in_both():
    controller = mpc(changed=always(0.4, 0.9), guard={"enabled": False})
    plan = controller.plan(observation(T_C=21.2, start_s=_BETWEEN_HOURS_S))
    assert acting(plan) == {COOL}
    assert "heating_coil: excluded by cooling_coil" in plan.why


def test_the_guard_comes_before_the_plan():
    controller = mpc(changed=always(0.0, 1.0))
    plan = controller.plan(observation(T_C=17.0, start_s=_BETWEEN_HOURS_S))
    assert plan.status is PlanStatus.GUARD
    assert acting(plan) == {HEAT}


@pytest.mark.parametrize("closed", [HEAT, COOL])
def test_native_control_of_one_leaves_the_other_to_it_too(closed):
    verdicts = [None, None]
    verdicts[closed] = Competence(False, reasons=("it errs",), effect_K=7.0, effect_sd_K=5.0)
    seen, other = observation(), 1 - closed
    plan = mpc(tuple(verdicts)).plan(seen)
    assert [block.u for block in plan.blocks] == [(None, None)]
    assert plan.acting[closed] is PlanStatus.GATE
    assert plan.acting[other] is PlanStatus.NATIVE
    excluded = f"{NAMES.actuators[other]}: excluded by {NAMES.actuators[closed]}, which is native: native control"
    assert excluded in plan.why
    apart = mpc(tuple(verdicts), coils(exclusive=[])).plan(seen)
    assert {block.u[other] is None for block in apart.blocks} == {False}


def test_rules_and_standing_back_keep_the_group():
    seen, layout = observation(T_C=21.2), coils().layout
    alone = replace(layout, exclusive=())
    config = mpc(fallback={"stand_back": "rule"}).config
    for build in (
        lambda where: PIController(PIController().config.model_copy(update={"kp": 8.0}), where),
        lambda where: NoModelController("no data", config, where, HOUR_S, name="x"),
        lambda where: Thermostat(
            Thermostat().config.model_copy(update={"setpoints_C": {"heating_coil": 21.5, "cooling_coil": 20.5}}), where
        ),
    ):
        assert acting(build(alone).plan(seen)) == {HEAT, COOL}, "else this tries nothing"
        plan = build(layout).plan(seen)
        assert len(acting(plan)) == 1
        assert "_coil: excluded by " in plan.why


def test_probing_never_has_both_on():
    config = ProbingConfig(step_s=3600.0, hold_steps=(1, 2, 4), design="random", warmup_days=1.0)
    both, one = (
        probe(Room(), 10 * DAY_S, 2.0, seed=3, layout=replace(coils().layout, exclusive=groups), config=config).u
        for groups in ((), ((HEAT, COOL),))
    )
    assert (both > 0).all(axis=0).any(), "else this tries nothing"
    assert not (one > 0).all(axis=0).any()
    assert (one > 0).any(axis=1).all()


GROUPS = ((0, 1), (1, 2))
NATIVE_OR_LEVEL = st.none() | st.just(0.0) | st.floats(0, 1)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@example([(0.0, 0.0, 0.0, None)], (0, 1, 0, 0), [False, True, True, False])
@given(
    st.lists(st.tuples(*[NATIVE_OR_LEVEL] * 4), min_size=1, max_size=12),
    st.sampled_from([(0, 1, 2, 3), (0, 0, 0, 1), (0, 1, 0, 0)]),
    st.lists(st.booleans(), min_size=4, max_size=4),
)
def test_whatever_is_asked_in_whatever_state_one_of_a_group_acts(asked, machine_of, on):
    machines = tuple(f"machine {m}" for m in range(max(machine_of) + 1))
    names = Names(("room",), tuple(f"actuator {a}" for a in range(4)), machines)
    four = (0.0,) * 4
    layout = Layout(names, (1,) * 4, (0,) * 4, machine_of, four, (0.25,) * 4, (np.nan,), GROUPS)
    actuations = [Actuation(ActuationConfig(mode="duty"))] * 3 + [Actuation(ActuationConfig(mode="modulating"))]
    actuators, states = Actuators(layout, actuations), tuple(ActuationState(one, 300.0) for one in on)
    for demands in asked:
        acted = actuators.realise(list(demands), 900.0, states)
        states = tuple(ActuationState(True, 300.0) if state.native else state for state in acted.states)
        levels = [{block.u[0] for block in blocks} for blocks in acted.blocks]
        for group in GROUPS:
            native = [a for a in group if None in levels[a]]
            assert len(native) in (0, len(group)), "native control alone, or not at all"
            assert sum(any(levels[a]) for a in group) <= 1
        assert all(sum(block.duration_s for block in blocks) == pytest.approx(900.0) for blocks in acted.blocks)
        for a in acted.excluded:
            assert not any(levels[a])


def test_one_of_a_group_is_not_set_by_a_command():
    """A command does not tell whether what answers to it runs; a level of 0 in its place would be a command of 0."""
    learned = dict.fromkeys(["heating_coil"])
    with pytest.raises(ConfigError, match="heating_coil excludes others, and is set by a command"):
        ThermoForceMPC(model(exclusive=((HEAT, COOL),)), commands=learned)
