#!/usr/bin/env bash
# filterpy's log-likelihood of a reading that is missing is that of one which was forecast exactly.
#
# Versions: filterpy 2.0.0 (1.4.5 the same)
# A good guess: after update(None), its way to say that a reading is missing, log_likelihood is 0 or undefined, so that sums
# over a record compare models by the readings that there are
# Seen: it is the density at a residual of 0: larger than that of most readings. A record that lost two thirds of its values
# is more likely than the same record whole
# Why it matters: noise levels and models chosen by likelihood on records with gaps are chosen by the gaps
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile filterpy==2.0.0 numpy==2.4.6 scipy
"$work/venv/bin/python" -W ignore - <<'PY'
import numpy as np
from filterpy.kalman import KalmanFilter


def log_likelihoods(readings):
    room = KalmanFilter(1, 1)
    room.x[:], room.F[:], room.H[:] = 20.0, 1.0, 1.0
    room.R *= 0.01
    room.Q *= 0.001
    found = []
    for reading in readings:
        room.predict()
        room.update(reading)
        found.append(room.log_likelihood)
    return np.array(found)


noise = np.random.default_rng(0)
readings = [20 + noise.normal(0, 0.1) for _ in range(300)]
lost = [reading if k % 3 == 0 else None for k, reading in enumerate(readings)]
all_there, gappy = log_likelihoods(readings), log_likelihoods(lost)
missing = np.array([reading is None for reading in lost])
print("a reading:", round(float(np.median(all_there)), 2), "a missing one:", round(float(np.median(gappy[missing])), 2))
print("sum over the record:", round(float(all_there.sum())), "with two thirds missing:", round(float(gappy.sum())))
assert np.median(gappy[missing]) > np.median(all_there)
assert gappy.sum() > all_there.sum() + 30
PY
