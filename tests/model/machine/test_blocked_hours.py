"""Hours in which a plant's own schedule keeps its machine off: noticed, said, left out, and noticed to end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.blocked_hours import (
    BlockedHours,
    HourEffects,
    HourSeen,
    ahead_s,
    called_for,
    each_direction,
    running,
)


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
    assert "; " not in awake.in_words(), "one reason among others"
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
    assert told([1, np.nan, np.nan], [0, 0, 1], [20.5, 20.5, 20.5]).hours == {0, 1}, "as cold as then it must"
    unknown = told([1, 1, 1], [np.nan, np.nan, 1], [20, 20, 20])
    assert unknown.hours == frozenset(), "what several actuators take of a machine that is too small is not known"
    outage = told([1] * 14 + [1], [0] * 14 + [1], [20.0] * 15)
    assert outage.hours == frozenset(), "most of a day is an outage"
    after = told([1] * 3, [1] * 3, [20.0] * 3, first_hour=24, known=outage)
    assert after.hours == frozenset(), "and so are the hours of it that have not worked since"
    known = told([1] * 20, [0] * 19 + [1], [20.0] * 20, first_hour=24, known=told(*NIGHT))
    assert told([1] * 2, [1] * 2, [20.0] * 2, first_hour=6, known=known).hours == {0, 1, 2, 3, 4}, "nights as before"


def test_an_hour_that_works_is_free_again_and_a_longer_schedule_is_believed_at_once():
    known = told(*NIGHT)
    freed = told([np.nan], [1.0], [20.0], first_hour=4, known=known)
    assert freed.hours == {0, 1, 2, 3}
    assert "from 0:00 to 4:00" in freed.in_words()
    longer = told([1.0], [0.0], [20.0], first_hour=23, known=known)
    assert longer.hours == {23, 0, 1, 2, 3, 4}
    assert "from 23:00 to 5:00" in longer.in_words()
    assert "no hour" in BlockedHours().in_words()


def test_a_record_tells_all_at_once_and_later_it_is_known():
    asked, got, T_C = (np.repeat(np.asarray(values, dtype=float), 2) for values in NIGHT)
    time_s = 30 * DAY_S + 1800.0 * np.arange(asked.size + 1)
    nothing = np.zeros(time_s.size)
    record = Record(time_s, np.append(T_C[:1], T_C), nothing, nothing, got, nothing[1:], nothing[1:])
    found = BlockedHours.found(asked, record, 1)
    # Compared as text: what is not known is NaN, which since Python 3.13 is no longer equal in a dataclass.
    assert repr(found) == repr(told(*NIGHT))
    assert BlockedHours.found(np.full(asked.size, np.nan), record, 1).hours == frozenset(), "nothing was asked for"
    known = BlockedHours.known(found.hours, 40 * DAY_S)
    assert known.hours == found.hours
    assert repr(BlockedHours.known((), 40 * DAY_S)) == repr(BlockedHours())
    midnight = 40 * DAY_S + 900.0 * np.arange(8)
    np.testing.assert_array_equal(known.available(midnight, 900.0), np.arange(8) < 4)  # only probing has seen it
    confirmed = told([1.0, 1.0], [0.0, 0.0], [20.0, 20.0], known=told([1.0], [0.0], [20.0], known=known))
    later = DAY_S * (confirmed.last_s // DAY_S + np.array([[0.0], [1.0]])) + 900.0 * np.arange(2)
    assert [confirmed.available(instants, 900.0)[0] for instants in later] == [0.0, 1.0], "one day of it, then more"


def test_hours_here_and_there_are_no_schedule():
    scattered = BlockedHours.known((0, 1, 2, 10, 11, 20, 21, 23), 40 * DAY_S)
    assert scattered.hours == frozenset()
    assert BlockedHours.known((0, 1, 2, 20, 21, 23), 40 * DAY_S).hours == {0, 1, 2, 20, 21, 23}


def seen(day: float, error_K: float, effect_K: float = 1.0, hour: int = 6, promise_K: float = 0.2) -> HourSeen:
    return HourSeen(day * DAY_S + (hour + 1) * 3600.0, error_K, effect_K, promise_K)


def effects(*told: HourSeen, sign: int = 1) -> HourEffects:
    found = HourEffects(sign)
    for one in told:
        found = found.after(one)
    return found


def test_an_hour_differs_once_two_days_running_missed_its_effect():
    assert not effects(seen(0, -1.0)).laws, "one day is chance"
    assert not effects(seen(0, -1.0), seen(1, -0.3)).laws, "within the promise"
    assert not effects(seen(0, 1.0), seen(1, 1.0)).laws, "more than expected is no harm"
    assert not effects(seen(0, -1.0, effect_K=0.1), seen(1, -1.0, effect_K=0.1)).laws, "nothing was asked"
    small = [seen(day, -0.25, effect_K=0.45, promise_K=0.1) for day in (0, 1)]
    assert not effects(*small).laws, "a thermostat keeps as much above its bound"
    found = effects(seen(0, -1.0), seen(1, -1.0))
    assert set(found.laws) == {6}
    law = found.laws[6]
    assert law.share < 0.95
    assert law.share - 1.0 + law.dip_K == pytest.approx(-1.0, abs=0.05), "together they explain it"
    assert "from 6:00 to 7:00" in found.in_words()
    assert "; " not in found.in_words()
    assert not found.after(seen(2, 0.0)).laws, "taken back when it comes"


def test_what_is_known_of_an_hour_outlives_plans_that_keep_out_of_it():
    found = effects(seen(0, -1.0), seen(1, -1.0))
    for day in range(2, 20):
        found = found.after(seen(day, 0.0, effect_K=0.1))
    assert set(found.laws) == {6}
    assert len(found.seen) == 6
    assert not found.after(seen(20, 0.0)).laws, "taken back when it comes"
    assert not found.after(seen(23, 0.0, effect_K=0.1)).laws, "forgotten in the end"


def test_a_day_without_heat_tells_cold_air_from_a_machine_that_stands():
    both = effects(seen(0, -1.5), seen(1, -1.5))
    stands = both.after(seen(2, 0.0, effect_K=0.0))
    blows = both.after(seen(2, -1.5, effect_K=0.0))
    assert stands.laws[6].share < both.laws[6].share < blows.laws[6].share
    assert blows.laws[6].dip_K == pytest.approx(-1.5, abs=0.1)


def test_plans_count_on_what_comes_and_try_an_hour_again_after_a_week():
    found = effects(seen(0, -1.0), seen(1, -1.0))
    time_s = 2 * DAY_S + 900.0 * np.arange(48)
    share, dips = found.share(time_s, 900.0), found.dips_K(time_s, 900.0)
    assert np.flatnonzero(share < 1.0).tolist() == [24, 25, 26, 27]
    assert dips[23] == 0.0
    assert dips.min() == dips[27]
    assert found.laws[6].dip_K <= dips[27] < 0.7 * found.laws[6].dip_K
    assert dips[-1] > 0.3 * dips[27], "it is forgotten"
    soon = 7 * DAY_S + 6 * 3600.0 + 900.0 * np.arange(4)
    assert (found.share(soon, 900.0) == found.laws[6].share).all(), "not before"
    later = 9 * DAY_S + 6 * 3600.0 + 900.0 * np.arange(4)
    assert (found.share(later, 900.0) == 1.0).all()


def test_a_blocked_hour_is_tried_again_where_it_was_not_refused_lately():
    now_s, never = 30 * DAY_S, -np.inf
    known = BlockedHours.known((0, 1, 2), now_s)
    assert 0.25 < known.level_to_try(now_s, never) < 0.5
    assert known.level_to_try(now_s + 5 * HOUR_S, never) == 0.0, "it is not blocked"
    assert known.level_to_try(now_s + DAY_S, now_s) == 0.0, "no answer came: not again tomorrow"
    assert known.level_to_try(now_s + 8 * DAY_S, now_s) > 0.0
    refused = replace(known, last_s=now_s + HOUR_S, days=1)
    assert refused.level_to_try(now_s + HOUR_S, now_s) == 0.0
    assert refused.level_to_try(now_s + DAY_S, now_s) > 0.0, "a second day confirms it"
    assert replace(refused, days=2).level_to_try(now_s + DAY_S, now_s) == 0.0


def test_an_hour_with_less_effect_is_tried_with_what_tells_after_a_week():
    found, never = effects(seen(0, -1.0), seen(1, -1.0)), -np.inf
    begin_s = 9 * DAY_S + 6 * HOUR_S
    assert found.level_to_try(begin_s, never, 0.5) == pytest.approx(0.6), "0.3 K at least"
    assert found.level_to_try(begin_s, never, 0.2) == 0.0, "full level would not tell"
    assert found.level_to_try(begin_s + HOUR_S, never, 2.0) == 0.0, "another hour"
    assert found.level_to_try(begin_s - 7 * DAY_S, never, 2.0) == 0.0, "asked lately"
    assert found.level_to_try(begin_s + DAY_S, begin_s, 2.0) == 0.0, "tried lately"


def test_cooling_misses_its_effect_to_the_warm_side():
    assert set(effects(seen(0, 1.0, -1.0), seen(1, 1.0, -1.0), sign=-1).laws) == {6}
    assert not effects(seen(0, -1.0, -1.0), seen(1, -1.0, -1.0), sign=-1).laws


def test_what_was_seen_before_a_run_counts_as_of_the_days_before():
    found = effects(seen(0, -1.0), seen(1, -1.0)).at(40 * DAY_S)
    assert [one.hour for one in found.seen] == [6, 6]
    assert 39 * DAY_S <= found.seen[-1].time_s <= 40 * DAY_S


def test_a_machine_that_reports_what_was_asked_of_it_stands_where_its_meter_reads_nothing():
    u, hours = np.full(48, 0.5), np.arange(48) % 24
    record = Record(
        time_s=3600.0 * np.arange(49),
        T_zone_C=np.full(49, 20.0),
        T_out_C=np.zeros(49),
        solar_W_m2=np.zeros(49),
        u=u,
        power_W=np.where((hours >= 6) & (hours < 8), 10.0, 1000.0),
        heat_W=np.full(48, np.nan),
    )
    assert np.flatnonzero(running(record).u[0] == 0.0).tolist() == [6, 7, 30, 31]
    assert BlockedHours.found(u, running(record), 1).hours == {6, 7}
    for tells_nothing in (np.full((1, 48), np.nan), np.zeros((1, 48)), record.power_W + 500.0):
        assert (running(replace(record, power_W=tells_nothing)).u == 0.5).all()


def test_what_cannot_be_judged_tells_nothing_of_its_hour():
    known = effects(seen(1, -0.9), seen(2, -0.9))
    nan = float("nan")
    for told in (seen(3, nan), seen(3, 0.0, effect_K=nan), seen(3, 0.0, promise_K=nan), seen(3, 0.0, promise_K=0.0)):
        assert known.after(told) == known
        with pytest.raises(DataError, match="hour_effects"):
            HourEffects(seen=(told,))


def test_set_points_call_where_both_readings_of_a_step_say_so():
    """At 21 and 25 °C: cold at both ends, at one, nearly; warm at both ends, at one; a level that was set."""
    T_C = np.array([19.0, 20.0, 20.9, 20.0, 26.0, 25.8, 25.2])
    heating, cooling = np.full(6, 21.0), np.full(6, 25.0)
    assert called_for(np.zeros(6), heating, cooling, T_C).tolist() == [1.0, 0.0, 0.0, 0.0, -1.0, 0.0]
    assert called_for(np.full(6, 0.4), np.where(np.arange(6) < 3, np.nan, heating), cooling, T_C).tolist() == [
        *[0.4] * 3, 0.0, -1.0, 0.0,
    ]  # fmt: skip


def test_heating_and_cooling_of_signed_levels_are_seen_apart():
    asked = np.array([0.5, -0.25, 0.0])
    record = Record(HOUR_S * np.arange(4.0), *np.full((3, 4), 20.0), u=asked, power_W=asked, heat_W=asked)
    heating, cooling = each_direction(asked, record, 1, signed=True)
    assert [(way[0].tolist(), way[1].u[0].tolist(), way[2]) for way in (heating, cooling)] == [
        ([0.5, 0.0, 0.0], [0.5, 0.0, 0.0], 1),
        ([0.0, 0.25, 0.0], [0.0, 0.25, 0.0], -1),
    ]
    ((same, _, sign),) = each_direction(asked, record, -1, signed=False)
    assert (same.tolist(), sign) == (asked.tolist(), -1)


def test_a_schedule_goes_by_the_clock_on_the_wall_also_after_it_was_changed():
    """Nothing comes from 0:00 to 5:00 on the wall: in summer that is an hour sooner, counted from the new year."""
    new_year = pd.Timestamp("2026-01-01", tz="Europe/Berlin")
    in_summer = (pd.Timestamp("2026-06-01", tz="Europe/Berlin") - new_year).total_seconds()
    assert (ahead_s(0.0, new_year), ahead_s(in_summer, new_year), ahead_s(in_summer, None)) == (0.0, HOUR_S, 0.0)
    winter = BlockedHours.known(range(5), 0.0)
    assert sorted(winter.moved(-HOUR_S).hours) == [0, 1, 2, 3, 23]
    assert repr(winter.moved(-HOUR_S).moved(HOUR_S)) == repr(winter)
    seen = tuple(HourSeen(day * DAY_S + 20 * HOUR_S, -1.5, 1.5, 0.3) for day in (1, 2))
    assert list(HourEffects(1, seen).laws) == [19]
    assert list(HourEffects(1, seen).moved(-HOUR_S).laws) == [18]
