#!/usr/bin/env bash
# agentlib_mpc's mean over an interval: of a day of quarter hours the first hour is its first quarter, the last the hour before.
#
# Versions: agentlib-mpc 1.1.1, agentlib 0.9.0
# A good guess: `sample(..., method="mean_over_interval")`, for data finer than the grid, gives 24 means of quarter-hour prices that
# begin at the current time, as forecasts do; its notes tell only that the last value stands twice
# Seen: 22 of 24 are right. The first is the price of the first quarter (points at the very begin of the data count as missing and
# get their first value), and that of 23:00 is the mean of 22:00 to 23:00, though its own four quarters are there. With data that
# begin an hour before and end six hours later the first is right and the last still that of the hour before
# Why it matters: the first hour is the one that an MPC acts on. On a day whose 00:00 costs 40 and the rest of the hour 120 it heats
# at 40, at every start of a plan anew, and the end of the horizon carries the price of another hour
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile agentlib-mpc==1.1.1 agentlib==0.9.0
"$work/venv/bin/python" -W ignore - <<'PY'
import pandas as pd
from agentlib_mpc.utils.sampling import sample

HOURS = [3600.0 * hour for hour in range(24)]


def compared(begin, quarters):
    """Means of 24 hours by agentlib_mpc and by pandas, of prices from `begin`, s, on."""
    times = [begin + 900.0 * step for step in range(quarters)]
    prices = pd.Series([40.0 if step % 4 == 0 else 120.0 + step for step in range(quarters)], index=times)
    means = prices.groupby(prices.index // 3600.0).mean()
    return [float(value) for value in sample(prices, HOURS, 0.0, "mean_over_interval")], [means[hour] for hour in range(24)]


found, means = compared(0.0, 96)
print(f"from now on: 00:00 {found[0]:g}, by pandas {means[0]:g}; 23:00 {found[-1]:g}, by pandas {means[-1]:g}")
assert found[1:-1] == means[1:-1]
assert found[0] == 40.0 and means[0] > 100.0
assert found[-1] == means[-2] < means[-1]
found, means = compared(-3600.0, 124)
print(f"more on both sides: 00:00 {found[0]:g}, by pandas {means[0]:g}; 23:00 {found[-1]:g}, by pandas {means[-1]:g}")
assert found[:-1] == means[:-1]
assert found[-1] == means[-2] < means[-1]
PY
