"""Weather sensors and meters that stick: found by what they should follow, and never planned with unmarked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from faults import FaultyHouse
from simple_house import simple_model
from two_houses import SHARED, TWO

from controllers import ThermoForceMPC
from controllers.checks import ControllerConfigError
from controllers.monitoring.meters import MeterConfig, Meters
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Layout, Period, PlanStatus, Record
from thermoforce_mpc.loop.closed_loop import run_closed_loop

HOURS = 72
TIME_S = HOUR_S * np.arange(HOURS + 1)
T_OUT = 3.0 + 5.0 * np.cos(2 * np.pi * (TIME_S / HOUR_S - 15) / 24)
SUN = np.maximum(0.0, 500.0 * np.cos(2 * np.pi * (TIME_S / HOUR_S - 12) / 24))
LEVEL = np.where(np.arange(HOURS) % 24 < 10, 0.5 + 0.5 * np.sin(np.arange(HOURS)), 0.0)
POWER = 20.0 + 2000.0 * LEVEL


def judged(stuck: dict[str, tuple[int, int]], meters: Meters | None = None, begins: int = 24, **signals):
    """What is said hour by hour of a record in which `stuck` signals repeat their value from one hour to another.

    `begins`: the hour in which a run begins.
    """
    meters = meters or Meters(Layout.single())
    given = {"T_out_C": T_OUT, "solar_W_m2": SUN, "u": LEVEL, "power_W": POWER, "heat_W": 2.5 * POWER - 50.0} | signals
    true = dict(given)
    for name, (start, stop) in stuck.items():
        given[name] = np.array(given[name])
        given[name][start:stop] = given[name][start]
    states, said, history = meters.begin, [], None
    for now in range(begins, HOURS):
        sampled = {name: given[name][: now + 1] for name in ("T_out_C", "solar_W_m2")}
        means = {name: given[name][:now] for name in ("u", "power_W", "heat_W")}
        history = Record(time_s=TIME_S[: now + 1], T_zone_C=np.full(now + 1, 21.0), **sampled, **means)
        nothing = np.zeros(2)
        ahead = Boundary(
            TIME_S[now : now + 2], true["T_out_C"][now : now + 2], true["solar_W_m2"][now : now + 2], *[nothing] * 5
        )
        states, found = meters.validate(states, meters.mask_rejected(states, history), ahead)
        said.append(found)
    return said, meters.mask_rejected(states, history)


def test_a_record_that_is_sound_is_believed():
    said, kept = judged({})
    assert not any(one.why or one.news or one.found for one in said)
    assert np.isfinite(kept.T_out_C).all()
    assert np.isfinite(kept.power_W).all()


@pytest.mark.parametrize(
    ("name", "start", "words"),
    [
        ("T_out_C", 40, "T_out_C has been"),
        ("solar_W_m2", 35, "solar_W_m2 has been"),  # in the sun, until after dark
        ("solar_W_m2", 29, "solar_W_m2 has been 0 W/m²"),  # at night, until it should have risen
        ("power_W", 50, "power_W has been"),
        ("heat_W", 50, "heat_W has been"),
    ],
)
def test_a_reading_that_stays_while_what_it_follows_moves_is_not_believed(name, start, words):
    stop = start + 12 if name in ("T_out_C", "solar_W_m2") else start + 8
    said, kept = judged({name: (start, stop)})
    wrong = [one for one in said if one.why]
    assert wrong
    assert words in wrong[0].why
    assert sum(one.found for one in said) == 1, "found once"
    assert any("believed again" in one.news for one in said)
    values = getattr(kept, name)
    values = values if values.ndim == 1 else values[0]
    refused = np.flatnonzero(np.isnan(values))
    assert name == "solar_W_m2" or np.isfinite(values[start]), "the first reading of all may be true"
    assert set(range(start + 1, stop)) <= set(refused)
    assert refused.max() == stop - 1


@pytest.mark.parametrize("name", ["power_W", "heat_W"])
def test_a_run_that_begins_finds_a_meter_that_is_stuck_in_the_record(name):
    said, history = judged({name: (27, HOURS)}, begins=34)
    assert f"{name} has been " in said[0].why
    assert "h, in which its level moved by" in said[0].why
    np.testing.assert_array_equal(np.isnan(getattr(history, name)[0]), np.arange(HOURS - 1) > 27)
    sound, _ = judged({}, begins=34)
    assert not sound[0].why


def test_what_has_a_reason_to_stay_is_believed():
    assert not any(one.why for one in judged({"power_W": (60, 71)})[0]), "the machine is off"
    even = np.full(HOURS, 0.7)
    assert not any(one.why for one in judged({}, u=even, power_W=20.0 + 2000.0 * even)[0]), "it runs evenly"
    still = np.full(HOURS + 1, 4.0)
    assert not any(one.why for one in judged({}, T_out_C=still)[0]), "the forecast says so too"
    none = np.zeros(HOURS + 1)
    said, _ = judged({"solar_W_m2": (0, HOURS + 1)}, solar_W_m2=SUN)
    assert not any(one.why for one in said), "a point that never moved is not measured"
    assert not any(one.why for one in judged({}, solar_W_m2=none)[0])
    off = np.where(np.arange(HOURS) >= 48, 0.0, POWER)
    assert not any(one.why for one in judged({}, power_W=off)[0]), "a machine that does not run is for the watch"


def test_a_shared_machine_at_its_capacity_is_believed():
    shared = Layout(SHARED, (1, 1), (0, 1), (0, 0), (0.0, 0.0), (0.5, 0.5), (float("nan"),) * 2)
    meters, said = Meters(shared), []
    for levels in ([1.0, 1.0], [0.2, 0.9]):  # more than it can give; then less, and more or less
        states = meters.begin
        for now in range(2, 12):
            n = np.arange(now)
            u = np.stack([np.full(now, levels[0]) + 1.2 * (n % 2), np.full(now, levels[1])])
            power = np.where(n == 0, 10.0, 4000.0)
            given = {name: values[: now + 1] for name, values in (("T_out_C", T_OUT), ("solar_W_m2", SUN))}
            record = Record(
                time_s=TIME_S[: now + 1], T_zone_C=np.full((2, now + 1), 21.0), **given, u=u, heat_W=u * np.nan,
                power_W=power, names=SHARED,
            )  # fmt: skip
            ahead = Boundary(TIME_S[now : now + 2], T_OUT[now : now + 2], SUN[now : now + 2],
                             *[np.zeros((2, 2))] * 3, *[np.zeros((1, 2))] * 2, names=SHARED)  # fmt: skip
            states, found = meters.validate(states, record, ahead)
        said.append("power_W has been" in found.why)
    assert said == [False, True]


def test_options_of_a_point_come_before_those_of_its_signal():
    stuck = {"T_out_C": (40, 52)}
    for single in ({"T_out_C": MeterConfig(enabled=False)}, {"T_out_C": MeterConfig(frozen_h=24.0)}):
        assert not any(one.why for one in judged(stuck, Meters(Layout.single(), MeterConfig(), single))[0])
    two = Layout(TWO, (1, 1), (0, 1), (0, 1), (0.0, 0.0), (0.0, 0.0), (float("nan"),) * 2)
    Meters(two, single={"power_W[boiler]": MeterConfig()})
    with pytest.raises(ControllerConfigError, match=r"no 'power_W\[oven\]'; known are .*power_W\[boiler\]"):
        Meters(two, single={"power_W[oven]": MeterConfig()})


def outdoors_stuck(from_h: float, to_h: float) -> FaultyHouse:
    """A house whose outdoor sensor sticks between two hours of the run."""
    shown_C: list[float] = []

    def shows(house, seen):
        if not from_h <= house.hours < to_h:
            return seen
        shown_C.append(seen.T_out_C)
        return replace(seen, T_out_C=shown_C[0])

    return FaultyHouse(shows)


def test_the_mpc_plans_without_it_marked():
    options = {"step_s": 3600, "horizon_h": 12, "gate": {"enabled": False}, "free_response": {"name": "linear_weather"}}
    controller = ThermoForceMPC(simple_model(), MPCConfig(**options))
    period = Period("test", 10 * DAY_S, 24 * HOUR_S, 2 * DAY_S)
    found = run_closed_loop(outdoors_stuck(4, 16), controller, period)
    marked = [step for step in found.steps if "T_out_C has been" in step.plan.why]
    assert len(marked) >= 8
    assert {step.plan.status for step in marked} == {PlanStatus.BRIDGED}
    assert "in which its forecast moved by" in marked[0].plan.why
    after = [step for step in found.steps if step.time_s > marked[-1].time_s]
    assert "believed again" in after[0].plan.why
    assert {step.plan.status for step in after} == {PlanStatus.SOLVED}
