"""Comfort bounds by schedule: what a text means, what is refused, and what plans and KPIs make of it."""

from __future__ import annotations

import numpy as np
import pytest
from simple_house import SimpleHouse

from thermoforce_mpc.cli.options import scenario_from
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.experiment.identifying import chosen_of
from thermoforce_mpc.plants.registry import WithComfort, build_plant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import OutlivingPlant, Plant, RoomSetpointPlant
from thermoforce_mpc.scenario.comfort import Comfort
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario
from thermoforce_mpc.scenario.settings import validate

WEEKDAYS = "weekdays 6:00–22:00 21–24, else 17–26"
TUESDAY, SATURDAY, SUNDAY = 0, 4, 5  # days of BOPTEST's year


def bounds(schedule, day, hour, zones=("zone",), **more):
    comfort = Comfort.model_validate({"schedule": schedule, **more})
    lower, upper = comfort.bounds_C(np.array([day * DAY_S + hour * HOUR_S]), zones, "tuesday")
    return [(float(low), float(high)) for low, high in zip(lower[:, 0], upper[:, 0], strict=True)]


@pytest.mark.parametrize(
    ("schedule", "day", "hour", "expected"),
    [
        (WEEKDAYS, TUESDAY, 5.99, (17, 26)),
        (WEEKDAYS, TUESDAY, 6, (21, 24)),
        (WEEKDAYS, TUESDAY, 22, (17, 26)),
        (WEEKDAYS, SATURDAY, 12, (17, 26)),
        (WEEKDAYS, SATURDAY + 7, 12, (17, 26)),
        ("weekend 8-23 20.5-25; mon-thu 7:30-9 21-23; else 16-27", SUNDAY, 8, (20.5, 25)),
        ("weekend 8-23 20.5-25; mon-thu 7:30-9 21-23; else 16-27", TUESDAY, 7.5, (21, 23)),
        ("weekend 8-23 20.5-25; mon-thu 7:30-9 21-23; else 16-27", 3, 8, (16, 27)),  # a Friday
        ("22:00-6:00 18-26, else 21-24", TUESDAY, 23, (18, 26)),
        ("22:00-6:00 18-26, else 21-24", TUESDAY, 3, (18, 26)),
        ("sat-mon 20-24, else 18-26", SUNDAY, 1, (20, 24)),
        ("sat-mon 20-24, else 18-26", TUESDAY, 1, (18, 26)),
        ("else 19-25", TUESDAY, 1, (19, 25)),
    ],
)
def test_the_first_rule_that_holds_counts(schedule, day, hour, expected):
    assert bounds(schedule, day, hour) == [expected]


def test_a_holiday_is_a_sunday_or_what_its_rule_says():
    new_year = ["2026-01-01"]
    assert bounds(WEEKDAYS, TUESDAY, 12, holidays=new_year) == [(17, 26)]
    assert bounds("holidays 15-28, " + WEEKDAYS, TUESDAY, 12, holidays=new_year) == [(15, 28)]
    assert bounds("holidays 15-28, " + WEEKDAYS, TUESDAY + 1, 12, holidays=new_year) == [(21, 24)]


def test_zones_have_their_own_or_what_holds_for_others():
    schedule = {"bath": "6-9 23-26, else 18-28", "others": WEEKDAYS}
    assert bounds(schedule, TUESDAY, 7, zones=("living", "bath")) == [(21, 24), (23, 26)]
    with pytest.raises(ConfigError, match="no zone 'bath', did you mean 'bathroom'"):
        bounds(schedule, TUESDAY, 7, zones=("bathroom",))
    with pytest.raises(ConfigError, match="nothing for living"):
        bounds({"bath": "else 18-28"}, TUESDAY, 7, zones=("living", "bath"))


@pytest.mark.parametrize(
    ("schedule", "said"),
    [
        ("weekdays 6-22 21-24", "what holds else"),
        ("", "what holds else"),
        ("weekdys 6-22 21-24, else 17-26", "unknown day 'weekdys', did you mean 'weekdays'"),
        ("mon-weekend 6-22 21-24, else 17-26", "unknown day 'weekend'"),
        ("weekdays 6-25 21-24, else 17-26", "25 is no time of day"),
        ("weekdays 6:75-7 21-24, else 17-26", "6:75 is no time of day"),
        ("weekdays 6-6 21-24, else 17-26", "begins and ends at the same time"),
        ("weekdays 6-22 24-21, else 17-26", "the lower below the upper"),
        ("else 294-297", "from 5 to 40"),
        ("weekdays at six 21-24, else 17-26", "expected DAYS BEGIN-END LOWER-UPPER"),
    ],
)
def test_what_is_no_schedule_is_refused_with_the_part(schedule, said):
    with pytest.raises(ConfigError, match=said):
        validate(Scenario, {"testcase": "bestest_hydronic_heat_pump", "comfort": schedule}, "test")


def test_a_scenario_takes_a_text_or_the_whole():
    options = {"testcase": "bestest_hydronic_heat_pump", "assignments": [f"comfort={WEEKDAYS}"]}
    assert scenario_from(options).comfort == Comfort(schedule=WEEKDAYS)


@pytest.mark.parametrize(
    ("testcase", "schedule", "set_points", "cooling_C"),
    [
        ("bestest_hydronic_heat_pump", "weekdays 6:00-22:00 22-24, else 17-26", {"actuator": 22.3}, 23.7),
        ("bestest_air", "9:00-17:00 23-25, else 17-22", {"actuator": 23.3}, 23.3),
        ("energyplus:cooling_phoenix", "9:00-17:00 21-24, else 17-26", {"actuator": 23.7}, 23.7),
    ],
)
def test_a_thermostat_keeps_the_strictest_bounds_of_a_schedule(testcase, schedule, set_points, cooling_C):
    scenario = validate(Scenario, {"testcase": testcase, "comfort": schedule}, "test")
    config = chosen_of(scenario, load_testcase(testcase), "thermostat").config
    assert (config.setpoints_C, config.cooling_setpoint_C) == (set_points, cooling_C)
    of_its_own = {"name": "thermostat", "options": {"setpoint_C": 20.0}}
    scenario = validate(Scenario, {"testcase": testcase, "comfort": schedule, "controller": of_its_own}, "test")
    config = chosen_of(scenario, load_testcase(testcase)).config
    assert config.setpoint_C == 20.0
    assert config.setpoints_C != set_points


def test_plans_and_kpis_have_the_bounds_of_the_schedule():
    testcase = load_testcase("bestest_hydronic_heat_pump")
    spec = PlantSpec()
    own, scheduled = (build_plant(spec, testcase, 1, comfort) for comfort in (None, Comfort(schedule="else 25-26")))
    for plant in (own, scheduled):
        plant.reset(20 * DAY_S, DAY_S)
        plant.advance(0.0, 6 * HOUR_S)
    ahead = scheduled.forecast(DAY_S, HOUR_S)
    assert (ahead.lower_C == 25).all()
    assert (ahead.upper_C == 26).all()
    record = own.past(60.0)
    scored = record.time_s >= 20 * DAY_S
    missing = np.trapezoid(25 - record.T_zone_C[0, scored], record.time_s[scored]) / HOUR_S
    assert scheduled.kpis()["tdis_tot"] == pytest.approx(missing, rel=1e-3)
    assert own.kpis()["tdis_tot"] < 0.5 * missing
    assert scheduled.kpis()["cost_tot"] == own.kpis()["cost_tot"]


def test_discomfort_is_told_zone_by_zone_where_there_are_several():
    testcase = load_testcase("house:2rooms")
    zones = testcase.layout.names.zones
    plant = build_plant(PlantSpec(), testcase, 1, Comfort(schedule={zones[0]: "else 35-36", "others": "else 5-40"}))
    plant.reset(20 * DAY_S, DAY_S)
    plant.advance([0.0] * len(testcase.layout.names.actuators), HOUR_S)
    kpis = plant.kpis()
    assert kpis[f"tdis_tot[{zones[0]}]"] > 5
    assert kpis[f"tdis_tot[{zones[1]}]"] == 0
    assert kpis["tdis_tot"] == pytest.approx(kpis[f"tdis_tot[{zones[0]}]"] / 2)


def test_what_else_a_plant_can_stays():
    class Room(SimpleHouse):
        def go_on(self, *_, **__):
            """A plant that outlives its process."""

        def leave(self):
            """It is left where it stands."""

    testcase = load_testcase("bestest_hydronic_heat_pump")
    plant = WithComfort(Room(), Comfort(schedule="else 20-24"), testcase)
    assert isinstance(plant, Plant)
    assert isinstance(plant, OutlivingPlant)
    assert not isinstance(WithComfort(SimpleHouse(), Comfort(schedule="else 20-24"), testcase), OutlivingPlant)
    assert isinstance(plant, RoomSetpointPlant) == isinstance(Room(), RoomSetpointPlant)
    with pytest.raises(ConfigError, match="no zone 'bath'"):
        WithComfort(Room(), Comfort(schedule={"bath": "else 20-24"}), testcase)
