#!/usr/bin/env bash
# A job each day at 02:30: on the last Sunday of October croniter and APScheduler run it twice, cronsim once.
#
# Versions: croniter 7.0.0, APScheduler 3.11.3, cronsim 2.8
# A good guess: once a day: a job with a fixed hour runs once in the repeated hour (as cron's manual says), and is
# skipped in March, when 02:30 does not exist
# Seen: croniter and APScheduler: 02:30 summer time and 02:30 winter time; in March all three run it at 03:00, or
# 02:30+01:00, which is 03:30. cronsim tells '*/30 * * * *' (every half hour, repeated hour twice) from '0,30 2-3 * * *'
# (once)
# Why it matters: a night setback, a trial or a bill of the day made by such a job is done twice, an hour apart, once a
# year
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile croniter==7.0.0 apscheduler==3.11.3 cronsim==2.8 tzdata==2026.6
"$work/venv/bin/python" -W ignore - <<'EOF'
from datetime import datetime
from zoneinfo import ZoneInfo

from apscheduler.triggers.cron import CronTrigger
from croniter import croniter
from cronsim import CronSim

zone = ZoneInfo("Europe/Brussels")


def by_croniter(start):
    times = croniter("30 2 * * *", start)
    return [times.get_next(datetime) for _ in range(3)]


def by_apscheduler(start):
    trigger, times, now = CronTrigger(hour=2, minute=30, timezone=zone), [], start
    for _ in range(3):
        times.append(trigger.get_next_fire_time(times[-1] if times else None, now))
        now = times[-1]
    return times


def by_cronsim(start):
    times = CronSim("30 2 * * *", start)
    return [next(times) for _ in range(3)]


autumn, spring = datetime(2025, 10, 25, 12, tzinfo=zone), datetime(2025, 3, 29, 12, tzinfo=zone)
for name, times in (("croniter", by_croniter), ("APScheduler", by_apscheduler), ("cronsim", by_cronsim)):
    print(f"{name:12}", [t.isoformat() for t in times(autumn)[:2]], "March:", times(spring)[0].isoformat())
    on_the_day = [t for t in times(autumn) if t.date().isoformat() == "2025-10-26"]
    assert len(on_the_day) == (1 if name == "cronsim" else 2), name
    assert times(spring)[0].date().isoformat() == "2025-03-30", name
EOF
