#!/usr/bin/env bash
# k nearest neighbours weighted by their distance are, as ONNX by skl2onnx, weighted alike.
#
# Versions: skl2onnx 1.20.0, scikit-learn 1.9.1, onnxruntime 1.32.0, onnx 1.23.2
# A good guess: KNeighborsRegressor(weights="distance") as ONNX gives what predict gives, to the digits of float32; a row that it has
# seen gives its own value
# Seen: the export gives exactly (3e-6) what weights="uniform" gives, up to 0.9 K elsewhere on a law that spans 3 K, also for rows that
# it was fitted to. Euclidean and Manhattan distances alike; nothing is said
# Why it matters: the load or the price of days like this one is a usual forecast that needs no training; on the gateway it is another
# one than the one that was tried, plausible and flatter
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile skl2onnx==1.20.0 scikit-learn==1.9.1 onnxruntime==1.32.0 onnx==1.23.2 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import numpy as np
import onnxruntime
from skl2onnx import to_onnx
from sklearn.neighbors import KNeighborsRegressor

onnxruntime.set_default_logger_severity(3)
rng = np.random.default_rng(0)
seen, new = (rng.uniform(0, 10, (n, 3)).astype(np.float32) for n in (500, 200))
room = 21 + 0.1 * seen[:, 0] + np.sin(seen[:, 1])
for metric in ("euclidean", "manhattan"):
    near, alike = (KNeighborsRegressor(5, weights=how, metric=metric).fit(seen, room) for how in ("distance", "uniform"))
    session = onnxruntime.InferenceSession(to_onnx(near, seen[:1]).SerializeToString(), providers=["CPUExecutionProvider"])
    for rows, name in ((seen, "seen"), (new, "new")):
        found = session.run(None, {"X": rows})[0].ravel()
        off, from_alike = (np.abs(found - model.predict(rows)).max() for model in (near, alike))
        print(f"{metric}, rows that are {name}: off by {off:.2f} K, from uniform weights by {from_alike:.0e} K")
        assert off > 0.2 and from_alike < 1e-4
PY
