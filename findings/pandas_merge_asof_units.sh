#!/usr/bin/env bash
# pandas 3 will not join two tables by time where one was read from CSV and the other has stamps in seconds.
#
# Versions: pandas 3.0.6
# A good guess: units of stamps are an inner matter: `merge_asof` of stamps read from a CSV file (microseconds), of Unix
# seconds and of older Parquet or numpy (nanoseconds) works as `merge`, `concat` and `reindex` do
# Seen: `merge` and `reindex(method="nearest")` join them, `merge_asof` raises "incompatible merge keys ... must be the same
# type"; `as_unit` on one side makes it work
# Why it matters: the usual join of readings with prices by time works in tests, where both are made alike, and stops with
# the first file of another origin
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pandas==3.0.6 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import io

import pandas as pd

readings = pd.read_csv(io.StringIO("t,T\n2025-01-01 00:00,20.5\n2025-01-01 01:00,21\n"), parse_dates=["t"])
prices = pd.DataFrame({"t": pd.to_datetime([1735689600, 1735693200], unit="s"), "price": [0.2, 0.3]})
print(readings["t"].dtype, prices["t"].dtype)
assert readings.merge(prices, on="t")["price"].tolist() == [0.2, 0.3]
assert readings.set_index("t").reindex(prices["t"], method="nearest")["T"].tolist() == [20.5, 21.0]
try:
    pd.merge_asof(readings, prices, on="t")
except pd.errors.MergeError as error:
    print(error)
else:
    raise SystemExit("merge_asof joins them now")
prices["t"] = prices["t"].dt.as_unit(readings["t"].dt.unit)
assert pd.merge_asof(readings, prices, on="t")["price"].tolist() == [0.2, 0.3]
EOF
