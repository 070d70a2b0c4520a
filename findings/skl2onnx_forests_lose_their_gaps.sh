#!/usr/bin/env bash
# A forest of scikit-learn that knows missing readings is, as ONNX by skl2onnx, another model wherever one is missing.
#
# Versions: skl2onnx 1.20.0, scikit-learn 1.9.1 (1.8.0 the same), onnxruntime 1.32.0, onnx 1.23.2
# A good guess: trees take NaN since scikit-learn 1.3, so the exported model gives what predict gives, or the export is refused
# Seen: where all is measured both agree to seven digits. In each row with a missing reading they differ, by up to 2.5 K of a law
# that spans 5 K: the side to which a split sends what is missing is not exported, of random forests and of single trees. Of
# SimpleImputer(add_indicator=True) the indicators are lost. SimpleImputer alone agrees
# Why it matters: a model of a room is exported in order to run on a gateway, where readings are missing most; a test with
# complete rows passes
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile skl2onnx==1.20.0 scikit-learn==1.9.1 onnxruntime==1.32.0 onnx==1.23.2 numpy==2.4.6
cd "$work"
OMP_NUM_THREADS=1 ORT_DISABLE_TELEMETRY=1 "$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
from onnxruntime import InferenceSession
from skl2onnx import to_onnx
from sklearn.ensemble import RandomForestRegressor
from sklearn.impute import SimpleImputer
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.tree import DecisionTreeRegressor

rng = np.random.default_rng(0)
whole = rng.uniform(-1, 1, (2000, 2)).astype(np.float32)
rooms = 2 * whole[:, 0] + whole[:, 1] ** 2
seen = whole.copy()
seen[rng.random(seen.shape) < 0.2] = np.nan
missing = np.isnan(seen).any(axis=1)


def misses(name, model):
    """Largest difference where all is measured, largest one elsewhere, and the share of rows there that differ."""
    model.fit(seen, rooms)
    graph = to_onnx(model, seen[:1], target_opset=17).SerializeToString()
    session = InferenceSession(graph, providers=["CPUExecutionProvider"])
    off = abs(session.run(None, {"X": seen})[0].ravel() - model.predict(seen))
    found = off[~missing].max(), off[missing].max(), (off[missing] > 1e-3).mean()
    print(f"{name}: off by {found[0]:.1e} where all is measured, by up to {found[1]:.2f} elsewhere, in {found[2]:.0%} of the rows")
    return found


tree = misses("tree", DecisionTreeRegressor(max_depth=6, random_state=0))
forest = misses("forest of 20", RandomForestRegressor(20, max_depth=6, random_state=0, n_jobs=1))
indicator = misses("imputer with indicator", make_pipeline(SimpleImputer(add_indicator=True), Ridge()))
imputer = misses("imputer", make_pipeline(SimpleImputer(), Ridge()))
assert max(tree[0], forest[0], indicator[0], imputer[0]) < 1e-5
assert tree[1] > 1 and forest[1] > 1 and tree[2] > 0.9 and forest[2] > 0.9
assert indicator[1] > 0.02 and imputer[1] < 1e-5
EOF
