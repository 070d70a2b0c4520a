#!/usr/bin/env bash
# A BACnet schedule of bacpypes3 does not give back what an exception took: its Null becomes the value of the schedule.
#
# Versions: bacpypes3 0.0.110
# A good guess: as ASHRAE 135 says of Schedule objects, a Null ends an exception, and the weekly value of that time is in force;
# a Null in the week is the schedule's default; of two exceptions of one priority the first in the list wins; an effective
# period that is "any" to "any" is always
# Seen: after the Null the present value is Null, until midnight, in the week as in an exception; of two exceptions of one priority
# the last wins; a period whose beginning is "any" is never in force (one whose end is "any" works)
# Why it matters: a day with a longer morning ends with no set-point for the rest of the day instead of the usual one, and a
# schedule copied from a device that says "always" does nothing; to a point, the Null is a command withdrawn
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile bacpypes3==0.0.110
"$work/venv/bin/python" -W ignore - <<'PY'
from bacpypes3.basetypes import CalendarEntry, DailySchedule, DateRange, SpecialEvent, SpecialEventPeriod, TimeValue
from bacpypes3.constructeddata import AnyAtomic
from bacpypes3.local.schedule import ScheduleObject
from bacpypes3.primitivedata import Date, Null, Real, Time

ANY, FIRST, LAST = (255, 255, 255, 255), (100, 1, 1, 255), (199, 12, 31, 255)


def at(hour, value):
    return TimeValue(time=(hour, 0, 0, 0), value=AnyAtomic(Null(()) if value is None else Real(value)))


def exception(*entries):
    day = SpecialEventPeriod(calendarEntry=CalendarEntry(date=(126, 1, 14, 255)))
    return SpecialEvent(period=day, listOfTimeValues=[at(*entry) for entry in entries], eventPriority=10)


def value(hour, exceptions=(), period=(FIRST, LAST)):
    """What is in force on Wednesday 14 January 2026: the default is 16 °C, each day has 21 °C from 6 and Null from 22 o'clock."""
    schedule = ScheduleObject(
        objectIdentifier=("schedule", 1),
        objectName="rooms",
        presentValue=Real(0.0),
        scheduleDefault=AnyAtomic(Real(16.0)),
        weeklySchedule=[DailySchedule(daySchedule=[at(6, 21.0), at(22, None)]) for _ in range(7)],
        exceptionSchedule=list(exceptions) or None,
        effectivePeriod=DateRange(startDate=Date(period[0]), endDate=Date(period[1])),
        listOfObjectPropertyReferences=[],
        priorityForWriting=16,
    )
    found = schedule.eval(Date((126, 1, 14, 3)), Time((hour, 0, 0, 0)))
    return "not in force" if found is None else found[0].get_value()


short, warm = exception((8, 18.0), (12, None)), exception((8, 25.0))
week = [value(hour) for hour in (3, 7, 23)]
day = [value(hour, [short]) for hour in (7, 9, 13)]
both = [value(9, exceptions) for exceptions in ([short, warm], [warm, short])]
periods = [value(7, period=period) for period in ((ANY, ANY), (ANY, LAST), (FIRST, ANY))]
print("week at 3, 7, 23:", week, "| exception from 8 to 12, at 7, 9, 13:", day)
print("18 before 25, 25 before 18:", both, "| any to any, any to an end, a beginning to any:", periods)
assert week[:2] == [16.0, 21.0] and isinstance(week[2], Null)
assert day[:2] == [21.0, 18.0] and isinstance(day[2], Null)
assert both == [25.0, 18.0] and periods == ["not in force", "not in force", 21.0]
PY
