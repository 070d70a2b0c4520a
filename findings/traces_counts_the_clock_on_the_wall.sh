#!/usr/bin/env bash
# traces weighs by the clock on the wall: a machine that ran half of a night in October ran 62 % of it.
#
# Versions: traces 0.7.0, Python's zoneinfo
# A good guess: stamps that know their time zone are instants: a mean weighs by hours that passed, and hourly samples of the day with
# 25 hours are 26 with both ends
# Seen: from midnight to 04:00 are five hours on the day when clocks go back; a machine on until 02:30, before they do, is on for half of
# them, and the mean is 2.5 / 4; hourly samples of that day are 25, none of them in the second hour from 02:00 to 03:00; in March
# the night has an hour that there was not. The same stamps in UTC are right
# Why it matters: running time, energy and mean temperature of two days a year are wrong by an hour, and a level read in the hour that
# comes twice is that of the first
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile traces==0.7.0 tzdata==2025.2
"$work/venv/bin/python" - <<'EOF'
from datetime import datetime, timedelta, timezone
from zoneinfo import ZoneInfo

import traces

HOME = ZoneInfo("Europe/Brussels")


def night(day, off_at, zone):
    """Share of the night from midnight to 04:00 local time in which a machine ran that stopped at a time; in stamps of a zone."""
    begin, off, end = (one.astimezone(zone) for one in (day, off_at, day.replace(hour=4)))
    level = traces.TimeSeries({begin: 1.0, off: 0.0, end: 0.0})
    return level.mean(begin, end)


october, march = (datetime(2025, *day, tzinfo=HOME) for day in ((10, 26), (3, 30)))
for name, day, off in (("October", october, october.replace(hour=2, minute=30)), ("March", march, march.replace(hour=3))):
    print(f"{name}: on for {night(day, off, HOME):.3f} of the night by local stamps, {night(day, off, timezone.utc):.3f} by UTC")
level = traces.TimeSeries({october: 1.0, october + timedelta(days=1): 1.0})
samples = [at for at, _ in level.sample(timedelta(hours=1), october, october + timedelta(days=1))]
print(len(samples), "hourly samples, of which in the repeated hour:", sum(at.fold for at in samples))
assert night(october, october.replace(hour=2, minute=30), HOME) == 2.5 / 4
assert night(october, october.replace(hour=2, minute=30), timezone.utc) == 2.5 / 5
assert night(march, march.replace(hour=3), HOME) == 3 / 4
assert abs(night(march, march.replace(hour=3), timezone.utc) - 2 / 3) < 1e-12
assert len(samples) == 25 and not any(at.fold for at in samples)
EOF
