#!/usr/bin/env bash
# xarray's interp of a series with stamps in seconds or microseconds, at stamps in nanoseconds, is NaN.
#
# Versions: xarray 2026.9.0, pandas 3.1.1, scipy 1.17.1
# A good guess: hourly weather at quarter hours is interpolated, whatever unit either index has; other operations take any unit
# Seen: NaN but for the first stamp, without a word. The same stamps in one unit are right, and reindex, polyfit, integrate and
# differentiate are right in all. curvefit's slope is per unit of the stamps: 1000 times larger in microseconds than in nanoseconds
# Why it matters: pandas 3 makes microseconds, a netCDF file is read in nanoseconds: where a forecast of one meets the clock of the
# other, weather is missing, or a trend found in one table is of no use in another
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile xarray==2026.9.0 pandas==3.1.1 scipy==1.17.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import numpy as np
import pandas as pd
import xarray as xr

quarters = pd.date_range("2025-01-01", "2025-01-02", freq="15min").as_unit("ns").values
missing, slopes = {}, {}
for unit in ("s", "us", "ns"):
    hours = pd.date_range("2025-01-01", periods=48, freq="h").as_unit(unit).values
    series = xr.DataArray(np.arange(48.0), coords={"time": hours}, dims="time")
    missing[unit] = int(series.interp(time=quarters).isnull().sum())
    assert int(series.interp(time=quarters.astype(f"M8[{unit}]")).isnull().sum()) == 0
    assert int(series.reindex(time=quarters, method="nearest").isnull().sum()) == 0
    assert np.allclose(series.differentiate("time", datetime_unit="h"), 1.0)
    line = series.curvefit("time", lambda t, slope, offset: slope * t + offset)
    slopes[unit] = float(line.curvefit_coefficients[0])
    print(f"stamps in {unit}: {missing[unit]} of {len(quarters)} quarter hours missing, curvefit's slope {slopes[unit]:.3g}")
assert missing == {"s": 96, "us": 96, "ns": 0}
assert np.isclose(slopes["us"], 1000 * slopes["ns"], rtol=1e-3) and np.isclose(slopes["s"], 1e9 * slopes["ns"], rtol=1e-3)
PY
