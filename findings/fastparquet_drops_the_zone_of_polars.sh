#!/usr/bin/env bash
# A column of local time written by polars is read by fastparquet without its zone, in UTC.
#
# Versions: polars 2.1.0, fastparquet 2026.9.0, pyarrow 26.0.1, pandas 3.1.1
# A good guess: the zone is kept, or lost with a warning: pandas with pyarrow keeps it, and fastparquet keeps the zone
# of files that pandas wrote
# Seen: a naive datetime64 column with UTC's hours: 00:00 in Brussels reads as 23:00 of the day before
# Why it matters: schedules, prices and comfort bands are an hour or two off, by season, and every reading looks
# plausible
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile polars==2.1.0 fastparquet==2026.9.0 pyarrow==26.0.1 pandas==3.1.1 numpy==2.4.6 tzdata==2026.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import datetime
import tempfile
from pathlib import Path

import fastparquet
import pandas as pd
import polars as pl

folder = Path(tempfile.mkdtemp())
stamps = pl.Series("time", [datetime.datetime(2025, 1, 1), datetime.datetime(2025, 7, 1)]).dt.replace_time_zone("Europe/Brussels")
pl.DataFrame({"time": stamps, "T": [21.0, 22.0]}).write_parquet(folder / "polars.parquet")
pd.read_parquet(folder / "polars.parquet", engine="pyarrow").to_parquet(folder / "pandas.parquet", engine="pyarrow")
arrow = pd.read_parquet(folder / "polars.parquet", engine="pyarrow")["time"]
fast = fastparquet.ParquetFile(str(folder / "polars.parquet")).to_pandas()["time"]
of_pandas = fastparquet.ParquetFile(str(folder / "pandas.parquet")).to_pandas()["time"]
print("pyarrow:", arrow.tolist(), "\nfastparquet:", fast.tolist(), "\nfastparquet, file of pandas:", of_pandas.tolist())
assert str(arrow.dt.tz) == "Europe/Brussels" and arrow[0].hour == 0
assert fast.dt.tz is None and fast[0] == pd.Timestamp("2024-12-31 23:00") and fast[1] == pd.Timestamp("2025-06-30 22:00")
assert of_pandas.dt.tz is not None
EOF
