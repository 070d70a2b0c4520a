#!/usr/bin/env bash
# One query of DuckDB over one column with a gap: from pandas the gap is missing, from polars it is the hottest hour.
#
# Versions: duckdb 2.0.1, pandas 3.1.1, polars 2.1.0, pyarrow 26.0.1
# A good guess: the same numbers give the same answers, whichever library holds them
# Seen: NaN of a pandas frame, of a dict of NumPy arrays and of a Parquet file by pandas is NULL: mean 21, maximum 22, one hour
# above 21. NaN of a polars frame, of an Arrow table and of a Parquet file by polars stays a number, above all others: mean and
# maximum NaN, two hours above 21
# Why it matters: hours above a limit are counted from whatever the measurements came in; that the gap of a sensor is an hour
# of overheating depends on the library that wrote the file
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile duckdb==2.0.1 pandas==3.1.1 polars==2.1.0 pyarrow==26.0.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - "$work" <<'EOF'
import sys

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa

room = [20.0, float("nan"), 22.0]
by_pandas, by_polars = pd.DataFrame({"T": room}), pl.DataFrame({"T": room})
by_arrow, by_numpy = pa.table({"T": room}), {"T": np.array(room)}
by_pandas.to_parquet(f"{sys.argv[1]}/pandas.parquet")
by_polars.write_parquet(f"{sys.argv[1]}/polars.parquet")
hours = {}
for where in ("by_pandas", "by_numpy", f"'{sys.argv[1]}/pandas.parquet'", "by_polars", "by_arrow", f"'{sys.argv[1]}/polars.parquet'"):
    mean, most, above = duckdb.sql(f"SELECT avg(T), max(T), count(*) FILTER (T > 21) FROM {where}").fetchall()[0]
    hours[where.split("/")[-1].strip("'")] = (mean, most, above)
    print(f"{where.split('/')[-1]:>20}: mean {mean}, most {most}, hours above 21 °C: {above}")
same = {name: above for name, (_, _, above) in hours.items()}
assert same == {"by_pandas": 1, "by_numpy": 1, "pandas.parquet": 1, "by_polars": 2, "by_arrow": 2, "polars.parquet": 2}
assert hours["by_pandas"][:2] == (21.0, 22.0) and np.isnan(hours["by_polars"][:2]).all()
EOF
