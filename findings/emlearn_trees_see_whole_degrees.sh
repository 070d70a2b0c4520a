#!/usr/bin/env bash
# emlearn's C code of a decision tree knows whole degrees only: a rule "below 20.9 °C heat" becomes "below 20 °C".
#
# Versions: emlearn 0.23.2, scikit-learn 1.9.1
# A good guess: `emlearn.convert(tree)` on a model that was fitted on floats predicts what scikit-learn predicts, within rounding, or says
# what scale the features must have; its neighbours, GaussianMixture and EllipticEnvelope, keep floats
# Seen: the default feature of trees is int16_t, thresholds and readings are cut to whole numbers, and nothing is said. Of rules that
# heat below 20.2, 20.5 and 20.9 °C all three become one that heats below 20; with dtype="float" each is right
# Why it matters: a rule or a fault detector that was tried in Python goes into a thermostat or valve with another set-point, up to one
# kelvin colder, and the Python side of a converted model is the only place where it can be seen before
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile emlearn==0.23.2 scikit-learn==1.9.1 numpy==2.4.6
cd "$work"  # where the C code is built
"$work/venv/bin/python" - <<'EOF'
import warnings

import emlearn
import numpy as np
from sklearn.tree import DecisionTreeRegressor

warnings.simplefilter("error", UserWarning)
ROOM = np.arange(180, 241)[:, None] / 10  # °C, in tenths


def heated_below(predicted):
    """The coldest room that is not heated, °C."""
    return ROOM[np.ravel(predicted) < 500][0, 0]


for limit in (20.2, 20.5, 20.9):
    heat = np.where(ROOM[:, 0] < limit, 1000.0, 0.0)  # W
    tree = DecisionTreeRegressor(max_depth=1).fit(ROOM, heat)
    limits = [heated_below(tree.predict(ROOM))]
    limits += [heated_below(emlearn.convert(tree, **told).predict(ROOM)) for told in ({}, {"dtype": "float"})]
    print("heats below: scikit-learn {}, emlearn {}, with dtype='float' {} °C".format(*limits))
    assert limits == [limit, 20.0, limit]
EOF
