#!/usr/bin/env bash
# One expression of Ibis, "hours since six", is 23 at five in the morning by polars and -1 by DuckDB and SQLite.
#
# Versions: ibis-framework 12.0.0, duckdb 1.5.6, polars 2.1.0
# A good guess: an expression means one thing whatever engine runs it, and a // n * n + a % n is a, as in Python
# Seen: `//` goes down everywhere, `%` goes down in polars and towards zero in DuckDB and SQLite: there quotient and remainder of the
# hour of five make up -25. An error of -1.5 K cast to a whole number is -2 by DuckDB and -1 by the others; 20.5 and 22.5 degC rounded
# are 20 and 22 by polars, 21 and 23 by the others
# Why it matters: profiles of days that begin at six, tried on polars and run in a database, lose the night to hours below nought, and
# set-points differ by a kelvin
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile "ibis-framework[duckdb,polars,sqlite]==12.0.0" duckdb==1.5.6 polars==2.1.0 sqlglot==29.0.1
"$work/venv/bin/python" -W ignore - <<'PY'
import ibis
import polars as pl

frame = pl.DataFrame({"hour": [5, 6, 18], "room": [21.0, 20.5, 22.5]})
ANSWERS = {
    "duckdb": ([-1, 0, 12], [-25, 0, 12], [-2, -2, 0], [21, 21, 23]),
    "sqlite": ([-1, 0, 12], [-25, 0, 12], [-1, -2, 0], [21, 21, 23]),
    "polars": ([23, 0, 12], [-1, 0, 12], [-1, -2, 0], [21, 20, 22]),
}
for engine, answers in ANSWERS.items():
    rooms = getattr(ibis, engine).connect().create_table("rooms", frame.to_arrow())
    since = rooms.hour - 6
    asked = rooms.select(
        hour=rooms.hour,
        since=since % 24,
        back=since // 24 * 24 + since % 24,
        error=(rooms.room - 22.5).cast("int64"),
        degrees=rooms.room.round(),
    )
    told = asked.order_by("hour").execute()
    seen = tuple([int(value) for value in told[name]] for name in ("since", "back", "error", "degrees"))
    print(f"{engine}: hours since six {seen[0]}, made up again {seen[1]}, errors {seen[2]}, degrees {seen[3]}")
    assert seen == answers, engine
PY
