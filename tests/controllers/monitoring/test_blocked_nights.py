"""Nights in which a plant's own schedule keeps its machine off: kept by plans, from the first on where it is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import simple_house
from faults import FaultyHouse
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.monitoring.watch import Watch, WatchConfig
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S, HOUR_S, PlanStatus, Record
from thermoforce_mpc.loop.closed_loop import run_closed_loop


def asleep_at_night() -> FaultyHouse:
    """A house in which nothing comes from 0:00 to 5:00."""
    return FaultyHouse(gives=lambda house, u: 0.0 if house.began_s % DAY_S < 5 * HOUR_S else u)


def run_of(model, start_s: float, days: float):
    """The steps of a run."""
    house = asleep_at_night()
    mpc = ThermoForceMPC(model, MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    return run_closed_loop(house, mpc, replace(house.period("x"), start_s=start_s, scored_s=days * DAY_S)).steps


def coldest_K(steps) -> float:
    """Most that the zone was below its bound at night, from 0:00 to 6:00."""
    nights = [step for step in steps if step.time_s % DAY_S <= 6 * HOUR_S]
    return max(float(np.max(step.boundary.lower_C[:, 0] - step.T_zone_C)) for step in nights)


def test_what_probing_has_found_keeps_the_first_night():
    model = simple_model()
    known = replace(model, cards=(replace(model.only.card, blocked_hours=tuple(range(5))),))
    steps = run_of(known, 10.5 * DAY_S, 0.75)
    assert coldest_K(steps) < 0.1
    assert PlanStatus.WATCH not in {step.plan.status for step in steps}
    assert coldest_K(run_of(model, 10.5 * DAY_S, 0.75)) > 0.5, "without it the night is cold"


@pytest.mark.slow
def test_the_night_is_kept_though_the_plant_sleeps():
    steps = run_of(simple_model(), 10 * DAY_S, 2.25)
    assert coldest_K([step for step in steps if step.time_s >= 11 * DAY_S]) < 0.1, "0.8 K without"
    standing_back = [step.time_s for step in steps if step.plan.status is PlanStatus.WATCH]
    assert standing_back, "the first night may be a fault"
    assert max(standing_back) < 10.3 * DAY_S, "it has worked again at 5:00"
    news = [step.plan.news for step in steps if step.plan.news]
    assert news[0].startswith("watch: nothing comes from 0:00 to 5:00, whatever is asked for")
    assert not any("comes from" in one for one in news[1:]), "an hour that is tried confirms it"


def tried_before_six(monkeypatch, gives, hours: int = 7, **house) -> list:
    """The steps of a night of a house, its bound from 6:00 on, whose card says that nothing comes from 2:00 on."""
    for name, value in house.items():
        monkeypatch.setattr(simple_house, name, value)

    def from_six(_, boundary):
        hour = boundary.time_s % DAY_S / HOUR_S
        day = (hour >= 6) & (hour <= 22)
        lower_C, upper_C = np.where(day, 21.0, 16.0), np.where(day, 25.0, 28.0)
        return replace(boundary, lower_C=lower_C[None], upper_C=upper_C[None])

    model = simple_model()
    model = replace(model, cards=(replace(model.only.card, blocked_hours=(2, 3, 4, 5)),))
    mpc = ThermoForceMPC(model, MPCConfig(step_s=None), free_response=OutdoorResponse())
    plant = FaultyHouse(gives=gives, says=from_six)
    return run_closed_loop(plant, mpc, replace(plant.period("x"), start_s=10 * DAY_S, scored_s=hours * HOUR_S)).steps


LIGHT = {"POLE": 0.93, "GAIN_K": 6.0}


def test_a_wrong_belief_that_costs_is_put_to_the_test(monkeypatch):
    """Plans heat before the hours of the card and would never see that heat comes in them."""
    steps = tried_before_six(monkeypatch, lambda house, u: u, **LIGHT)
    told = [(step.time_s % DAY_S / HOUR_S, step.plan.news) for step in steps if "to see whether" in step.plan.news]
    assert told[0][0] == 2.0
    assert "dearer by the same model (" in told[0][1]
    assert ": 30 % is asked for in this hour" in told[0][1]
    assert steps[2].plan.u[0, 0] == pytest.approx(0.3, abs=1e-3), "no more than tells"
    assert "nothing comes from 3:00 to 6:00" in steps[3].plan.news, "heat came in that one"


def test_a_right_belief_outlives_the_test(monkeypatch):
    steps = tried_before_six(
        monkeypatch, lambda house, u: 0.0 if 2 <= house.began_s % DAY_S // HOUR_S < 6 else u, 5, **LIGHT
    )
    told = {step.time_s % DAY_S / HOUR_S: step.plan.news for step in steps if step.plan.news}
    assert "to see whether it holds" in told[2.0]
    assert told[3.0] == "watch: nothing came in the hour that was tried, as it was believed"
    assert list(told) == [0.0, 2.0, 3.0], "one hour in a night"
    assert PlanStatus.WATCH not in {step.plan.status for step in steps}


def test_a_belief_that_costs_nothing_is_left_alone(monkeypatch):
    """A heavy house keeps what it was given before."""
    steps = tried_before_six(monkeypatch, lambda house, u: u, 5, POLE=0.999, GAIN_K=0.4)
    assert not [step.plan.news for step in steps if "to see whether" in step.plan.news]


def cold_at_seven(**known) -> list:
    """The steps of three days of a house whose plant blows cold air from 19:00 to 20:00 and gives nothing then."""

    def blows(house: FaultyHouse) -> bool:
        return house.began_s % DAY_S // HOUR_S == 19

    house = FaultyHouse(
        gives=lambda house, u: 0.0 if blows(house) else u,
        shows=lambda house, seen: seen if house.asked is None else SimpleHouse.measure(house, house.asked),
        moves=lambda house, hours: -1.6 * hours if blows(house) else 0.0,
    )
    model = simple_model()
    model = replace(model, cards=(replace(model.only.card, hour_effects=known.pop("hours", ())),))
    config = MPCConfig.model_validate({"step_s": None, "horizon_h": 24.0} | known)
    mpc = ThermoForceMPC(model, config, free_response=OutdoorResponse())
    return run_closed_loop(house, mpc, replace(house.period("x"), start_s=10 * DAY_S, scored_s=3 * DAY_S)).steps


def missing_K(steps, day: int) -> float:
    """What was missing at 20:00 of a day, where the bound begins, K."""
    (T_C,) = [float(step.T_zone_C[0]) for step in steps if step.time_s == day * DAY_S + 20 * HOUR_S]
    return 21.0 - T_C


@pytest.mark.slow
def test_an_evening_in_which_a_schedule_blows_cold_is_planned_around_from_the_third_on():
    steps = cold_at_seven()
    assert missing_K(steps, 11) > 0.5, "nobody knew"
    assert missing_K(steps, 12) < 0.2
    news = [(step.time_s, step.plan.news) for step in steps if "of what it does else" in step.plan.news]
    assert [time_s for time_s, _ in news] == [11 * DAY_S + 20 * HOUR_S], "two evenings tell"
    assert news[0][1].startswith("watch: from 19:00 to 20:00 acting does ")
    assert PlanStatus.WATCH not in {step.plan.status for step in steps}
    assert missing_K(cold_at_seven(watch={"blocked_hours": False}), 12) > 0.5


@pytest.mark.slow
def test_what_a_record_told_of_an_evening_keeps_the_first_one():
    told = [(day * DAY_S + 20 * HOUR_S, -2.0, 0.4, 0.2) for day in (3.0, 4.0)]
    steps = cold_at_seven(hours=tuple(told))
    assert "found while probing" in steps[0].plan.news
    assert missing_K(steps, 10) < 0.2


def test_a_night_stays_where_the_clock_on_the_wall_has_it():
    """Known of a winter's probing, in the night in which summer time begins, and of a run that begins in summer."""
    model, new_year = simple_model(), pd.Timestamp("2026-01-01", tz="Europe/Berlin")
    zone = replace(model, cards=(replace(model.only.card, blocked_hours=tuple(range(5))),)).only
    watch = Watch(WatchConfig(), zone, 48, lambda record, first: record.u)

    def until(at: str) -> Record:
        now_s = (pd.Timestamp(at, tz="Europe/Berlin") - new_year).total_seconds()
        n, time_s = np.zeros(48), now_s + 900.0 * np.arange(-48, 1)
        return Record(time_s, np.full((1, 49), 20.5), 0.0 * time_s, 0.0 * time_s, n[None], n[None], n[None],
                      origin=new_year)  # fmt: skip

    before, after = until("2026-03-29 01:00"), until("2026-03-29 04:00")
    state = watch.validate(watch.begin(float(before.time_s[-1]), new_year), before, None, None)
    assert sorted(state.blocked[0].hours) == [0, 1, 2, 3, 4]
    asked = replace(state, asked=((float(before.time_s[-1]), 0.0),))
    assert sorted(watch.validate(asked, after, None, None).blocked[0].hours) == [0, 1, 2, 3, 23]
    begun = watch.begin(float(until("2026-06-01 12:00").time_s[-1]), new_year)
    assert sorted(begun.blocked[0].hours) == [0, 1, 2, 3, 23]
    assert begun.news.startswith("nothing comes from 0:00 to 5:00"), "and that is what people are told"
