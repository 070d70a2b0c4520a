"""The watch: a plant that changed is noticed, control handed back, and returned once predictions hold again."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from faults import FaultyHouse, draught_K
from simple_house import FIXED_W, GAIN_K, PER_U_W, POLE, OutdoorResponse, SimpleHouse, native_level, simple_model

from controllers import ThermoForceMPC
from controllers.monitoring.watch import (
    Issued,
    Judged,
    Track,
    Watch,
    WatchConfig,
    WatchState,
    applied_levels,
    e_value,
    effect_fault,
    level_fault,
    level_shift,
    machine_ratio,
    missing_effect,
)
from controllers.mpc.config import MPCConfig
from controllers.registry import controller_config
from controllers.safety.fallback_policy import FallbackConfig, FallbackPolicy, GoodPlan
from thermoforce_mpc.data import DAY_S, HOUR_S, Observation, PlanStatus, Record
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel, ZoneModel
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.report.display import RunDisplay
from thermoforce_mpc.report.findings import watch_spells

FROM_S, TO_S = 12 * DAY_S, 13.5 * DAY_S


def faulty(fault: str, to_s: float = TO_S) -> FaultyHouse:
    """The simple house with a fault for a day and a half from day 2 of the run on; a moved sensor hangs outdoors."""

    def now(begun_s: float) -> str:
        return fault if FROM_S <= begun_s < to_s else "none"

    def gives(house, u):
        weak = 0.5 * (native_level(house.T) if u is None else u)
        given = {"weak": weak, "weak unseen": weak, "stuck": 0.0, "stuck unseen": 0.0, "overridden": None}
        return given.get(now(house.began_s), u)

    def shows(house, seen):
        if now(house.now_s) == "sensor":
            seen = replace(seen, T_zone_C=0.6 * house.T + 0.4 * seen.T_out_C)
        if now(house.began_s) == "weak":
            seen = replace(seen, u=2.0 * seen.u)
        if now(house.began_s).endswith("unseen"):
            seen = replace(seen, u=np.nan if house.asked is None else house.asked, power_W=np.nan, heat_W=np.nan)
        return seen

    def moves(house, hours):
        return draught_K(house, 0.05, hours) if now(house.now_s) == "window" else 0.0

    return FaultyHouse(shows, gives=gives, moves=moves)


def run(fault: str, days: float = 6.0, **options: object) -> RunResult:
    options = {"step_s": None, "horizon_h": 24.0, **options}
    mpc = ThermoForceMPC(simple_model(), MPCConfig(**options), free_response=OutdoorResponse())
    house = faulty(fault)
    return run_closed_loop(house, mpc, replace(house.period("x"), scored_s=days * DAY_S))


@functools.cache
def changed(fault: str) -> RunResult:
    """A reading that jumps by 8 K is not believed; here the watch is to find out alone."""
    return run(fault, sensor={"enabled": fault != "sensor"})


@functools.cache
def window_without_watch() -> RunResult:
    return run("window", watch={"enabled": False})


def watched(result: RunResult) -> list[float]:
    return [step.time_s for step in result.steps if step.plan.status is PlanStatus.WATCH]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ("weak", "the machine's power was"),
        ("weak unseen", "acting has less effect than predicted"),
        ("window", "than predicted"),
        ("sensor", "than predicted"),
        ("stuck", "the actuator does not follow"),
        ("stuck unseen", "than predicted"),
        ("overridden", ""),  # by the level or by the meter, whichever is first
    ],
)
def test_a_changed_plant_is_noticed_within_a_day_and_control_returns(fault, says):
    result = changed(fault)
    spells = watch_spells(result)
    assert spells, "noticed"
    assert FROM_S < spells[0].start_s <= FROM_S + DAY_S
    assert says in spells[0].why
    assert spells[0].why.endswith("native control")
    assert spells[0].end_s - spells[0].start_s >= 12 * HOUR_S
    for spell in spells:
        assert spell.why_back, "control returned, with a reason"
        assert spell.end_s <= TO_S + 2 * DAY_S
    inside = [s for s in result.steps if spells[0].start_s <= s.time_s < spells[0].end_s]
    assert all(sample.u_applied == (None,) for step in inside for sample in step.samples)


@pytest.mark.slow
def test_without_a_change_nothing_is_noticed_and_plans_are_the_same():
    with_watch, alone = run("none", 4.0), run("none", 4.0, watch={"enabled": False})
    assert watched(with_watch) == []
    for ours, theirs in zip(with_watch.steps, alone.steps, strict=True):
        np.testing.assert_array_equal(ours.plan.u, theirs.plan.u)
    assert with_watch.kpis | {"time_rat": 0.0} == alone.kpis | {"time_rat": 0.0}


@pytest.mark.slow
def test_off_it_does_not_notice_and_the_papers_settings_leave_it_off():
    assert watched(window_without_watch()) == []
    testcase = load_testcase("bestest_hydronic_heat_pump")
    assert controller_config("thermoforce_mpc", {}, testcase).watch.enabled
    assert not controller_config("thermoforce_paper", {}, testcase).watch.enabled


@pytest.mark.slow
def test_the_rule_can_act_instead_and_keeps_the_zone_warm():
    result = run("window", fallback={"stand_back": "rule"})
    steps = [step for step in result.steps if step.plan.status is PlanStatus.WATCH]
    assert steps
    assert all(sample.u_applied in ((0.0,), (1.0,)) for step in steps for sample in step.samples)
    assert result.kpis["tdis_tot"] <= 1.05 * window_without_watch().kpis["tdis_tot"]


@pytest.mark.slow
def test_a_machine_that_stays_weak_is_adapted_to():
    mpc = ThermoForceMPC(simple_model(), MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    house = faulty("weak", to_s=np.inf)
    result = run_closed_loop(house, mpc, replace(house.period("x"), scored_s=9 * DAY_S))
    assert watched(result)
    assert result.steps[-1].plan.status is PlanStatus.SOLVED
    found = result.state.adaptation[0].model.operator.gains[0] / simple_model().only.operator.gains[0]
    assert found == pytest.approx(0.5, abs=0.12)
    assert any("the model adapted since" in spell.why_back for spell in watch_spells(result))


@pytest.mark.slow
@pytest.mark.parametrize("stand_back", ["native", "rule"])
def test_a_weak_machine_whose_heat_is_metered_is_adapted_to_once(stand_back):
    def share(begun_s: float) -> float:
        return 0.5 if begun_s >= FROM_S else 1.0

    def shows(house, seen):
        given = share(house.began_s)
        heat_W = 10_000.0 * seen.u
        return replace(seen, u=seen.u / given, heat_W=heat_W, power_W=0.4 * heat_W)

    def gives(house, u):
        return share(house.began_s) * (native_level(house.T) if u is None else u)

    law = MachineLoad((0.0, 0.0, 10_000.0, 0.0), (-20.0, 30.0))
    model = ThermalModel.single(
        linear_operator(np.array([POLE]), np.array([GAIN_K]), step_s=HOUR_S, heat_input=HeatInput(law)),
        PowerModel(replace(law, coefficients=(0.0, 0.0, 4_000.0, 0.0))),
    )
    options = {"step_s": None, "horizon_h": 24.0, "fallback": {"stand_back": stand_back}}
    mpc = ThermoForceMPC(model, MPCConfig(**options), free_response=OutdoorResponse())
    house = FaultyHouse(shows, gives=gives)
    result = run_closed_loop(house, mpc, replace(house.period("x"), scored_s=7 * DAY_S))
    (spell,) = watch_spells(result)
    assert "the machine's heat was" in spell.why
    assert "the model adapted since" in spell.why_back
    adapted = result.state.adaptation[0]
    assert adapted.heat == pytest.approx(0.5, abs=0.01)
    assert adapted.model.operator.gains[0] / model.only.operator.gains[0] == pytest.approx(0.5, abs=0.12)


def test_the_e_value_has_mean_one_at_most_for_errors_as_promised():
    rng = np.random.default_rng(3)
    for tails in (2, 3, 30):
        quantile = {2: 1.8856, 3: 1.6377, 30: 1.3104}[tails]
        z = rng.standard_t(tails, 40_000) / quantile
        assert np.mean([e_value(x) for x in z]) < 1.03
    assert e_value(3.0) > e_value(1.0) > 1.0 > e_value(0.0)
    assert math.isfinite(e_value(1e9))


@pytest.mark.slow
def test_false_alarms_are_no_more_frequent_than_stated():
    """Months of predictions whose errors are as promised, straight into the detectors."""
    watch = Watch(WatchConfig(), simple_model().only, 48, lambda record, first: record.u)
    assert watch.threshold == pytest.approx(2 * 2 * 720 / 0.025), "half of the 5 % is for the effect of acting"
    rng, hours, runs = np.random.default_rng(5), 720, 300
    z = rng.standard_t(2, (runs, hours)) / 1.8856
    e = np.array([[[e_value(side * x) for side in (1, -1)] for x in row] for row in z])
    crossed = np.zeros(runs, dtype=bool)
    for phases in (1, 6):
        M = np.zeros((runs, phases, 2))
        for hour in range(hours):
            M[:, hour % phases] = (M[:, hour % phases] + 1.0) * e[:, hour]
            crossed |= M.max(axis=(1, 2)) >= watch.threshold
    assert crossed.mean() <= 0.025


@pytest.mark.slow
def test_false_alarms_of_the_effect_are_no_more_frequent_than_stated():
    """Months of errors 1 h ahead as large as promised, on days with and without much acting."""
    rng, runs, hours = np.random.default_rng(8), 1000, 720
    promise = rng.uniform(0.1, 0.2, hours)
    effect = np.where(rng.random(hours) < 0.4, rng.uniform(0.1, 0.4, hours), 0.0)
    errors = rng.standard_normal((runs, hours)) * promise / 1.2816
    alarms = [
        any(
            effect_fault(row[end - 24 : end], effect[end - 24 : end], promise[end - 24 : end], 0.025)
            for end in range(24, hours + 1, 6)
        )
        for row in errors
    ]
    assert np.mean(alarms) <= 0.025 + 2 * np.sqrt(0.025 / runs), "with two standard deviations of the count"


def test_a_missing_effect_is_told_from_cold_that_has_another_cause():
    rng = np.random.default_rng(2)
    promise, effect = np.full(24, 0.15), np.where(np.arange(24) % 3, 0.0, 0.5)
    noise = 0.03 * rng.standard_normal(24)
    share, z = missing_effect(noise - 0.5 * effect, effect, promise)
    assert share == pytest.approx(0.5, abs=0.05)
    assert z > 5
    door = np.where(np.arange(24) == 3, -3.0, noise)
    assert effect_fault(door, effect, promise, 0.025) == "", "one hour alone"
    assert "less effect" in effect_fault(noise - 0.5 * effect, effect, promise, 0.025)
    assert missing_effect(noise - 0.5 * effect, -effect, promise)[0] < 0, "a cooler that leaves the zone colder"
    assert effect_fault(noise - 0.08 * (effect == 0), effect, promise, 0.025) == "", "colder while nothing acts"
    assert effect_fault(noise, 0.0 * effect, promise, 0.025) == ""
    small = np.full(24, 1e-3)
    assert effect_fault(-0.1 * effect, effect, small, 0.025) == "", "a tenth is an error of the gain, however certain"


def test_predictions_from_before_a_return_do_not_count_against_the_effect():
    watch = Watch(WatchConfig(), simple_model().only, 48, lambda record, first: record.u)
    now = 20 * DAY_S
    judged = np.array([Judged(now - h * HOUR_S, 0, -0.2, 0.1, 0.4) for h in range(24)])
    state = WatchState(tracks=(Track(judged=judged),))
    house = SimpleHouse()

    def alarm(state: WatchState, now: float) -> str:
        house.reset(now, DAY_S)
        return watch.validate(state, house.past(HOUR_S), None, None).alarm

    assert "less effect" in alarm(state, now)
    assert alarm(state, now + HOUR_S) == "", "every 6 h"
    assert alarm(replace(state, returned_s=now - 12 * HOUR_S), now) == ""


def due(lead: int, errors_K: list[float], promise_K: float = 0.4, last_s: float = 20 * DAY_S) -> np.ndarray:
    """Predictions at a lead that came due each hour until `last_s`."""
    n = len(errors_K)
    return np.array([Judged(last_s - (n - 1 - k) * HOUR_S, lead, errors_K[k], promise_K, 0.0) for k in range(n)])


BEFORE_K = [0.1, -0.3, 0.4, 0.2] * 4
# Errors 6 h and an hour ahead of a day with sun that was not foreseen.
SUNNY_K = ([*BEFORE_K, 0.33, 1.05, 1.8, 2.08, 2.28, 2.46, 2.08], [0.38, 0.68, 0.69, 0.4, 0.23, 0.38, 0.19])


@pytest.mark.parametrize(
    ("long_K", "short_K", "promise_K", "shift_K"),
    [
        ([*BEFORE_K, 0.4, 1.0, 1.6, 1.9, 2.0, 1.9], [1.1, 0.5, 0.1], 0.4, 1.93),
        ([*BEFORE_K, -0.4, -1.0, -1.6, -1.9, -2.0, -1.9], [-1.1, -0.5, -0.1], 0.4, -1.93),
        ([*BEFORE_K, 0.4, 1.0, 1.6, 1.9, 2.0, 1.9], [0.4, 0.4, 0.4], 0.4, 0.0),  # heat that goes on coming
        ([*BEFORE_K, 0.4, 1.0, 2.4, 2.6, 2.1, 1.6], [-0.1, -0.1, -0.1], 0.4, 0.0),  # heat that leaves
        ([*BEFORE_K, 0.4, 1.0, 1.6, 1.9, 2.0, -1.9], [0.0, 0.0, 0.0], 0.4, 0.0),
        ([*BEFORE_K, 0.4, 1.0, 1.3, 1.4, 1.4, 1.4], [0.0, 0.0, 0.0], 0.1, 0.0),  # less than is a fault
        ([*BEFORE_K, 1.2, 1.0, 1.6, 1.9, 2.0, 1.9], [0.0, 0.0, 0.0], 0.4, 1.93),  # of the shift itself
        ([1.2, *BEFORE_K, 1.0, 1.6, 1.8, 1.9, 2.0, 1.9], [0.0, 0.0, 0.0], 0.4, 0.0),  # errors like that are usual
        ([*BEFORE_K, 0.4, 1.0, 1.6, 1.9, 2.0, 1.9], [1.1, 0.5, 0.1], 2.0, 0.0),  # not much was promised
        ([0.4, 1.0, 1.6, 1.9, 2.0, 1.9], [1.1, 0.5, 0.1], 0.4, 0.0),  # what is usual is not known
        (SUNNY_K[0], [1.0, -0.3, *SUNNY_K[1]], 0.7, 0.0),  # bestest_hydronic, day 340: sun, in hours as wrong as others
        (SUNNY_K[0], [0.3, -0.3, 0.1, *SUNNY_K[1][1:]], 0.7, 2.27),  # the same where hours are never so wrong
    ],
)
def test_readings_that_were_shifted_go_on_as_predicted_from_where_they_are(long_K, short_K, promise_K, shift_K):
    long, short = (Judged.of(due(lead, errors_K, promise_K)) for lead, errors_K in ((1, long_K), (0, short_K)))
    assert level_shift(long, short) == pytest.approx(shift_K, abs=0.01)


def test_a_shift_is_said_and_control_handed_back_for_a_day():
    watch = Watch(WatchConfig(), simple_model().only, 48, lambda record, first: record.u)
    house, now = SimpleHouse(), 20 * DAY_S
    house.reset(now, DAY_S)

    def judged(*of_leads: np.ndarray) -> np.ndarray:
        rows = np.concatenate(of_leads)
        return rows[np.argsort(rows[:, 0], kind="stable")]

    moved = judged(due(1, [*BEFORE_K, 0.4, 0.1, 1.6, 1.9, 2.0, 1.9]), due(0, [1.0, 0.5, 0.1, 0.0, 0.1]))

    def validated(judged: np.ndarray, **state: float) -> WatchState:
        return watch.validate(WatchState(tracks=(Track(judged=judged),), **state), house.past(HOUR_S), None, None)

    found = validated(moved)
    assert found.alarm.startswith("the zone reads 1.9 K more than predicted 6 h ahead")
    assert "sensor may have been moved" in found.alarm
    assert found.wait_h == 24.0
    assert validated(moved, returned_s=now - 4 * HOUR_S).alarm == "", "predicted before control returned"
    colder = judged(due(1, [*BEFORE_K, 0.4, 0.1, -1.6, -1.9, -2.0, -1.9]), due(0, [-1.0, -0.5, -0.1, 0.0, -0.1]))
    assert validated(colder).alarm == "", "a schedule that blows cold air for an hour looks like it"
    cooling = judged(due(1, [*BEFORE_K, 0.0, -1.6, -2.2, -2.8, -3.3]), due(0, [-1.2, -0.9, -0.6, -0.6, -0.6]))
    assert validated(cooling).alarm == "", "heat that goes on leaving: for the promise to find"


def record(asked: list[float], u: list[float], heat_W: list[float] | None = None) -> tuple[list, Record]:
    n = len(u)
    time_s = np.arange(n + 1) * HOUR_S
    at = np.full(n + 1, 5.0)
    nothing = np.full(n, np.nan)
    heat = nothing if heat_W is None else np.array(heat_W)
    return list(zip(time_s[:-1], asked, strict=True)), Record(time_s, at + 15, at, 0 * at, np.array(u), nothing, heat)


def test_levels_that_differ_for_long_enough_are_a_fault():
    nan = float("nan")
    assert "0.00 was measured" in level_fault(*record([1.0, 0.5, 0.5], [0.0, 0.0, 0.0]))
    assert level_fault(*record([0.0, 0.0, 0.0], [1.0, 0.0, 0.0])), "someone else switches it on"
    assert level_fault(*record([1.0, 0.5, 0.5], [1.0, 0.45, 0.55])) == "", "rounding"
    assert level_fault(*record([0.4, 0.0, 0.0], [0.0, 0.0, 0.0])) == "", "half an hour is a delay"
    assert level_fault(*record([nan, nan, nan], [0.5, 0.5, 0.5])) == "", "native control was asked for"


def test_low_levels_that_nobody_asked_for_are_a_fault_within_a_day():
    """Native control that holds a zone on a mild day: less than an hour at full level in 6 h."""
    watch, state = Watch(WatchConfig(), simple_model().only, 48, lambda record, first: record.u), WatchState()
    asked, seen = record([0.0] * 24, [0.13] * 24)
    found = {}
    for hour, (time_s, level) in enumerate(asked, start=1):
        state = watch.record_request(state, time_s, level)
        found[hour] = level_fault(state.asked, seen.slice(0, hour))
    assert found[6] == ""
    assert "0.00 was asked for on average in the last 8 h" in found[8]
    assert found[24]


def test_a_fault_after_a_day_that_was_followed_is_found_as_soon_as_without_it():
    follows, stuck = [0.8] * 22, [0.8] * 2
    assert "0.00 was measured" not in level_fault(*record(follows, follows))
    assert level_fault(*record([*follows, *stuck], [*follows, 0.0, 0.0]))
    assert level_fault(*record([0.8] * 24, [0.8] * 23 + [0.0])) == "", "0.8 h of a day"


def test_meters_are_compared_where_the_machine_ran():
    heat = MachineLoad((0.0, 0.0, 4000.0, 0.0), (-20.0, 30.0), lowest_level=1.0)
    asked, seen = record([1.0, 0.5, 1.0], [1.0, 0.5, 1.0], [2000.0, 1000.0, 2000.0])
    what, ratio = machine_ratio(asked, seen, heat, lambda r, first: r.u)
    assert (what, ratio) == ("heat", pytest.approx(0.5))
    assert machine_ratio(asked[:1], seen, heat, lambda r, first: r.u) is None, "an hour is not enough"
    levels = applied_levels([(0.0, float("nan")), *asked[1:]], seen, HeatInput(heat))
    np.testing.assert_allclose(levels, [0.5, 0.5, 1.0], atol=1e-6)


def test_an_old_plan_is_followed_only_while_its_own_promise_holds():
    policy = FallbackPolicy(FallbackConfig(), HOUR_S, 1.0, "heating")
    good = GoodPlan(0.0, np.array([[0.2, 0.4, 0.6]]), np.full((1, 3), 21.0), np.full((1, 3), 0.1))
    house = SimpleHouse()
    house.reset(10 * DAY_S, 0.0)

    def followed(T_zone_C: float) -> float | None:
        now = replace(house.measure(), time_s=HOUR_S, T_zone_C=T_zone_C)
        return policy.level_to_follow(good, Observation(Record.beginning(now), house.forecast(DAY_S, HOUR_S)))

    assert followed(21.2) == 0.4
    assert followed(21.4) is None, "off by four times the promised half-width, though less than trust_K"


# Temperatures that are told to the watch, and those that its model was identified at.
ZONE_C, OUT_C = 21.0, 3.0
INSIDE = {"T_zone_C": (20.0, 22.0), "T_out_C": (0.0, 5.0)}
WARMER_ZONE = INSIDE | {"T_zone_C": (25.0, 26.0)}
COLDER_ZONE = INSIDE | {"T_zone_C": (15.0, 17.0)}
WARMER_OUTDOORS = INSIDE | {"T_out_C": (5.0, 9.0)}


def watch_of(ranges: dict[str, tuple[float, float]], gain_sd: float = 0.0) -> Watch:
    """The watch over the simple model, its step response known to `gain_sd`, relative."""
    zone = simple_model().only
    known = {"step_response_1h_K": 1.0, "step_response_1h_sd_K": gain_sd} if gain_sd else {}
    sure = replace(zone, card=replace(zone.card, ranges=ranges, uncertainty=known))
    return Watch(WatchConfig(), sure, 48, power_of(zone))


def power_of(zone: ZoneModel) -> Callable[[Record, int], np.ndarray]:
    return lambda record, first: zone.power(record.u[0], record.T_out_C[:-1])[first:]


def watched_meter(step_h: float, more_W) -> tuple[list[tuple[float, str]], list[str]]:
    """News (h since the begin) and alarms of the watch over a machine that runs 2 h of 5 for 70 h.

    `more_W(hour, u)` (n,): what its meter shows beyond its power.
    """
    zone, per_h = simple_model().only, round(1.0 / step_h)
    watch = Watch(WatchConfig(), replace(zone, operator=zone.operator.resampled(HOUR_S * step_h)), 48, power_of(zone))
    state, hour = WatchState(), step_h * np.arange(70 * per_h)
    u, T_out = np.where(hour % 5 < 2, 1.0, 0.0), np.full(hour.size + 1, OUT_C)
    meter_W = zone.power(u, T_out[:-1]) + more_W(hour, u)
    time_s, T_zone, nothing = (
        HOUR_S * step_h * np.arange(T_out.size),
        np.full(T_out.size, ZONE_C),
        np.full(u.size, np.nan),
    )
    record = Record(time_s, T_zone, T_out, 0.0 * T_out, u, meter_W, nothing)
    told, alarms = [], []
    for k in range(per_h, hour.size):
        state = watch.record_request(state, float(time_s[k]), float(u[k]))
        state = watch.validate(state, record.slice(0, k + 1), None, None)
        told += [(float(hour[k]) + step_h, state.news)] * bool(state.news)
        alarms += [state.alarm] * bool(state.alarm)
    return told, alarms


@pytest.mark.parametrize("step_min", [5, 15, 60])
@pytest.mark.parametrize("begins_h", [33, 30], ids=["while the machine is off", "while it runs"])
def test_a_load_that_begins_on_the_meter_and_ends_is_no_fault_of_the_machine(begins_h, step_min):
    """One that begins while the machine runs is taken for its fault until that is off."""
    told, alarms = watched_meter(
        step_min / 60.0, lambda hour, u: np.where((hour >= begins_h) & (hour < 42), 3000.0, 0.0)
    )
    assert len(alarms) * step_min <= 120.0 * (begins_h == 30)
    assert bool(alarms) == (begins_h == 30)
    (began_h, began), (ended_h, ended) = told
    assert begins_h < began_h <= 36
    assert began.startswith("the meter of power shows up to 3000 W more than the model says, also while the machine is")
    assert ("control returns" in began) == (begins_h == 30)
    assert 64 <= ended_h <= 68, "a day after the machine was last off with it"
    assert "lacks the other load while the machine is off: it has ended" in ended


def test_a_machine_that_takes_more_than_before_while_it_runs_is_at_fault():
    told, alarms = watched_meter(1.0, lambda hour, u: np.where(hour >= 30, 3000.0 * u, 0.0))
    assert "the machine's power was" in alarms[0]
    assert not any("load" in news for _, news in told)


def judged_after(ranges: dict[str, tuple[float, float]], error_K: float = 0.0) -> tuple[Judged, float]:
    """The prediction 1 h ahead of an hour at full level that missed by `error_K`, and the evidence from it."""
    watch, operator = watch_of(ranges), simple_model().only.operator
    n = watch.leads[-1]
    band = np.full(len(watch.leads), 0.2)
    issued = Issued(0.0, operator, np.zeros(1), np.zeros((n, 4)), np.full(len(watch.leads), ZONE_C), band, band)
    track = Track(pending=(issued,), bands=np.array([[0.0, *band]]))
    T_C = np.array([ZONE_C, ZONE_C + GAIN_K + error_K])
    nothing = np.full(1, np.nan)
    history = Record(HOUR_S * np.arange(2.0), T_C, np.full(2, OUT_C), np.zeros(2), np.ones(1), nothing, nothing)
    (after,) = watch.validate(WatchState(tracks=(track,)), history, None, None).tracks
    (row,) = after.judged
    return Judged(*row), after.worst[0]


@pytest.mark.parametrize(
    ("ranges", "share"),
    [
        ({}, 0.0),
        (INSIDE, 0.0),
        (WARMER_ZONE, 0.04 * (25.0 - ZONE_C - 0.5 * GAIN_K)),
        (COLDER_ZONE, 0.04 * (ZONE_C + 0.5 * GAIN_K - 17.0)),
        (WARMER_OUTDOORS, 0.05 * 2.0),
        (WARMER_ZONE | {"T_out_C": (5.0, 9.0)}, 0.04 * (25.0 - ZONE_C - 0.5 * GAIN_K) + 0.05 * 2.0),
        (INSIDE | {"T_out_C": (40.0, 50.0)}, 0.6),
    ],
    ids=["no ranges", "inside", "colder zone", "warmer zone", "colder outdoors", "both", "at most"],
)
def test_a_promise_is_wider_where_the_model_was_not_identified(ranges, share):
    promise_K = judged_after(ranges)[0].promise_K
    assert promise_K == pytest.approx(math.hypot(0.2, 0.1, 1.2816 * share * GAIN_K))


def test_an_error_beyond_the_promise_is_no_evidence_where_the_model_was_not_identified():
    far = {"T_zone_C": (20.0, 22.0), "T_out_C": (40.0, 50.0)}
    known, unknown = judged_after(INSIDE)[0].promise_K, judged_after(far)[0].promise_K
    assert unknown > 1.5 * known
    inside, outside = (judged_after(ranges, 2.0 * known)[1] for ranges in (INSIDE, far))
    assert judged_after({}, 2.0 * known)[1] == inside
    assert inside == pytest.approx(e_value(2.0))
    assert outside == pytest.approx(e_value(2.0 * known / unknown))
    assert outside < 0.7 * inside


# Errors 1 h ahead of days on which air of 40 °C reaches a cold room at 8:00, in promised half-widths, as BOPTEST's air
# unit had them: the model has half of the jump, and what it missed of it leaves the room again until the afternoon.
_AIR_DAY = [0.0, -0.3, -0.5, -0.2, 0.1, -0.3, -0.4, 4.0, -2.5, -1.8, -1.2, -1.4, -1.3, -0.9, -0.6, -0.4] + 8 * [-0.1]


def evidence_of(errors: list[float], band_K: float = 0.5, u: float = 0.0, gain_sd: float = 0.0) -> tuple[str, float]:
    """Alarm, and the most evidence, of hours at a level whose errors 1 h ahead are these, in half-widths."""
    watch, operator, state, most = watch_of({}, gain_sd), simple_model().only.operator, WatchState(), 0.0
    n, band = watch.leads[-1], np.full(len(watch.leads), band_K)
    for k, error in enumerate(errors):
        start_s = k * HOUR_S
        median = np.full(band.size, ZONE_C - u * GAIN_K - band_K * error)
        issued = Issued(start_s, operator, np.zeros(1), np.zeros((n, 4)), median, band, band)
        track = state.tracks[0]
        track = replace(track, pending=(issued,), bands=np.array([[0.0, *band]]))
        out, nothing = np.full(2, OUT_C), np.full(1, np.nan)
        times = np.array([start_s, start_s + HOUR_S])
        history = Record(times, np.full(2, ZONE_C), out, 0.0 * out, np.full(1, u), nothing, nothing)
        state = watch.validate(replace(state, tracks=(track,)), history, None, None)
        if state.alarm:
            return state.alarm, watch.threshold
        most = max(most, state.tracks[0].worst[0])
    return "", most / watch.threshold


def test_what_a_jump_gives_back_is_no_evidence_against_the_model():
    alarm, share = evidence_of(14 * _AIR_DAY)
    assert alarm == ""
    assert share < 0.05
    without_jump = [min(error, 0.0) for error in _AIR_DAY]
    assert "colder than predicted" in evidence_of(14 * without_jump)[0], "the same errors, of themselves"
    assert "warmer than predicted" in evidence_of(48 * [1.5])[0], "errors to the same side excuse nothing"
    assert "warmer" in evidence_of([-4.0, *48 * [1.5]])[0], "nor does one to the other side for long"


def test_an_error_of_the_gain_is_not_new_evidence_each_hour():
    quarter, acting = 100 * [1.0], {"band_K": 0.25 * GAIN_K, "u": 1.0}
    assert "warmer" in evidence_of(quarter, 0.25 * GAIN_K)[0], "errors without an effect"
    assert "warmer" in evidence_of(quarter, **acting)[0], "a gain that is known without error"
    alarm, share = evidence_of(quarter, **acting, gain_sd=0.08)
    assert alarm == ""
    assert share < 0.01
    assert "warmer" in evidence_of([*quarter, *24 * [4.0]], **acting, gain_sd=0.08)[0], "what comes besides is evidence"


@pytest.mark.parametrize(("ranges", "alarm"), [({}, True), (INSIDE, True), (INSIDE | {"T_out_C": (40.0, 50.0)}, False)])
def test_meters_may_differ_by_more_where_the_model_was_not_identified(ranges, alarm):
    """A machine that takes 1.6 times what it did: more than 1.35 and less than that times 1.6."""
    n, before = 6, tuple((hour * HOUR_S, 1.0) for hour in range(-20, -7))
    hours = HOUR_S * np.arange(n + 1.0)
    power_W = np.full(n, 1.6 * (FIXED_W + PER_U_W))
    zone, out = np.full(n + 1, ZONE_C), np.full(n + 1, OUT_C)
    history = Record(hours, zone, out, 0.0 * out, np.ones(n), power_W, np.nan * power_W)
    state = WatchState(asked=tuple((float(at), 1.0) for at in hours[:-1]), ratios=before)
    found = watch_of(ranges).validate(state, history, None, None).alarm
    assert found.startswith("the machine's power was 160 %") if alarm else found == ""


@pytest.mark.slow
def test_the_run_says_how_long_the_watch_held_control(capsys):
    result = changed("stuck")
    spells = watch_spells(result)
    assert sum(round((s.end_s - s.start_s) / HOUR_S) for s in spells) == result.fallback_levels()["watch"]
    assert "the actuator does not follow" in spells[0].in_words()
    assert "control returns" in spells[0].in_words()
    display = RunDisplay()
    with display.loop("mpc", result.period, lambda: result.kpis, "EUR") as loop:
        for step in result.steps:
            loop.step(step)
    assert f"watch {result.fallback_levels()['watch']}" in capsys.readouterr().out
