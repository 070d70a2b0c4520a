"""Schedules and calendar of an IDF file, as the engine reads them."""

import numpy as np
import pytest

from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.energyplus.office import Calendar, Schedule, idf_objects

TEXT = """
  RunPeriodControl:SpecialDays, New Year, January 1, 1, Holiday;  ! a comment, with commas; and more
  RunPeriodControl:SpecialDays, MLK, 3rd Monday in January, 1, Holiday;
  RunPeriodControl:SpecialDays, Memorial Day, Last Monday in May, 1, Holiday;
  RunPeriodControl:DaylightSavingTime, 2nd Sunday in March, 1st Sunday in November;
  Schedule:Compact, Setpoint, Temperature, Through: 12/31,
    For: Weekdays SummerDesignDay, Until: 06:30, 15.6, Until: 22:00, 21.0, Until: 24:00, 15.6,  ! days
    For: Saturday, Until: 24:00, 18,
    For: AllOtherDays, Until: 24:00, 10;
  Schedule:Compact, Summer, Temperature, Through: 5/31, For: AllDays, Until: 24:00, 1,
    Through: 12/31, For: AllDays, Until: 24:00, 2;
  Schedule:Compact, Weekdays only, Temperature, Through: 12/31, For: Weekdays, Until: 24:00, 1;
"""
CALENDAR = Calendar.of(TEXT)
SETPOINT = Schedule.of(TEXT, "SETPOINT")


def at(day, hour):
    return float(SETPOINT.at(np.array([day * DAY_S + hour * HOUR_S]), CALENDAR)[0])


def test_objects_come_without_comments():
    assert idf_objects(TEXT, "runperiodcontrol:specialdays")[0] == ["New Year", "January 1", "1", "Holiday"]


def test_a_value_holds_from_the_hour_on_until_which_the_one_before_it_holds():
    assert [at(1, h) for h in (0, 6.49, 6.5, 21.99, 22, 23.9)] == [15.6, 15.6, 21.0, 21.0, 15.6, 15.6]


def test_the_year_begins_on_a_monday_and_holidays_come_every_year():
    assert [CALENDAR.kind(day) for day in (0, 1, 5, 6, 7, 14, 21, 147)] == [
        "Holiday", "Tuesday", "Saturday", "Sunday", "Monday", "Holiday", "Monday", "Holiday",
    ]  # fmt: skip
    assert [CALENDAR.kind(365 + day) for day in (0, 1, 20)] == ["Holiday", "Wednesday", "Holiday"]
    assert [at(day, 12) for day in (0, 1, 5, 6)] == [10.0, 21.0, 18.0, 10.0]


def test_clocks_are_an_hour_ahead_in_daylight_saving_time_and_days_with_them():
    assert [at(67, h) for h in (5.6, 6.5)] == [15.6, 21.0]  # Friday before the change, 9 March
    assert [at(70, h) for h in (5.4, 5.5)] == [15.6, 21.0]  # Monday after it
    assert at(74, 23.5) == 18.0  # Friday 23:30 of standard time is Saturday on the clock
    assert [at(308, h) for h in (5.6, 6.5)] == [15.6, 21.0]  # Monday after the end, 5 November


def test_what_cannot_be_read_is_refused_by_name():
    with pytest.raises(PlantError, match="0 schedules 'Nothing'"):
        Schedule.of(TEXT, "Nothing")
    with pytest.raises(PlantError, match="'Summer' differs over the year"):
        Schedule.of(TEXT, "Summer")
    with pytest.raises(PlantError, match="'Weekdays only' has no rule for a Sunday"):
        Schedule.of(TEXT, "Weekdays only").at(np.array([6 * DAY_S]), CALENDAR)
    with pytest.raises(PlantError, match="'Strike' has 2 days"):
        Calendar.of("RunPeriodControl:SpecialDays, Strike, May 1, 2, CustomDay1;")
    with pytest.raises(PlantError, match="day '2nd of May'"):
        Calendar(("2nd of May",)).kind(0)
