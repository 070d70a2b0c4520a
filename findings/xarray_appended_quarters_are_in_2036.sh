#!/usr/bin/env bash
# xarray appends quarter hours to a Zarr store that began with days, and reads them back eleven years later.
#
# Versions: xarray 2026.9.0, zarr 3.1.6, pandas 3.0.6
# A good guess: `to_zarr(append_dim="time")` keeps times as they are, or refuses what the unit of the store cannot hold
# Seen: a store that begins with three daily times has the unit "days since"; four quarter hours of 4 January 2025 appended to
# it come back as days in October to December 2036. A warning says that minutes are used instead, which is what happens to the
# numbers; the unit in the store stays. `to_netcdf` of all at once is right
# Why it matters: a store of readings that starts coarse (a first day, hourly weather) and goes on in quarter hours has its
# newest values years ahead, in a place where no plot looks
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile xarray==2026.9.0 zarr==3.1.6 pandas==3.0.6 numpy==2.4.6
cd "$work"
"$work/venv/bin/python" -W ignore - <<'EOF'
import pandas as pd
import xarray as xr


def readings(begin, count, step):
    times = pd.date_range(begin, periods=count, freq=step)
    return xr.Dataset({"T": ("time", [20.0] * count)}, {"time": times})


readings("2025-01-01", 3, "D").to_zarr("store")
readings("2025-01-04", 4, "15min").to_zarr("store", append_dim="time")
times = pd.DatetimeIndex(xr.open_zarr("store")["time"].values)
print("appended: 2025-01-04 00:00 to 00:45; read:", ", ".join(f"{time:%Y-%m-%d}" for time in times[3:]))
assert [time.year for time in times] == [2025] * 3 + [2036] * 4
EOF
