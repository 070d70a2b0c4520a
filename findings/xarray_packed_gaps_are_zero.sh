#!/usr/bin/env bash
# xarray writes a missing temperature into a packed netCDF variable as 0 °C.
#
# Versions: xarray 2026.9.0, netCDF4 1.7.5.1.post1
# A good guess: NaN in a variable packed as int16 with a scale factor is refused, or comes back as NaN
# Seen: with no _FillValue given it is written as the number 0, and read back as add_offset, here 0 °C; xarray warns of the choice
# of a fill value, and goes on. With _FillValue in the encoding, or as float32, it comes back as NaN
# Why it matters: measurements packed to save space have no gaps any more: a lost reading is a room at 0 °C (or at the offset)
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile xarray==2026.9.0 netCDF4==1.7.5.1.post1 pandas==3.1.1 numpy==2.4.6
cd "$work"
"$work/venv/bin/python" - <<'PY'
import warnings

import numpy as np
import xarray as xr

rooms = xr.Dataset({"T": ("time", [20.0, np.nan, 21.0])})
packed = {"dtype": "int16", "scale_factor": 0.1, "add_offset": 0.0}
read = {}
for name, encoding in (("packed", packed), ("with _FillValue", {**packed, "_FillValue": -32768}), ("float32", {"dtype": "float32"})):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rooms.to_netcdf("rooms.nc", encoding={"T": encoding})
    with xr.open_dataset("rooms.nc") as file:
        read[name] = file["T"].values.copy()
    print(f"{name}: {read[name]}, warnings: {[str(w.message)[:90] for w in caught]}")
assert read["packed"][1] == 0.0 and np.isnan(read["with _FillValue"][1]) and np.isnan(read["float32"][1])
PY
