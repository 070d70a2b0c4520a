#!/usr/bin/env bash
# polars' two ways to six hours disagree for the rest of the day on which clocks change.
#
# Versions: polars 2.1.0
# A good guess: group_by_dynamic(every="6h") puts a stamp where truncate("6h") puts it
# Seen: on the day of 25 hours truncate has 4 buckets, at 0, 6, 12 and 18 local (the first holds 7 hours), group_by_dynamic
# has 5, at 0, 5, 11, 17 and 23 (elapsed time); on the day of 23 hours 4 and 4, at different hours. For 1 h and 1 d both agree
# Why it matters: features or tariffs of blocks of hours made with one, joined to readings aggregated with the other, find
# no partner after 1:00, or the wrong one, on two days of a year
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile polars==2.1.0 tzdata
"$work/venv/bin/python" -W ignore - <<'PY'
from datetime import datetime, timedelta, timezone

import polars as pl


def local_day(first_utc, quarters):
    stamps = [first_utc + timedelta(minutes=15 * k) for k in range(quarters)]
    return pl.DataFrame({"t": pl.Series(stamps).dt.convert_time_zone("Europe/Brussels")})


def hours(frame, every):
    truncated = frame.select(pl.col("t").dt.truncate(every)).unique().sort("t")["t"].dt.hour().to_list()
    grouped = frame.group_by_dynamic("t", every=every).agg(pl.len())["t"].dt.hour().to_list()
    return truncated, grouped


autumn = local_day(datetime(2025, 10, 25, 22, tzinfo=timezone.utc), 100)
spring = local_day(datetime(2025, 3, 29, 23, tzinfo=timezone.utc), 92)
for day in (autumn, spring):
    print("truncate, group_by_dynamic:", *hours(day, "6h"))
assert hours(autumn, "6h") == ([0, 6, 12, 18], [0, 5, 11, 17, 23])
assert hours(spring, "6h")[0] == [0, 6, 12, 18] != hours(spring, "6h")[1]
for every in ("1h", "1d"):
    for day in (autumn, spring):
        truncated, grouped = hours(day, every)
        assert truncated == grouped
PY
