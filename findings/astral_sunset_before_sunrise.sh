#!/usr/bin/env bash
# astral gives, for a date and without a time zone, a sunset that is before the sunrise, and on some days none.
#
# Versions: astral 3.2
# A good guess: `sun(observer, date)` gives the sunrise and the sunset of one day, in this order, as stamps in UTC
# Seen: at Denver, the sunset lies eleven hours before the sunrise from spring to autumn (the date is the one in UTC), and on
# days in winter, when the sunset moves across midnight UTC, "Unable to find a sunset time"; with `tzinfo` all is as guessed
# Why it matters: blinds or a night setback by the sun run the wrong way round, and stop with an error one day in winter
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile astral==3.2 tzdata==2025.2
"$work/venv/bin/python" -W ignore - <<'EOF'
import datetime as dt
from zoneinfo import ZoneInfo

from astral import Observer
from astral.sun import sun

denver, zone = Observer(39.74, -104.99), ZoneInfo("America/Denver")
year = [dt.date(2025, 1, 1) + dt.timedelta(days=k) for k in range(365)]
before, none = [], []
for date in year:
    local = sun(denver, date=date, tzinfo=zone)
    assert local["sunrise"] < local["sunset"]
    try:
        both = sun(denver, date=date)
    except ValueError as error:
        none.append((date, str(error)))
        continue
    if both["sunset"] < both["sunrise"]:
        before.append(date)
print(f"sunset before sunrise on {len(before)} days, no sunset on {len(none)}: {none[:1]}")
assert len(before) > 150 and none
EOF
