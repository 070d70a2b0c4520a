#!/usr/bin/env bash
# ics reads times and days that a calendar leaves to its own zone as those of UTC.
#
# Versions: ics 0.7.3, and beside it icalevents 0.3.1
# A good guess: a time without a zone is local (RFC 5545: of the clock wherever it is read), of the zone that the calendar names
# (X-WR-TIMEZONE, as Google and Outlook write it), or comes without a zone; a whole day begins at midnight there
# Seen: in a calendar of Berlin an event at 08:00 begins at 08:00 UTC, at 10:00 in summer, and two days away begin at 02:00 and end
# at 02:00 two days later; nothing tells it from a time that was in UTC. icalevents reads the same file as of Berlin
# Why it matters: presence, holidays and boosts from a calendar heat one hour late in winter and two in summer, cold rooms at eight
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile ics==0.7.3 icalevents==0.3.1
"$work/venv/bin/python" -W ignore - <<'PY'
from datetime import datetime, timedelta, timezone
from zoneinfo import ZoneInfo

import ics
from icalevents.icalevents import events

TEXT = """BEGIN:VCALENDAR
VERSION:2.0
PRODID:-//example//EN
X-WR-TIMEZONE:Europe/Berlin
BEGIN:VEVENT
UID:office@example.org
DTSTAMP:20260101T000000Z
DTSTART:20260710T080000
DTEND:20260710T160000
SUMMARY:Office
END:VEVENT
BEGIN:VEVENT
UID:away@example.org
DTSTAMP:20260101T000000Z
DTSTART;VALUE=DATE:20260720
DTEND;VALUE=DATE:20260722
SUMMARY:Away
END:VEVENT
END:VCALENDAR
""".replace("\n", "\r\n")
berlin = ZoneInfo("Europe/Berlin")
by_ics = {e.name: e.begin.datetime for e in ics.Calendar(TEXT).events}
day = datetime(2026, 7, 1, tzinfo=berlin), datetime(2026, 8, 1, tzinfo=berlin)
by_other = {e.summary: e.start for e in events(string_content=TEXT.encode(), start=day[0], end=day[1])}
late = {name: by_ics[name] - by_other[name] for name in by_ics}
print({name: (str(by_ics[name].astimezone(berlin)), str(by_other[name].astimezone(berlin))) for name in by_ics})
assert by_other == {"Office": datetime(2026, 7, 10, 8, tzinfo=berlin), "Away": datetime(2026, 7, 20, tzinfo=berlin)}
assert late == {"Office": timedelta(hours=2), "Away": timedelta(hours=2)}
assert all(one.utcoffset() == timedelta(0) for one in by_ics.values())
PY
