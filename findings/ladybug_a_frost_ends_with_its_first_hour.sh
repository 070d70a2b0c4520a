#!/usr/bin/env bash
# ladybug's quarter hours of two days: in the last three the outdoor temperature goes back to that of the first hour, 18 K away.
#
# Versions: ladybug-core 0.44.62
# A good guess: interpolate_to_timestep of 48 hours goes straight between hours and holds or ends at the last; of heat in kWh the sum
# is kept
# Seen: the period counts as a circle also where it is no year. From 10 degC falling to -8 degC at 23:00 it is -3.5, 1.0 and 5.5 degC
# at 23:15, 23:30 and 23:45. Energy is taken half an hour later and what falls out behind comes in before: of 12 kWh in the last
# hour and none before, 2.25 kWh are counted at 00:00 and 00:15 two days earlier. The sum is kept
# Why it matters: design days, winter weeks and parts of a record are cut from years before they are made finer: the coldest hours
# end in a thaw, and peaks of a heat load stand on another day
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile ladybug-core==0.44.62
"$work/venv/bin/python" -W ignore - <<'PY'
from ladybug.analysisperiod import AnalysisPeriod
from ladybug.datacollection import HourlyContinuousCollection
from ladybug.datatype.energy import Energy
from ladybug.datatype.temperature import Temperature
from ladybug.header import Header

DAYS = AnalysisPeriod(1, 10, 0, 1, 11, 23)


def quarters(kind, unit, values):
    return HourlyContinuousCollection(Header(kind, unit, DAYS), values).interpolate_to_timestep(4)


falling = [10.0 - 18.0 * hour / 47.0 for hour in range(48)]
outdoors = quarters(Temperature(), "C", falling).values
print("outdoors from 23:00 on, degC:", *(round(value, 2) for value in outdoors[-4:]))
assert [round(value, 6) for value in outdoors[-4:]] == [-8.0, -3.5, 1.0, 5.5]
assert abs(outdoors[1] - (10.0 - 18.0 / 47.0 / 4.0)) < 1e-9
heat = quarters(Energy(), "kWh", [0.0] * 47 + [12.0])
print("heat, kWh: in all", heat.total, "first two quarters", *heat.values[:2], "last six", *heat.values[-6:])
assert heat.total == 12.0 and heat.values[:3] == (1.5, 0.75, 0.0)
PY
