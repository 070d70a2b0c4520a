#!/usr/bin/env bash
# pygfunction's load aggregation does not read the time of a step: hours that are left out never were.
#
# Versions: pygfunction 2.3.1
# A good guess: `next_time_step(time)` takes the time that it is given: steps that are left out are hours without load, or it
# raises; `initialize` begins anew
# Seen: each call is one step of `dt`, whatever the time: three hours of heat, four left out, three again give the temperatures
# of six hours in a row (1.47 K where 0.90 K is right); quarter hours count as hours (0.57 K is 1.47 K); and a second
# `initialize` keeps the loads of before
# Why it matters: a borehole beside a controller whose record has a gap, or whose step changes, is wrong by half and says nothing
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pygfunction==2.3.1
"$work/venv/bin/python" -W ignore - <<'EOF'
import math

import numpy as np
import pygfunction as gt

HOUR = 3600.0
borehole = gt.boreholes.Borehole(100.0, 4.0, 0.075, 0.0, 0.0)


def factors(aggregation):
    g = gt.gfunction.gFunction(borehole, 1e-6, time=aggregation.get_times_for_simulation(), options={"nSegments": 8})
    return g.gFunc / (2.0 * math.pi * 2.0)


def started():
    aggregation = gt.load_aggregation.ClaessonJaved(HOUR, 20 * 8760 * HOUR)
    aggregation.initialize(factors(aggregation))
    return aggregation


def rises(aggregation, times_h, loads_W_m):
    found = []
    for time_h, load in zip(times_h, loads_W_m):
        aggregation.next_time_step(time_h * HOUR)
        aggregation.set_current_load(load)
        found.append(float(np.squeeze(aggregation.temporal_superposition())))
    return np.array(found)


in_a_row = rises(started(), range(1, 7), [20.0] * 6)
idle = rises(started(), range(1, 11), [20.0] * 3 + [0.0] * 4 + [20.0] * 3)
left_out = rises(started(), (1, 2, 3, 8, 9, 10), [20.0] * 6)
print("six hours in a row      ", in_a_row.round(3))
print("hours 4 to 7 without load", idle[[0, 1, 2, 7, 8, 9]].round(3))
print("hours 4 to 7 left out    ", left_out.round(3))
assert np.array_equal(left_out, in_a_row)
assert idle[7] < 0.65 * left_out[3]
quarters = rises(started(), [k / 4 for k in range(1, 5)], [20.0] * 4)
print(f"one hour: {in_a_row[0]:.3f} K; in four quarters: {quarters[-1]:.3f} K")
assert quarters[-1] > 2.0 * in_a_row[0]
again = started()
rises(again, range(1, 7), [20.0] * 6)
again.initialize(factors(again))
first = rises(again, [1], [20.0])[0]
print(f"first hour after a second initialize: {first:.3f} K")
assert first > 2.0 * in_a_row[0]
EOF
