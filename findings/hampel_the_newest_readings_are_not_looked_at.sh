#!/usr/bin/env bash
# hampel never finds a spike in the newest readings, nor one that has a lost reading beside it.
#
# Versions: hampel 1.0.2, pandas 3.1.1
# A good guess: at both ends the window is what there is of it, and a missing value is left out of it: 85 °C in a room of 21 °C is an
# outlier wherever it stands
# Seen: by default (a window of 5) the first and the last two readings are passed through whatever they are, with a window of 11 five at
# each end; and a spike within two readings of a NaN stays, since the median of the window is NaN. Nothing is said
# Why it matters: a controller acts on the newest reading, which is the one that is never cleaned; and a sensor that is failing gives spikes
# and gaps side by side (85 °C is what a DS18B20 says after a loss of power)
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile hampel==1.0.2 pandas==3.1.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
import pandas as pd
from hampel import hampel

ROOM = 21 + 0.05 * np.sin(np.arange(40.0))


def found(spike, window=5, lost=None):
    readings = pd.Series(ROOM)
    readings[spike] = 85.0
    if lost is not None:
        readings[lost] = np.nan
    return hampel(readings, window_size=window)


for window in (5, 11):
    missed = [k for k in range(40) if k not in found(k, window).outlier_indices]
    print(f"window of {window}: a spike is missed at", missed)
    half = window // 2
    assert missed == [*range(half), *range(40 - half, 40)]
missed = [k for k in range(10, 31) if k != 20 and k not in found(k, lost=20).outlier_indices]
print("reading 20 is lost: a spike is missed at", missed)
assert missed == [18, 19, 21, 22]
assert found(39).filtered_data[39] == 85.0
EOF
