#!/usr/bin/env bash
# linopy leaves out the constraint whose right-hand side is NaN and the term whose factor is NaN, and reports ok.
#
# Versions: linopy 0.10.1, highspy 1.16.0, xarray 2026.9.0
# A good guess: a NaN in the data of a constraint is an error
# Seen: x >= [1, NaN, 2] solves as ok with x = [1, 0, 2]; a right-hand side whose index lacks the first hour leaves that
# hour free; a NaN factor in a sum counts as 0
# Why it matters: one missing hour in a series of minimum temperatures or capacities, or an index that is an hour off,
# takes the limit away for that hour; the status says ok
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile linopy==0.10.1 highspy==1.16.0 xarray==2026.9.0 pandas==3.1.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
import linopy
import pandas as pd
import xarray as xr

hours = pd.RangeIndex(3, name="hour")


def solve(state):
    model = linopy.Model()
    x = model.add_variables(lower=0, upper=10, coords=[hours], name="x")
    model.add_constraints(state(x), name="demand")
    model.add_objective(x.sum())
    status, _ = model.solve("highs", io_api="direct", output_flag=False, progress=False)
    return status, x.solution.values.tolist()


gap = solve(lambda x: x >= pd.Series([1, np.nan, 2.0], index=hours))
late = solve(lambda x: x >= xr.DataArray([1.0, 2.0], coords={"hour": [1, 2]}))
factor = solve(lambda x: (x * pd.Series([1, np.nan, 2.0], index=hours)).sum() >= 10)
print("NaN as right-hand side:", gap, "\nindex without the first hour:", late, "\nNaN as factor:", factor)
assert gap == ("ok", [1, 0, 2]) and late == ("ok", [0, 1, 2]) and factor == ("ok", [0, 0, 5])
EOF
