#!/usr/bin/env bash
# pandas' std of float32 readings is 25 % too large as soon as the package bottleneck is installed, also as somebody else's dependency.
#
# Versions: pandas 3.1.1, bottleneck 1.6.0, numpy 2.4.6
# A good guess: installing another package changes no result of pandas beyond the last digits
# Seen: a year of minutes at 21.3 degC with a scatter of 0.050 K has a standard deviation of 0.0624 K with bottleneck
# (used by default where it is importable; linopy brings it), 0.0501 K without; a constant series has 0.015 K instead of
# 0
# Why it matters: noise of a sensor, thresholds of stuck sensors and forecast bands change with what else is in the
# environment; float32 is what Parquet files and loggers hold
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pandas==3.1.1 numpy==2.4.6 bottleneck==1.6.0
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
import pandas as pd

rng = np.random.default_rng(0)
year = pd.Series((21.3 + 0.05 * rng.normal(size=525_600)).astype(np.float32))
still = pd.Series(np.full(525_600, 21.3, dtype=np.float32))
assert pd.get_option("compute.use_bottleneck")
with_it = year.std(), still.std()
pd.set_option("compute.use_bottleneck", False)
without = year.std(), still.std()
print("with bottleneck", with_it, "without", without)
assert with_it[0] > 1.2 * without[0] and with_it[1] > 0.01 and without[1] == 0
EOF
