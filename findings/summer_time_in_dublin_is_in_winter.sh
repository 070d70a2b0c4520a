#!/usr/bin/env bash
# Of a house in Dublin, zoneinfo, pytz, dateutil, arrow, polars and pendulum say that daylight saving is in winter, of -1 hour.
#
# Versions: tzdata 2025.2, pytz 2025.2, python-dateutil 2.9.0.post0, arrow 1.3.0, polars 2.1.0, pendulum 3.1.0 (newer ones too)
# A good guess: dst() is one hour in summer and none in winter, as in Prague
# Seen: 0 in summer and -1 hour in winter; pendulum's is_dst() is True in January and False in July (the law of Ireland names summer
# time the standard time). In Casablanca dst() is -1 hour in Ramadan alone
# Why it matters: a controller that takes "standard time" as local time less dst(), or asks whether it is summer, moves set-points of
# weather files and meters in standard time by an hour for a whole season, in this country only
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile tzdata==2025.2 pytz==2025.2 python-dateutil==2.9.0.post0 arrow==1.3.0 polars==2.1.0 \
  pendulum==3.1.0
PYTHONTZPATH="" "$work/venv/bin/python" -W ignore - <<'PY'
import datetime
import zoneinfo

import arrow
import dateutil.zoneinfo
import pendulum
import polars as pl
import pytz

HOUR = datetime.timedelta(hours=1)


def saving(zone, month):
    naive = datetime.datetime(2025, month, 1)
    return {
        "zoneinfo": zoneinfo.ZoneInfo(zone).dst(naive),
        "pytz": pytz.timezone(zone).localize(naive).dst(),
        "dateutil": dateutil.zoneinfo.get_zonefile_instance().get(zone).dst(naive),
        "arrow": arrow.get(2025, month, 1, tzinfo=zoneinfo.ZoneInfo(zone)).dst(),
        "polars": pl.Series([naive]).dt.replace_time_zone(zone).dt.dst_offset()[0],
    }


for zone in ("Europe/Prague", "Europe/Dublin"):
    for name, month in (("January", 1), ("July", 7)):
        hours = {library: value / HOUR for library, value in saving(zone, month).items()}
        is_dst = pendulum.datetime(2025, month, 1, tz=zone).is_dst()
        print(f"{zone} {name}: {hours}, pendulum is_dst {is_dst}")
        expected = {("Europe/Prague", 1): 0, ("Europe/Prague", 7): 1, ("Europe/Dublin", 1): -1, ("Europe/Dublin", 7): 0}
        assert set(hours.values()) == {expected[zone, month]}, hours
        assert is_dst == (expected[zone, month] != 0)
PY
