#!/usr/bin/env bash
# DuckDB's time_bucket ignores the time zone of the session, and with a zone named hours are off by one in summer.
#
# Versions: duckdb 2.0.1
# A good guess: with `SET TimeZone = 'Europe/Brussels'`, `time_bucket('1 day', t)` of a TIMESTAMPTZ is the local day, as
# `date_trunc('day', t)` is; with the zone as third argument buckets of six hours begin at 0, 6, 12 and 18 all year
# Seen: date_trunc begins at local midnight, time_bucket at midnight UTC (1:00, in summer 2:00). With the zone named days are
# local, buckets of six and of 24 hours begin at 0:00 in winter and at 1:00 in summer: 24 hours are not one day
# Why it matters: energy a day, peaks a day and prices by window are of another day than the bill's, by one or two hours
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile duckdb==2.0.1 pytz==2026.1
"$work/venv/bin/python" -W ignore - <<'EOF'
import duckdb

base = duckdb.connect()
base.execute("SET TimeZone = 'Europe/Brussels'")


def local(expression):
    return base.execute(f"SELECT strftime({expression}, '%d. %H:%M')").fetchone()[0]


for stamp, begin, late in (("2025-01-15 12:30:00+01", "01:00", "12:00"), ("2025-07-15 12:30:00+02", "02:00", "07:00")):
    t = f"'{stamp}'::TIMESTAMPTZ"
    day, bucket = local(f"date_trunc('day', {t})"), local(f"time_bucket(INTERVAL 1 DAY, {t})")
    named = local(f"time_bucket(INTERVAL 1 DAY, {t}, 'Europe/Brussels')")
    six = local(f"time_bucket(INTERVAL 6 HOUR, {t}, 'Europe/Brussels')")
    print(f"{stamp}: day by date_trunc {day}, by time_bucket {bucket}, with the zone {named}; six hours with the zone {six}")
    assert day == named == "15. 00:00" and bucket == f"15. {begin}" and six == f"15. {late}"
EOF
