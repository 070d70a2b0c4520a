"""What a controller knows of a run is a value: plans depend on it and on the observation, and on nothing else."""

from __future__ import annotations

import functools
import itertools
from dataclasses import replace

import numpy as np
import pytest
from faults import FAILED, ChangedSolver
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers.actuation.actuator import Actuation, ActuationConfig, ActuationState
from controllers.monitoring.watch import WatchState
from controllers.mpc.acting import NoModelController
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from controllers.mpc.state import MPCState
from controllers.rules.native import NativeController
from controllers.rules.pi import PIConfig, PIController
from controllers.rules.thermostat import Thermostat, ThermostatState
from controllers.safety.fallback_policy import FallbackConfig
from controllers.state_classes import STATE_CLASSES
from thermoforce_mpc.data import DAY_S, HOUR_S, Layout, Observation
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.free_response.calibrated import CalibratedFreeResponse
from thermoforce_mpc.model.free_response.linear_weather import LinearWeather
from thermoforce_mpc.state_file import StateFormat


def mpc(**options) -> ThermoForceMPC:
    config = MPCConfig(**{"step_s": None, "horizon_h": 24.0, **options})
    return ThermoForceMPC(simple_model(), config, free_response=CalibratedFreeResponse(LinearWeather()))


CONTROLLERS = {
    "thermostat": Thermostat,
    "pi": PIController,
    "native": NativeController,
    "qp": mpc,
    "held levels": lambda: mpc(actuation={"mode": "modulating"}),
    "ipopt": lambda: mpc(solver="ipopt", actuation={"mode": "modulating"}),
}


class Watched:
    """Passes plans on and keeps what they were made from."""

    def __init__(self, inner) -> None:
        self.inner, self.name, self.step_s, self.horizon_s = inner, inner.name, inner.step_s, inner.horizon_s
        self.calls = []

    def plan(self, observation, state=None):
        plan = self.inner.plan(observation, state)
        self.calls.append((observation, state, plan))
        return plan


def run(controller, T_start_C: float = 21.0):
    house = SimpleHouse(T_start_C)
    return run_closed_loop(house, controller, replace(house.period("x"), scored_s=DAY_S))


@functools.cache
def watched_run(kind: str):
    """A controller of this kind after its first run, with what it was called with, and the KPIs."""
    watched = Watched(CONTROLLERS[kind]())
    return watched, run(watched).kpis


def same(a, b) -> None:
    assert (a.blocks, a.status, a.why) == (b.blocks, b.status, b.why)
    for name in ("u", "T_free_C", "T_forced_K", "slack_K"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.mark.slow
@pytest.mark.parametrize("kind", CONTROLLERS)
def test_the_same_observation_and_state_give_the_same_plan_in_any_order(kind):
    watched, _ = watched_run(kind)
    for observation, state, plan in reversed(watched.calls[::5]):
        same(watched.inner.plan(observation, state), plan)


@pytest.mark.slow
@pytest.mark.parametrize("kind", CONTROLLERS)
def test_one_controller_serves_two_runs_alternately(kind):
    colder = Watched(CONTROLLERS[kind]())
    run(colder, T_start_C=18.0)
    alone = (watched_run(kind)[0], colder)
    shared, states = CONTROLLERS[kind](), [None, None]
    for calls in zip(alone[0].calls, alone[1].calls, strict=True):
        for i, (observation, _, plan) in enumerate(calls):
            ours = shared.plan(observation, states[i])
            states[i] = ours.state
            same(ours, plan)


@pytest.mark.slow
@pytest.mark.parametrize("kind", CONTROLLERS)
def test_twice_on_the_same_window_is_twice_the_same(kind):
    watched, first = watched_run(kind)
    second = run(watched.inner).kpis
    for name in ("tdis_tot", "cost_tot"):
        assert first[name] == second[name]


def test_the_state_of_another_controller_is_refused():
    house = SimpleHouse()
    house.reset(10 * DAY_S, 2 * DAY_S)
    for controller in (mpc(), PIController()):
        seen = Observation(house.past(controller.step_s), house.forecast(controller.horizon_s, controller.step_s))
        with pytest.raises(DataError, match="state is a ThermostatState, expected None"):
            controller.plan(seen, ThermostatState((True,)))


@pytest.mark.parametrize("build", [mpc, PIController])
def test_the_state_of_a_later_plan_is_refused(build):
    """Of another run, or of a record whose seconds count from the next new year."""
    controller, state, house = build(), None, SimpleHouse()
    for day in (300, 10):
        house.reset(day * DAY_S, 2 * DAY_S)
        seen = Observation(house.past(controller.step_s), house.forecast(controller.horizon_s, controller.step_s))
        if state is None:
            state = controller.plan(seen).state
            controller.plan(seen, state)  # the same step once more
    with pytest.raises(DataError, match="state is of a plan at 25920000 s, later than the observation at 864000 s"):
        controller.plan(seen, state)


@pytest.mark.slow
@pytest.mark.parametrize("follow_steps", [0, 1])
def test_minimum_times_hold_whatever_acts(follow_steps, monkeypatch):
    monkeypatch.setattr(FallbackConfig, "follow_steps", follow_steps)
    # The forecaster is exact at hourly steps only, which the watch would notice.
    config = MPCConfig(step_s=900.0, horizon_h=6.0, watch={"enabled": False})
    draw = np.random.default_rng(follow_steps)
    solver = ChangedSolver(config, lambda n, found: FAILED if draw.random() < 0.4 else found)
    controller = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse(), solver=solver)
    house = SimpleHouse(T_start_C=20.6)
    result = run_closed_loop(house, controller, house.period("x"))
    assert result.fallback_levels()["solved"] > 50
    assert result.fallback_levels()["thermostat"] > 20
    runs = [
        (level, sum(duration for _, duration in group))
        for level, group in itertools.groupby(house.applied, key=lambda block: block[0])
    ]
    assert not [(level, duration) for level, duration in runs[1:-1] if duration < 600.0]


def test_the_peak_of_a_run_is_that_of_the_steps_that_it_made():
    house = SimpleHouse()
    house.reset(10 * DAY_S, DAY_S)
    record, ahead = house.past(HOUR_S), house.forecast(6 * HOUR_S, HOUR_S)

    def peak_W(last_W: float, before: MPCState) -> float:
        power_W = np.full((1, record.n_steps), 500.0)
        power_W[0, :2], power_W[0, -2:] = np.nan, (4000.0, last_W)
        return before.peak_after(Observation(replace(record, power_W=power_W), ahead))

    now_s = float(record.time_s[-1])
    assert peak_W(3000.0, MPCState(now_s)) == 0.0, "steps before the first plan were not its own"
    assert peak_W(3000.0, MPCState(now_s - HOUR_S)) == 3000.0
    assert peak_W(3000.0, MPCState(now_s - HOUR_S, peak_W=3500.0)) == 3500.0
    assert peak_W(np.nan, MPCState(now_s - HOUR_S, peak_W=3500.0)) == 3500.0
    unknown = Observation(replace(record, power_W=np.full((1, record.n_steps), np.nan)), ahead)
    assert MPCState(now_s).peak_after(unknown, "month") == 0.0


def test_after_a_plan_that_did_not_act_its_own_request_alone_is_not_known():
    asked = ((0.0, 0.5), (3600.0, 0.7), (7200.0, 0.2))
    state = MPCState(0.0, watch=(WatchState(asked=asked), WatchState()), actuation=(ActuationState(on=True),) * 2)
    kept = state.not_followed()
    assert kept.watch[0].asked[:2] == asked[:2]
    assert kept.watch[0].asked[2][0] == 7200.0
    assert np.isnan(kept.watch[0].asked[2][1])
    assert (len(kept.watch[0].asked), kept.watch[1].asked) == (3, ())
    assert all(one.native for one in kept.actuation)


def after(u: list[float]) -> tuple[np.ndarray, float]:
    """Levels of steps of a quarter of an hour."""
    return np.array(u), 900.0


@pytest.mark.parametrize(
    ("u", "on", "held_s"),
    [
        ([1.0, 1.0, 0.0], False, 900.0),
        ([0.0, 0.0, 0.0], False, 2700.0),
        ([0.3, 1.0, 1.0], True, 1800.0),
        ([0.0, 0.4], True, 360.0),  # it came on
        ([1.0, 0.4], False, 0.0),  # it may just have gone off
        ([0.4], False, 0.0),
        ([0.0, 0.5, 0.6, 0.7], True, 2700.0),  # it modulates
        ([np.nan, 0.5], False, 0.0),
    ],
)
@pytest.mark.parametrize("state", [None, ActuationState(native=True)], ids=["a run begins", "after native control"])
def test_what_native_control_did_is_seen_in_the_history(u, on, held_s, state):
    assert Actuation(ActuationConfig()).now(state, *after(u)) == ActuationState(on, held_s)


@pytest.mark.parametrize(
    ("u", "starts_s"),
    [
        ([1.0, 1.0, 1.0, 1.0, 1.0], ()),
        ([0.0, 1.0, 0.0, 0.5, 1.0], (1350.0,)),  # the first was an hour ago
        ([1.0, 0.0, 1.0, 0.0, 0.2], (180.0, 2700.0)),
        ([0.0, 0.0, 0.4, 0.0, np.nan], (2160.0,)),  # as late as it can have been
    ],
)
def test_starts_of_the_last_hour_are_seen_in_the_history(u, starts_s):
    limited = Actuation(ActuationConfig(starts_per_hour=2))
    assert limited.now(None, *after(u)).starts_s == pytest.approx(starts_s)
    assert Actuation(ActuationConfig()).now(None, *after(u)).starts_s == ()


def test_limits_of_starts_hold_over_a_restart(tmp_path):
    """It was started 20 minutes ago, and stopped: the state in its file says so."""
    limits = {"mode": "duty", "block_s": 300.0, "min_on_s": 300.0, "min_off_s": 300.0, "starts_per_hour": 1}
    config = MPCConfig(step_s=None, horizon_h=3.0, actuation=limits)
    house = SimpleHouse(T_start_C=15.0)
    house.reset(10 * DAY_S, 2 * DAY_S)
    record, weather = house.past(HOUR_S), house.forecast(6 * HOUR_S, HOUR_S)
    first = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse()).plan(Observation(record, weather))
    stopped = ActuationState(on=False, held_s=600.0, starts_s=(1200.0,))
    kept = StateFormat(STATE_CLASSES)
    kept.write(tmp_path / "state.npz", replace(first.state, actuation=(stopped,)))
    later = Observation(
        replace(record, time_s=record.time_s + HOUR_S), replace(weather, time_s=weather.time_s + HOUR_S)
    )
    again = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse())
    plan = again.plan(later, kept.read(tmp_path / "state.npz"))
    assert plan.u[0, 0] == pytest.approx(1.0), "it is cold"
    assert [(block.u[0], block.duration_s) for block in plan.blocks] == [(0.0, 2400.0), (1.0, 1200.0)]
    assert plan.state.actuation[0].starts_s == (1200.0,)


LONG = {"mode": "duty", "min_on_s": 7200.0, "min_off_s": 7200.0}
ACTING = {
    "mpc": lambda: mpc(actuation=LONG),
    "pi": lambda: PIController(PIConfig(step_s=HOUR_S, actuation=LONG)),
    "standing back": lambda: NoModelController(
        "",
        MPCConfig(step_s=None, actuation=LONG, fallback={"stand_back": "rule"}),
        Layout.single("heating"),
        HOUR_S,
        name="",
    ),
}


@pytest.mark.parametrize(("step_s", "horizon_h"), [(900.0, 3.0), (2 * HOUR_S, 4.0), (6 * HOUR_S, 6.0)])
def test_without_a_model_a_forecast_is_needed_as_far_as_the_rule_looks_ahead(step_s, horizon_h):
    """Whole steps that hold the three hours in which it heats for a bound."""
    rule = MPCConfig(step_s=None, fallback={"stand_back": "rule"})
    controller = NoModelController("no record", rule, Layout.single("heating"), step_s, name="")
    assert controller.horizon_s == horizon_h * HOUR_S


@pytest.mark.parametrize("kind", ACTING)
@pytest.mark.parametrize("missed", [0, 1, 2])
def test_minimum_times_hold_after_steps_without_a_plan(kind, missed):
    house, controller = SimpleHouse(T_start_C=15.0), ACTING[kind]()
    house.reset(10 * DAY_S, 6 * DAY_S)
    record, weather = house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S)

    def seen(k: int, last: list[float]) -> Observation:
        u = np.array(record.u)
        u[0, -len(last) :] = last
        ahead = replace(weather, time_s=weather.time_s + k * HOUR_S)
        return Observation(replace(record, time_s=record.time_s + k * HOUR_S, u=u), ahead)

    plan = controller.plan(seen(0, [0.0, 0.0, 0.0]))
    assert plan.blocks[-1].u[0] == 1.0, "it is switched on"
    # Native control, which acted in the hours without a plan, has switched it off in the last one.
    plan = controller.plan(seen(1 + missed, [1.0, 1.0, 0.0]), plan.state)
    assert [block.u[0] for block in plan.blocks] == [0.0 if missed else 1.0]


def test_what_was_told_counts_where_nobody_else_acted():
    told = ActuationState(on=True, held_s=300.0, owed_s=60.0)
    assert Actuation(ActuationConfig()).now(told, *after([0.0])) == told


def test_a_machine_that_was_not_seen_may_just_have_switched_off():
    actuation = Actuation(ActuationConfig())
    assert actuation.now(ActuationState(native=True), *after([np.nan])) == ActuationState(on=False, held_s=0.0)
    blocks, _ = actuation.realise(1.0, 900.0, actuation.now(ActuationState(native=True), *after([1.0, 0.5])))
    assert [(block.u[0], block.duration_s) for block in blocks] == [(0.0, 600.0), (1.0, 300.0)]


def test_after_a_silent_sensor_and_native_control_the_minimum_off_time_holds():
    config = MPCConfig(step_s=None, horizon_h=6.0)
    controller = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse())
    house = SimpleHouse(T_start_C=19.0)
    house.reset(10 * DAY_S, 2 * DAY_S)
    history = house.past(HOUR_S)
    silent = replace(history, T_zone_C=np.full(history.time_s.size, np.nan))
    plan = controller.plan(Observation(silent, house.forecast(6 * HOUR_S, HOUR_S)))
    assert [block.u for block in plan.blocks] == [(None,)]
    # Native control ran for a part of the hour and may have stopped just now.
    told = replace(history, u=np.ones(history.n_steps))
    later = told.extended(replace(house.advance(None, HOUR_S), u=0.4))
    cold = replace(later, T_zone_C=later.T_zone_C - 3.0)
    plan = controller.plan(Observation(cold, house.forecast(6 * HOUR_S, HOUR_S)), plan.state)
    assert [(block.u[0], block.duration_s) for block in plan.blocks] == [(0.0, 600.0), (1.0, 3000.0)]
