#!/usr/bin/env bash
# One bad reading of 3.4e38 makes all later moving means of bottleneck, SciPy, river and coreforecast wrong.
#
# Versions: bottleneck 1.6.0, scipy 1.17.1, river 0.26.1, coreforecast 0.0.20; pandas 3.1.1, polars 2.1.0
# A good guess: once the reading has left the window the mean of four readings near 21 is near 21 again
# Seen: 0 for ever in bottleneck's move_mean, SciPy's uniform_filter1d and coreforecast's rolling_mean, and no temperature at all in
# river's rolling mean: they keep a running sum, to which the reading is added and from which it is taken away again. pandas and
# polars are right. With 1e10, which is no rarer, bottleneck's standard deviation is 48 K where it is 0.07 K
# Why it matters: a device that loses its sensor sends the largest float; after it every smoothed temperature is 0 °C, heat is called
# for at full power, and no value is missing that an alarm would see
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile bottleneck==1.6.0 scipy==1.17.1 river==0.26.1 coreforecast==0.0.20 pandas==3.1.1 \
  polars==2.1.0 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import bottleneck
import numpy as np
import pandas as pd
import polars as pl
from coreforecast.rolling import rolling_mean
from river import stats, utils
from scipy.ndimage import uniform_filter1d

CLEAN = 21.0 + 0.1 * np.sin(np.arange(400))


def by_river(values):
    mean, means = utils.Rolling(stats.Mean(), 4), []
    for value in values:
        mean.update(value)
        means.append(mean.get())
    return np.array(means)


MEANS = {
    "pandas": lambda y: pd.Series(y).rolling(4).mean().to_numpy(),
    "polars": lambda y: pl.Series(y).rolling_mean(4).to_numpy(),
    "bottleneck": lambda y: bottleneck.move_mean(y, 4),
    "scipy": lambda y: uniform_filter1d(y, 4, origin=1),
    "coreforecast": lambda y: rolling_mean(y, 4),
    "river": by_river,
}


def with_spike(value):
    readings = CLEAN.copy()
    readings[50] = value
    return readings


last = {name: mean(with_spike(3.4e38))[-1] for name, mean in MEANS.items()}
for name, value in last.items():
    print(f"{name}: mean of the last four, 346 readings after the spike: {value:.4g}")
right = CLEAN[-4:].mean()
for mean in MEANS.values():
    assert abs(mean(CLEAN)[-1] - right) < 1e-9
assert abs(last["pandas"] - right) < 1e-9 and abs(last["polars"] - right) < 1e-9
assert all(abs(last[name]) < 1.0 for name in ("bottleneck", "scipy", "coreforecast")) and abs(last["river"] - right) > 1.0
spread = bottleneck.move_std(with_spike(1e10), 8, ddof=1)[100]
print(f"bottleneck: standard deviation after a spike of 1e10: {spread:.3g} K, without it {CLEAN[93:101].std(ddof=1):.3g} K")
assert spread > 10 * CLEAN[93:101].std(ddof=1)
PY
