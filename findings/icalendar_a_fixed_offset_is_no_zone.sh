#!/usr/bin/env bash
# icalendar writes a time with an offset, 12:00+02:00, so that it is read back as 12:00 of no zone; the second 02:30 as the first.
#
# Versions: icalendar 7.3.2
# A good guess: what was written is read back as the same instant, as it is for UTC and for Europe/Brussels, or is refused
# Seen: an offset, as datetime.fromisoformat gives it, is written as TZID="UTC+02:00", of which add_missing_timezones makes
# no VTIMEZONE; the same package reads 12:00 without a zone. 02:30 of standard time on the night of 25 October is written
# as that of summer time, an hour earlier, without a word
# Why it matters: cheap hours of a price service (2026-07-01T12:00:00+02:00) put into a calendar that a thermostat or Home
# Assistant follows are hours of whatever clock its reader has: two hours late on a server in UTC
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile icalendar==7.3.2 tzdata
"$work/venv/bin/python" -W ignore - <<'PY'
from datetime import datetime, timedelta, timezone
from zoneinfo import ZoneInfo

from icalendar import Calendar, Event


def read_back(start):
    calendar = Calendar.new()
    calendar.add_component(Event.new(summary="cheap", start=start, end=start + timedelta(hours=1)))
    calendar.add_missing_timezones()
    text = calendar.to_ical()
    return text, Calendar.from_ical(text).events[0].start


for zone in (timezone.utc, ZoneInfo("Europe/Brussels"), ZoneInfo("Etc/GMT-2")):
    start = datetime(2026, 7, 1, 12, tzinfo=zone)
    assert read_back(start)[1] == start, zone

text, found = read_back(datetime.fromisoformat("2026-07-01T12:00:00+02:00"))
print(text.decode(), "read back:", found, found.tzinfo)
assert b'DTSTART;TZID="UTC+02:00":20260701T120000' in text and b"VTIMEZONE" not in text
assert found == datetime(2026, 7, 1, 12) and found.tzinfo is None

second = datetime(2026, 10, 25, 2, 30, tzinfo=ZoneInfo("Europe/Brussels"), fold=1)
_, found = read_back(second)
print("02:30 of standard time:", second.isoformat(), "read back:", found.isoformat())
assert second.astimezone(timezone.utc) - found.astimezone(timezone.utc) == timedelta(hours=1)
PY
