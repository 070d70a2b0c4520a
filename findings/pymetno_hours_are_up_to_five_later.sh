#!/usr/bin/env bash
# pyMetno's forecast by the hour has, from the third day on, the temperature of up to five hours later, six hours' rain each, no evenings.
#
# Versions: PyMetno 0.13.0 (PyPI), made for the API of MET Norway (Locationforecast 2.0), as Home Assistant's default weather uses it
# A good guess: MET Norway gives 2.5 days by the hour and then every sixth hour; an hour between two of those has a temperature between
# theirs, or is left out, and rain is that of an hour
# Seen: each hour takes the next entry of its day. A room's outdoors that rises by 1 K/h rises by 6 K at 07:00 and at 13:00; rain of 6 mm
# in six hours is 6 mm in each hour, 114 mm of a day of 24; the hours from 19:00 to 23:00, after the day's last entry, are not there. Which
# hours those are goes by the clock of the machine, whatever time zone was asked for
# Why it matters: a plan of three days or more buffers for a morning that comes five hours early, and a table by the hour has 19 rows a day
# that are easily read as 24
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile PyMetno==0.13.0
cat >"$work/hours.py" <<'EOF'
from collections import Counter
from datetime import datetime, timedelta, timezone
from zoneinfo import ZoneInfo

from metno import MetWeatherData

HOUR, NOW = timedelta(hours=1), datetime.now(timezone.utc).replace(minute=0, second=0, microsecond=0)


def entry(at, hours):
    """An entry of the service: outdoors that rise by 1 K/h from now, and rain of 1 mm/h over the hours until the next."""
    rain = {"summary": {"symbol_code": "rain"}, "details": {"precipitation_amount": float(hours)}}
    instant = {"details": {"air_temperature": (at - NOW) / HOUR}}
    return {"time": f"{at:%Y-%m-%dT%H:%M:%SZ}", "data": {"instant": instant, f"next_{hours}_hours": rain}}


at, entries = NOW, []
while len(entries) < 80:
    hours = 1 if at < NOW + 60 * HOUR or at.hour % 6 else 6
    entries.append(entry(at, hours))
    at += hours * HOUR
service = MetWeatherData({"lat": 59.9, "lon": 10.7}, websession=object())
service.data = {"properties": {"timeseries": entries}}
day = (NOW + timedelta(days=4)).date()
rows = {}
for row in service.get_forecast(ZoneInfo("Europe/Oslo"), hourly=True, range_stop=130):
    at = datetime.fromisoformat(row["datetime"])
    ahead = row["temperature"] - (at - NOW) / HOUR
    if at < NOW + 60 * HOUR:
        assert (ahead, row["precipitation"]) == (0, 1)
    elif at.date() == day:
        rows[at.hour] = ahead, row["precipitation"]
print(day, "by hour, (hours by which the temperature is ahead, mm of rain):", rows)
print("hours missing:", [hour for hour in range(24) if hour not in rows], "; rain of the day:", sum(mm for _, mm in rows.values()), "mm")
assert list(rows) == list(range(19)) and Counter(rows.values()) == {(k, 6): 4 if k == 0 else 3 for k in range(6)}
EOF
TZ=UTC "$work/venv/bin/python" "$work/hours.py"
