#!/usr/bin/env bash
# hszinc writes NaN and infinity so that neither it nor another Haystack reader takes the table; in JSON they come back as text.
#
# Versions: hszinc 1.3.2
# A good guess: a table that was parsed comes back from `dump` and `parse` as it was: Zinc spells these numbers NaN, INF and -INF
# Seen: it reads NaN, INF and -INF and writes nan, inf and -inf, which its own parser refuses, the whole table with them; by JSON
# the values come back as the strings "n:nan" and "n:inf". A table of ordinary readings comes back as it was
# Why it matters: one reading that is not there, which Haystack servers send as NaN, and the history of all points that is
# passed on or kept cannot be read any more
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile hszinc==1.3.2
"$work/venv/bin/python" -W ignore - <<'PY'
import logging

import hszinc

logging.disable(logging.CRITICAL)


def parsed(text, mode=hszinc.MODE_ZINC):
    grid = hszinc.parse(text, mode=mode)
    return grid[0] if isinstance(grid, list) else grid


plain = parsed('ver:"2.0"\nv\n21.5\n22\n')
assert [row["v"] for row in parsed(hszinc.dump(plain))] == [21.5, 22.0]
grid = parsed('ver:"2.0"\nv\n21.5\nNaN\nINF\n')
written = hszinc.dump(grid)
by_json = [row["v"] for row in parsed(hszinc.dump(grid, mode=hszinc.MODE_JSON), hszinc.MODE_JSON)]
print("read", [row["v"] for row in grid], "| written", written.split(), "| by JSON", by_json)
assert written.split()[-2:] == ["nan", "inf"] and by_json[-2:] == ["n:nan", "n:inf"]
try:
    parsed(written)
except Exception as error:
    print("read again:", type(error).__name__)
else:
    raise SystemExit("it reads what it writes")
PY
