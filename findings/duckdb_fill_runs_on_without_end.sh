#!/usr/bin/env bash
# DuckDB's fill() carries the line through the last two readings on for ever: a room whose sensor stopped at 18 °C is at -6 °C a day later.
#
# Versions: duckdb 2.0.1; pandas 3.1.1, polars 2.1.0 in comparison
# A good guess: between two readings a straight line; after the last one (and before the first) nothing, or the last reading, as
# pandas' and polars' interpolate have it
# Seen: after the last reading the line goes on: 18.5 and 18 °C half an hour apart, and 24 hours later -6 °C; before the first reading
# it goes back likewise. With one reading, that one is held
# Why it matters: the last row of a table is "now", where a sensor that was lost leaves NULLs: the state from which a plan begins, and
# meters filled the same way count energy that nobody used
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile duckdb==2.0.1 pandas==3.1.1 polars==2.1.0
"$work/venv/bin/python" - <<'EOF'
import duckdb
import pandas as pd
import polars as pl

READ = [21.0, 20.0, None, 19.0, 18.5, 18.0] + [None] * 48
STAMPS = pd.date_range("2026-01-10", periods=len(READ), freq="30min")
QUERY = """SELECT fill(room) OVER (ORDER BY stamp)
           FROM (SELECT unnest(?::DOUBLE[]) AS room, TIMESTAMP '2026-01-10' + INTERVAL 30 MINUTE * unnest(range(54)) AS stamp)"""
filled = [row[0] for row in duckdb.execute(QUERY, [READ]).fetchall()]
others = pd.Series(READ, STAMPS, dtype="float64").interpolate(method="time"), pl.Series(READ).interpolate()
print("between readings:", filled[2], "; an hour, 12 h and 24 h after the last:", filled[7], filled[29], filled[53])
print("24 h after the last, pandas and polars:", others[0].iloc[53], others[1][53])
assert filled[2] == others[0].iloc[2] == others[1][2] == 19.5
assert [round(filled[i], 6) for i in (7, 29, 53)] == [17.0, 6.0, -6.0]
assert others[0].iloc[53] == 18.0 and others[1][53] is None
before = duckdb.sql("SELECT fill(v) OVER (ORDER BY t) FROM (VALUES (0, NULL), (10, 18.0::DOUBLE), (11, 19.0)) x(t, v)").fetchall()
print("ten steps before the first reading, 18, of a room that rises by 1 a step:", before[0][0])
assert before[0][0] == 8.0
EOF
