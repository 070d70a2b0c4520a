#!/usr/bin/env bash
# Dask's 99 % quantile of a machine's power is 0 W where pandas' is 2.7 kW, since the machine ran on the last day only.
#
# Versions: dask 2026.8.0, pandas 3.1.1
# A good guess: quantiles of a partitioned table are approximate: off by some percent, or by one reading
# Seen: two weeks of hours, in two partitions or seven, of a machine that ran in the last 36 hours: the 90, 95 and 99 % quantiles
# are 0 W instead of 129, 1564 and 2713; in one partition they are right, and of the same readings in mixed order 99 % is 2829 W
# Why it matters: the full power of a machine is taken from such a quantile, a season begins with its first run, and tables in the
# order of time are how records are stored
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile "dask[dataframe]==2026.8.0" pandas==3.1.1
"$work/venv/bin/python" -W error::UserWarning - <<'EOF'
import dask.dataframe as dd
import numpy as np
import pandas as pd

hours = pd.date_range("2025-10-01", periods=14 * 24, freq="h", tz="UTC")
power_W = pd.Series(np.concatenate([np.zeros(300), np.linspace(0.0, 3000.0, 36)]), index=hours)
for share in (0.5, 0.9, 0.95, 0.99):
    exact, by_dask = power_W.quantile(share), [dd.from_pandas(power_W, npartitions=n).quantile(share).compute() for n in (1, 2, 7)]
    print(f"{share:.0%}: pandas {exact:.0f} W, dask with 1, 2 and 7 partitions", *(f"{one:.0f}" for one in by_dask), "W")
    assert by_dask[2] == 0.0
assert power_W.quantile(0.99) > 2700.0
mixed = power_W.sample(frac=1.0, random_state=0).reset_index(drop=True)
print("in mixed order, 99 %:", round(dd.from_pandas(mixed, npartitions=7).quantile(0.99).compute()), "W")
EOF
