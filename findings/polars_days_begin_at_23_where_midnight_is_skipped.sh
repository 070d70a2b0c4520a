#!/usr/bin/env bash
# Where summer time begins at midnight, polars' day begins at 23:00 of the day before; at 02:30 a missing time becomes 01:30.
#
# Versions: polars 2.1.0, tzdata 2025.2
# A good guess: a day's group in Santiago is its 23 hours, or an error (midnight of 7 September 2025 does not exist); a daily stamp at
# 02:30 that falls into Brussels' gap raises, or moves on to 03:30
# Seen: group_by_dynamic("1d") puts the last hour of 6 September into a group named by 6 September 23:00, which ends a day later at
# 23:00, so that the last hour of 7 September is in no group; dt.truncate("1d") is right. offset_by("1d") and datetime_range give 01:30
# Why it matters: where clocks change at midnight (Chile, Lebanon) a day's energy is of other hours, an hour is lost, two rows fall on
# one date and one date has none; a switch at 02:30 comes an hour too soon
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile polars==2.1.0 tzdata==2025.2
"$work/venv/bin/python" -W ignore - <<'PY'
from datetime import date, datetime

import polars as pl

hours = pl.datetime_range(datetime(2025, 9, 5, 4), datetime(2025, 9, 9, 2), "1h", time_zone="UTC", eager=True)
table = pl.DataFrame({"t": hours.dt.convert_time_zone("America/Santiago")})
days = table.group_by_dynamic("t", every="1d").agg(pl.len())
by_date = table.group_by(pl.col("t").dt.date()).len().sort("t")
print(days, by_date)
groups = [(str(start)[:16], count) for start, count in days.rows()]
assert table.height == 95 and days["len"].sum() == 94
assert groups == [("2025-09-05 00:00", 24), ("2025-09-06 00:00", 23), ("2025-09-06 23:00", 23), ("2025-09-08 00:00", 24)], groups
assert [count for _, count in by_date.rows()] == [24, 24, 23, 24]
assert date(2025, 9, 7) not in [start.date() for start, _ in days.rows()]
truncated = table.filter(pl.col("t").dt.date() == date(2025, 9, 7))["t"].dt.truncate("1d")
assert [str(value)[:16] for value in truncated.unique()] == ["2025-09-07 01:00"]

stamp = pl.Series([datetime(2025, 3, 29, 2, 30)]).dt.replace_time_zone("Europe/Brussels")
shifted = stamp.dt.offset_by("1d")[0]
ranged = pl.datetime_range(datetime(2025, 3, 29, 2, 30), datetime(2025, 3, 31, 12), "1d", time_zone="Europe/Brussels", eager=True)
print(f"29 March 02:30 and a day: {shifted}; daily at 02:30: {[str(value) for value in ranged]}")
assert str(shifted) == "2025-03-30 01:30:00+01:00" and str(ranged[1]) == "2025-03-30 01:30:00+01:00"
PY
