#!/usr/bin/env bash
# sqlglot hands MySQL's number of a weekday to DuckDB by its name, where it means another day.
#
# Versions: sqlglot 30.30.0, duckdb 2.0.1
# A good guess: what is translated gives the same numbers, or is refused
# Seen: WEEKDAY(ts), 0 on Monday in MySQL and MariaDB, stays WEEKDAY(ts), 0 on Sunday in DuckDB; DAYOFWEEK(ts), 1 on Sunday there, is
# 0 on Sunday here; neither the strictest level of errors nor warnings say it. WEEKDAY(ts) < 5, Monday to Friday, is Sunday to Thursday
# Why it matters: queries over a recorder's MariaDB are moved to DuckDB or Parquet so; rates and hours of weekdays, and people's
# habits, go by Sunday and lose Friday, which totals do not show
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile sqlglot==30.30.0 duckdb==2.0.1
"$work/venv/bin/python" - <<'PY'
import logging

import duckdb
import sqlglot

said = []
handler = logging.Handler()
handler.emit = lambda record: said.append(record.getMessage())
logging.getLogger("sqlglot").addHandler(handler)
# The manuals of MySQL 8.4 and MariaDB: WEEKDAY 0 = Monday ... 6 = Sunday, DAYOFWEEK 1 = Sunday ... 7 = Saturday.
DAYS = {"2026-11-29": ("Sunday", 6, 1), "2026-11-30": ("Monday", 0, 2), "2026-12-04": ("Friday", 4, 6)}
for k, function in ((1, "WEEKDAY"), (2, "DAYOFWEEK")):
    (query,) = sqlglot.transpile(
        f"SELECT {function}(ts) FROM t", read="mysql", write="duckdb", unsupported_level=sqlglot.ErrorLevel.RAISE
    )
    seen = {}
    for day, told in DAYS.items():
        ((value,),) = duckdb.sql(query.replace("FROM t", f"FROM (SELECT TIMESTAMP '{day} 12:00' AS ts)")).fetchall()
        seen[told[0]] = (told[k], value)
    print(query, "| MySQL, DuckDB:", seen)
    assert all(meant != found for meant, found in seen.values())
(query,) = sqlglot.transpile(
    "SELECT GROUP_CONCAT(DAYNAME(ts)) FROM t WHERE WEEKDAY(ts) < 5", read="mysql", write="duckdb"
)
week = "(SELECT unnest(generate_series(TIMESTAMP '2026-11-30 12:00', TIMESTAMP '2026-12-06 12:00', INTERVAL 1 DAY)) AS ts)"
((days,),) = duckdb.sql(query.replace("FROM t", f"FROM {week}")).fetchall()
print("weekdays:", days, "| said:", said)
assert "Sunday" in days and "Friday" not in days and not said
PY
