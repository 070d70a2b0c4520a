#!/usr/bin/env bash
# In ClickHouse an hour without a reading is 0 °C: in joins, in gaps that are filled and in the least of no readings.
#
# Versions: chdb 4.4.0 (ClickHouse in a Python package)
# A good guess: NULL, as in every other SQL: an outer join has nothing to put there, a fill adds stamps alone, nothing has no least
# Seen: a column that cannot be NULL gets the 0 of its type in all three; only `SET join_use_nulls = 1` changes the joins, and INTERPOLATE
# the gaps. An average over the joined hours takes the zeros for weather
# Why it matters: readings every 15 min joined with weather every hour have 0 °C in three of four rows, which is a likely winter's day,
# and a model learns from it; no value is missing that a check could count
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile chdb==4.4.0
cd "$work"
"$work/venv/bin/python" - <<'PY'
import json

import chdb

ROOM = "(SELECT toDateTime('2026-01-10 00:00:00', 'UTC') + number * 900 AS t, 21.0 AS T_room FROM numbers(8))"
WEATHER = "(SELECT toDateTime('2026-01-10 00:00:00', 'UTC') + number * 3600 AS t, -5.0 AS T_out FROM numbers(2))"


def ask(sql):
    rows = json.loads(str(chdb.query(sql, "JSONCompact")))["data"]
    print(sql.replace(ROOM, "room").replace(WEATHER, "weather"), "->", rows)
    return [row[0] for row in rows]


joined = f"SELECT T_out FROM {ROOM} AS r LEFT JOIN {WEATHER} AS w USING t ORDER BY t"
assert ask(joined) == [-5, 0, 0, 0, -5, 0, 0, 0]
assert ask(f"SELECT avg(T_out) FROM ({joined})") == [-1.25]
assert ask(f"SELECT T_out FROM {WEATHER} ORDER BY t WITH FILL STEP 1800") == [-5, 0, -5]
assert ask(f"SELECT min(T_out) FROM {WEATHER} WHERE T_out > 0") == [0]
assert ask(joined + " SETTINGS join_use_nulls = 1") == [-5, None, None, None, -5, None, None, None]
PY
