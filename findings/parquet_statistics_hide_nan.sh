#!/usr/bin/env bash
# No row of a Parquet file by polars or Arrow is NaN where DuckDB asks isnan; Arrow's own filters lose NaN by row group.
#
# Versions: duckdb 2.0.1, pyarrow 26.0.1, polars 2.1.0
# A good guess: a question to a file has the answer that it has to the table read from it
# Seen: Parquet's statistics leave NaN out, and both take them for the values. DuckDB: no row where isnan(T), and the maximum
# is a number, while the table made of the same file has both NaN; a NaN above 25 is counted only where its row group has a
# reading above 25 as well. pyarrow: what is not between 5 and 35 is none of the rows by `filters` and both NaN by the table;
# is_nan loses those of row groups whose readings are all equal. Written without statistics, or read by polars, all agree
# Why it matters: a check of measurements for broken readings says that there are none, and "hours above a limit" depends on how
# many rows the writer put into a group
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile duckdb==2.0.1 pyarrow==26.0.1 polars==2.1.0 numpy==2.4.6
cd "$work"
"$work/venv/bin/python" -W ignore - <<'EOF'
import duckdb
import polars as pl
import pyarrow.compute as pc
import pyarrow.parquet as pq

NAN = float("nan")
table = pl.DataFrame({"T": [20.0, NAN, 21.0, 22.0, 23.0, NAN, 26.0, 24.0]}).to_arrow()
BROKEN = ~((pc.field("T") >= 5) & (pc.field("T") <= 35))


def asked(source):
    queries = ("count(*) FROM {} WHERE isnan(T)", "max(T) FROM {}", "count(*) FROM {} WHERE T > 25")
    return [str(duckdb.sql("SELECT " + query.format(source)).fetchall()[0][0]) for query in queries]


found = {}
for rows in (8, 4, 2):
    for statistics in (True, False):
        pq.write_table(table, "room.parquet", row_group_size=rows, write_statistics=statistics)
        duckdb.sql("CREATE OR REPLACE TABLE room AS SELECT * FROM 'room.parquet'")
        file, copy = asked("'room.parquet'"), asked("room")
        whole = pq.read_table("room.parquet")
        arrow = [(pq.read_table("room.parquet", filters=e).num_rows, whole.filter(e).num_rows) for e in (BROKEN, pc.is_nan(pc.field("T")))]
        lazy = pl.scan_parquet("room.parquet").filter(pl.col("T").is_nan()).collect().height
        print(f"{rows} rows a group, statistics {statistics}: DuckDB (NaN, maximum, above 25) by file {file}, by table {copy};")
        print(f"    Arrow (by filters, by table) broken {arrow[0]}, NaN {arrow[1]}; polars, NaN {lazy}")
        assert copy == ["2", "nan", "3"] and lazy == 2
        found[rows, statistics] = file, arrow
for (rows, statistics), (file, arrow) in found.items():
    if not statistics:
        assert file == ["2", "nan", "3"] and arrow == [(2, 2), (2, 2)]
    else:
        assert file == ["0", "26.0", {8: "3", 4: "2", 2: "1"}[rows]] and arrow[0] == (0, 2)
pl.DataFrame(table).write_parquet("polars.parquet")
print("by polars:", asked("'polars.parquet'"))
assert asked("'polars.parquet'")[0] == "0"
EOF
