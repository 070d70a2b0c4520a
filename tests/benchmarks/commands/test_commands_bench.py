"""`bench commands`: what days saved against the house left alone."""

from __future__ import annotations

from uuid import uuid4

import numpy as np
import pytest

from benchmarks.commands import bench
from benchmarks.commands.bench import (
    KINDS,
    ROOMS,
    Home,
    Lived,
    came_true,
    priced,
    run_commands_bench,
    targets,
    with_direct,
)
from benchmarks.commands.known import best_day, rules
from thermoforce_mpc.data import DAY_S, HOUR_S, HeldCommand, Plan, PlanStatus
from thermoforce_mpc.execution import LocalEngine


def test_heat_that_is_missing_or_left_counts_as_what_it_costs_later():
    own = Lived(cost=10.0, energy_kWh=40.0, below_Kh=0.0, above_Kh=0.0, after=7.0)
    warmer = Lived(cost=11.0, energy_kWh=44.0, below_Kh=0.0, above_Kh=0.0, after=5.5)
    colder = Lived(cost=9.0, energy_kWh=36.0, below_Kh=0.0, above_Kh=0.0, after=7.5)
    assert own.saved_by(warmer) == pytest.approx(0.05)
    assert own.saved_by(colder) == pytest.approx(0.05)


@pytest.mark.slow
def test_what_a_plan_saves_is_lived_through_without_moving_the_house():
    home = Home(17, "set-points")
    home.plant.reset(36 * DAY_S, DAY_S)
    ahead = priced(home.plant.forecast(24 * HOUR_S, HOUR_S))
    begin_s, end_s = float(ahead.time_s[0]), float(ahead.time_s[-1])

    def by(value):
        return Plan((), PlanStatus.SOLVED, "", settings=((HeldCommand(begin_s, end_s, value),),) * ROOMS)

    saved, cost = came_true(home, by(None), ahead)
    assert saved == pytest.approx(0.0, abs=1e-9)
    assert cost > 0.0
    cooler, again = came_true(home, by(float(home.usual(np.array([begin_s])).min() - 2.0)), ahead)
    assert again == cost
    assert 0.02 * cost < cooler < cost


def test_a_house_that_was_left_alone_is_not_cheaper_and_the_width_of_bands_stands_beside_what_they_hold():
    def row(saved, in_band, band, note=""):
        told = {"by": KINDS[0], "note": note, "saved": saved, "saved_direct": None, "colder_Kh": 0.0}
        return told | {"colder_by_chance_Kh": 0.0, "in_band": in_band, "judged": 4.0, "band": band}

    rows = [row(0.0, 0.5, 0.1), row(-0.01, 1.0, 0.3), row(0.1, 1.0, 0.2), {"by": KINDS[0], "note": "refused: short"}]
    told = {one.name: one for one in targets(rows)}
    found = {name: one.value for name, one in told.items()}
    cheaper = told["set-points: share of houses that cost less than left alone"]
    assert (cheaper.value, cheaper.holds) == (0.25, False)
    assert {one.name: one for one in targets([row(0.1, 1.0, 0.2)] * 9 + rows[:1])}[cheaper.name].holds
    assert found["set-points: share of houses of which nothing could be learned"] == 0.25
    assert found["share of plans whose saving lay in the 90 % band that they gave"] == pytest.approx(10.0 / 12.0)
    assert found["median width of these bands, as a share of the cost left alone"] == pytest.approx(0.2)


def test_a_flow_temperature_follows_the_weather_when_left_alone_and_is_the_water_when_set():
    home = Home(17, "flow temperature")
    begin_s = 36 * DAY_S
    home.plant.reset(begin_s, DAY_S)
    at_s = begin_s + HOUR_S * np.arange(7 * 24)
    usual_C, outdoors_C = home.usual(at_s)[0], home.plant.weather.at("T_dry_C", at_s)
    coldest, mildest = int(np.argmin(outdoors_C)), int(np.argmax(outdoors_C))
    assert usual_C[coldest] > usual_C[mildest] + 0.3 * np.ptp(outdoors_C)
    water_C = []
    for told in (None, float(usual_C[0] - 8.0)):
        for _ in range(2):
            home.advance((told,) * ROOMS, HOUR_S)
            begin_s += HOUR_S
        water_C.append(home.plant.flow_C(np.array([begin_s - HOUR_S, begin_s]))[:, 0])
    np.testing.assert_allclose(water_C, [[usual_C[0]] * ROOMS, [usual_C[0] - 8.0] * ROOMS], atol=2.5)


def test_a_machine_that_is_not_enabled_stands():
    home = Home(17, "enable")
    home.plant.reset(36 * DAY_S, DAY_S)
    runs, stands, again = (home.advance((told,) * ROOMS, HOUR_S).power_W[0] for told in (None, 0.0, 1.0))
    assert stands < 0.05 * runs < again


def test_one_thermostat_in_the_largest_room_sets_the_whole_house():
    home, begin_s = Home(17, "set-point of the house"), 36 * DAY_S
    home.plant.reset(begin_s, DAY_S)
    areas = [room.area_m2 for room in home.plant.house.rooms]
    assert home.plant.reference == home.plant.zones[int(np.argmax(areas))]
    assert np.ptp(home.usual(begin_s + HOUR_S * np.arange(24.0)), axis=0).max() == 0.0
    home.dials_K = np.array([0.1, 0.2, 0.3])  # all go by the one
    off, on = (home.advance((told,) * ROOMS, HOUR_S) for told in (12.0, 28.0))
    assert (off.u.max(), on.u.min()) == (0.0, pytest.approx(1.0))


def test_levels_of_the_valves_stand_beside_every_way_in_which_the_same_house_is_set():
    told = {"note": "", "colder_Kh": 0.0, "colder_by_chance_Kh": 0.0, "judged": 0.0}
    rows = [told | {"house": "a", "by": KINDS[0], "saved": 0.1, "saved_direct": 0.2}]
    rows += [told | {"house": house, "by": KINDS[3], "saved": 0.1, "saved_direct": None} for house in "ab"]
    rows = with_direct([*rows, {"house": "a", "by": KINDS[4], "note": "refused: short"}])
    assert [row.get("saved_direct") for row in rows] == [0.2, 0.2, None, None]
    found = {one.name: one.value for one in targets(rows)}
    named = "{}: median share saved by levels of the valves of the same houses"
    assert [found[named.format(kind)] for kind in (KINDS[0], KINDS[3])] == [0.2, 0.2]
    assert np.isnan(found[named.format(KINDS[4])])
    assert not any(name.startswith(KINDS[1]) for name in found)


def test_a_house_is_colder_where_it_is_so_by_more_than_its_own_chance():
    told = {"note": "", "by": KINDS[2], "saved": 0.1, "saved_direct": None, "judged": 0.0}
    rows = [told | {"colder_Kh": 1.4, "colder_by_chance_Kh": chance} for chance in (0.0, 0.8, 1.0, 2.0)]
    found = {one.name: one.value for one in targets(rows)}
    assert found["SG-Ready: share of houses that are colder by more than 0.5 K·h a week than by chance"] == 0.5


def test_a_tank_that_is_moved_is_charged_at_other_times_and_then_left_alone():
    home, again = Home(17, "set-points"), Home(17, "set-points")
    for one in (home, again):
        one.plant.reset(36.25 * DAY_S, DAY_S)
    tank_C = []
    for more_K in (4.0, 0.0):
        again.move_tank(more_K)
        tank_C.append([one.advance((None,) * ROOMS, 6 * HOUR_S).points["T_tank_C"] for one in (home, again)])
    assert tank_C[0][1] > tank_C[0][0] + 1.0
    assert tank_C[1][1] < tank_C[0][1]


def no_house(case: tuple[int, str, int]) -> bench.Row:
    return {"house": f"house:{case[0]}", "by": case[1], "note": f"refused: {uuid4()}"}


def test_a_run_that_was_cut_off_goes_on(monkeypatch, tmp_path):
    monkeypatch.setattr(bench, "run_house", no_house)
    first = run_commands_bench(engine=LocalEngine(1), houses=1, seed=4, days=2, keep=tmp_path)
    more = run_commands_bench(engine=LocalEngine(1), houses=2, seed=4, days=2, keep=tmp_path)
    assert more["rows"][:3] == first["rows"]
    assert len({row["note"] for row in more["rows"]}) == 6


def test_the_best_day_of_offsets_is_no_dearer_than_any_rule_and_stays_within_its_limits():
    """Heat that is cheap at noon, and a room that must not be cooled in the evening."""
    price = np.where(np.isin(np.arange(24), [11, 12, 13, 14, 15]), 0.1, 0.3)

    def cost(day):
        return float(price @ day + 5.0 * max(-day[18:21].sum(), 0.0) + 0.01 * (day**2).sum() - 0.2 * day.sum())

    best = best_day(cost, 3.0)
    assert cost(best) < min(cost(day) for day in rules(3.0))
    assert np.abs(best).max() <= 3.0
    assert (best[12:15] == 3.0).all()
    assert (best[18:21] == 0.0).all()
