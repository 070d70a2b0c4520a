"""Hours in which a plant's own schedule keeps its machine off: noticed, said, planned without, and noticed to end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from faults import FaultyHouse
from simple_house import OutdoorResponse, simple_model

from controllers import ThermoForceMPC
from controllers.monitoring.blocked_hours import BlockedHours
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S, HOUR_S, PlanStatus, Record
from thermoforce_mpc.simulation.closed_loop import run_closed_loop


def told(asked, got, T_C, first_hour=0, known=None, step_s=1800.0, sign=1) -> BlockedHours:
    """What is known after hours of two steps each, of levels asked for and measured and temperatures (n,)."""
    known = known or BlockedHours()
    each = round(HOUR_S / step_s)
    asked, got, T_C = (np.repeat(np.asarray(values, dtype=float), each) for values in (asked, got, T_C))
    time_s = first_hour * HOUR_S + 30 * DAY_S + step_s * np.arange(asked.size + 1)
    nothing = np.zeros(time_s.size)
    record = Record(time_s, np.append(T_C[:1], T_C), nothing, nothing, got, nothing[1:], nothing[1:])
    requests = list(zip(time_s[:-1].tolist(), asked.tolist(), strict=True))
    for k in range(1, asked.size + 1):
        known = known.after(requests[:k], record.slice(0, k), sign)
    return known


NIGHT = ([1, 1, np.nan, np.nan, np.nan, np.nan], [0, 0, 0, 0, 0, 0.8], [20.8, 20.5, 20.2, 19.9, 19.7, 19.8])


def test_a_refused_hour_is_blocked_once_the_machine_has_worked_again():
    asleep = told(*(values[:-1] for values in NIGHT))
    assert asleep.hours == frozenset(), "as long as it does not work it may be broken"
    awake = told(*NIGHT)
    assert awake.hours == {0, 1, 2, 3, 4}
    assert "from 0:00 to 5:00" in awake.in_words()
    tomorrow = 31 * DAY_S + 900.0 * np.arange(96)
    np.testing.assert_array_equal(awake.available(tomorrow - 0.5 * DAY_S, 900.0), (np.arange(96) + 48) % 96 >= 20)
    np.testing.assert_array_equal(awake.available(tomorrow, 900.0), (np.arange(96) < 4) | (np.arange(96) >= 20))
    assert awake.outside([(tomorrow[0], 1.0), (tomorrow[-1], 0.5)]) == ((tomorrow[-1], 0.5),)
    cold = told(NIGHT[0], NIGHT[1], [21, 21.5, 22, 22.5, 23, 22], sign=-1)
    assert cold.hours == {0, 1, 2, 3, 4}


def test_what_is_no_schedule_blocks_nothing():
    assert told([1, 1, 1], [0, 0.5, 1], [20, 20, 20]).hours == {0}
    assert told([0.2, 0.2, 1], [0, 0, 1], [20, 20, 20]).hours == frozenset(), "hardly anything was asked for"
    assert told([1, 1, 1], [1, 1, 1], [20, 20, 20]).hours == frozenset()
    warm = told([1, np.nan, np.nan, np.nan], [0, 0, 0, 1], [20.0, 20.4, 21.0, 20.0])
    assert warm.hours == {0}, "native control need not heat a zone that is warmer than when heat was asked for"
    unknown = told([1, 1, 1], [np.nan, np.nan, 1], [20, 20, 20])
    assert unknown.hours == frozenset(), "what several actuators take of a machine that is too small is not known"
    outage = told([1] * 14 + [1], [0] * 14 + [1], [20.0] * 15)
    assert outage.hours == frozenset(), "most of a day is an outage"


def test_an_hour_that_works_is_free_again_and_a_longer_schedule_is_believed_at_once():
    known = told(*NIGHT)
    freed = told([np.nan], [1.0], [20.0], first_hour=4, known=known)
    assert freed.hours == {0, 1, 2, 3}
    assert "from 0:00 to 4:00" in freed.in_words()
    longer = told([1.0], [0.0], [20.0], first_hour=23, known=known)
    assert longer.hours == {23, 0, 1, 2, 3, 4}
    assert "from 23:00 to 5:00" in longer.in_words()
    assert "no hour" in BlockedHours().in_words()


def test_the_night_is_kept_though_the_plant_sleeps():
    """From 0:00 to 5:00 nothing comes."""
    house = FaultyHouse(gives=lambda house, u: 0.0 if house.began_s % DAY_S < 5 * HOUR_S else u)
    mpc = ThermoForceMPC(simple_model(), MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    result = run_closed_loop(house, mpc, replace(house.period("x"), scored_s=2.25 * DAY_S))
    nights = [step for step in result.steps if step.time_s >= 11 * DAY_S and step.time_s % DAY_S <= 6 * HOUR_S]
    assert max(float(np.max(step.boundary.lower_C[:, 0] - step.T_zone_C)) for step in nights) < 0.1, "0.8 K without"
    standing_back = [step.time_s for step in result.steps if step.plan.status is PlanStatus.WATCH]
    assert standing_back, "the first night may be a fault"
    assert max(standing_back) < 10.3 * DAY_S, "it has worked again at 5:00"
    (news,) = [step.plan.news for step in result.steps if step.plan.news]
    assert news.startswith("watch: nothing comes from 0:00 to 5:00, whatever is asked for")
