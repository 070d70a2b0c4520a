#!/usr/bin/env bash
# pythermalcomfort's SET ends the loop that it is called in at a missing reading: of 24 hours, 9 come back and nothing is said.
#
# Versions: pythermalcomfort 3.8.0, numpy 2.4.6
# A good guess: the index of a missing temperature is missing (NaN), as PMV's and UTCI's is
# Seen: set_tmp and two_nodes_gagge raise StopIteration ("Max iterations exceeded"), in vectors too, where one NaN takes all
# hours with it; Python takes StopIteration for the end of what map, filter or zip go through, so that list(map(...)) is
# shorter than its input, without an error. pmv_ppd_iso gives NaN for that hour alone
# Why it matters: hours of discomfort are counted up to the first gap of the sensor: a house whose sensor fails at 9:00 is
# as comfortable as one that is measured for nine hours
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pythermalcomfort==3.8.0 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
from pythermalcomfort.models import pmv_ppd_iso, set_tmp

hours = np.full(24, 21.0)
hours[9] = np.nan


def of_hour(air):
    return float(set_tmp(tdb=air, tr=21, v=0.1, rh=50, met=1.2, clo=1).set)


one_by_one = list(map(of_hour, hours))
try:
    set_tmp(tdb=hours, tr=21, v=0.1, rh=50, met=1.2, clo=1)
    vector = "answers"
except StopIteration as problem:
    vector = f"StopIteration: {problem}"
pmv = pmv_ppd_iso(tdb=hours, tr=21, vr=0.1, rh=50, met=1.2, clo=1).pmv
print(f"24 hours, one unknown: SET of {len(one_by_one)} hours by map; as a vector {vector}; PMV of {np.isfinite(pmv).sum()}")
assert len(one_by_one) == 9 and vector.startswith("StopIteration") and np.isfinite(pmv).sum() == 23
EOF
