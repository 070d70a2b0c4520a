#!/usr/bin/env bash
# LightGBM takes monotone_constraints together with linear_tree and returns a model that falls where it was told to rise.
#
# Versions: lightgbm 4.7.0
# A good guess: the pair is refused, as XGBoost refuses multi-output trees with constraints, or the constraint holds
# Seen: training runs without a warning (at the default verbosity too); of 2,000 small steps upwards in the constrained
# input over 1,500 lower the prediction; without linear_tree none does
# Why it matters: a model of heat by control that is believed monotone is not: a controller may find that less heating
# warms; such a constraint is to be checked on the trained model
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile lightgbm==4.7.0 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" -W ignore - <<'EOF'
import contextlib
import io

import lightgbm as lgb
import numpy as np

rng = np.random.default_rng(0)
X = rng.uniform(-1, 1, (2000, 2))
y = np.sin(4 * X[:, 0]) + X[:, 1] * X[:, 0] + 0.1 * rng.normal(size=2000)
x = np.linspace(-1, 1, 2001)


def falls(linear):
    options = {"objective": "l2", "linear_tree": linear, "monotone_constraints": [1, 0], "num_threads": 1, "verbose": -1}
    model = lgb.train(options, lgb.Dataset(X, y), 50)
    return sum(int((np.diff(model.predict(np.c_[x, np.full_like(x, level)])) < -1e-9).sum()) for level in (-0.9, 0.0, 0.9))


plain, linear = falls(False), falls(True)
print("steps that fall, of 6000: constant leaves", plain, "linear leaves", linear)
assert plain == 0 and linear > 3000
EOF
