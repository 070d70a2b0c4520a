#!/usr/bin/env bash
# A nightly event of exactly eight hours (DURATION:PT8H) lasts seven when clocks go forward, in recurring-ical-events.
#
# Versions: recurring-ical-events 3.8.2, icalendar 7.3.2
# A good guess: RFC 5545 calls PT8H an exact duration: the night from 22:00 ends at 07:00 after the change in March
# Seen: it ends at 06:00 (seven hours), in October nine hours later, at 06:00: hours are added to the wall clock
# Why it matters: holds, minimum run times and trials written as exact durations in a calendar are an hour short or long
# on two nights a year
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile recurring-ical-events==3.8.2 icalendar==7.3.2 x-wr-timezone==2.0.1 tzdata==2026.6
"$work/venv/bin/python" -W ignore - <<'EOF'
from datetime import timezone

import icalendar
import recurring_ical_events

lines = """BEGIN:VCALENDAR
VERSION:2.0
PRODID:finding
BEGIN:VEVENT
UID:night
DTSTAMP:20250101T000000Z
DTSTART;TZID=Europe/Brussels:20250301T220000
DURATION:PT8H
RRULE:FREQ=DAILY
SUMMARY:night
END:VEVENT
END:VCALENDAR
"""
calendar = icalendar.Calendar.from_ical(lines.replace("\n", "\r\n"))


def hours(day):
    events = recurring_ical_events.of(calendar).at(day)
    event = next(e for e in events if e["DTSTART"].dt.day == day[2])
    begin, end = event["DTSTART"].dt, event["DTEND"].dt
    print(begin.isoformat(), "to", end.isoformat())
    return (end.astimezone(timezone.utc) - begin.astimezone(timezone.utc)).total_seconds() / 3600


assert hours((2025, 3, 1)) == 8 and hours((2025, 3, 29)) == 7 and hours((2025, 10, 25)) == 9
EOF
