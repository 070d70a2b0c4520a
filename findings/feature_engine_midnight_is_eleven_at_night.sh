#!/usr/bin/env bash
# feature-engine's cyclical hours have a period of 23: midnight and eleven at night are one point, and a Friday is a Monday.
#
# Versions: feature-engine 1.9.4, pandas 3.1.1
# A good guess: CyclicalFeatures of the hour of the day, 0 to 23, has 24 points on the circle, an hour apart; of days of the week, 0 to 6,
# seven
# Seen: without `max_values` the period is the largest value of the data that it was fitted on. 23:00 and 00:00 have the same sine and
# cosine, so have Sunday and Monday; fitted on working days (0 to 4) Friday is Monday and Saturday Tuesday. Nothing is said
# Why it matters: a forecaster of load or temperature cannot tell the last hour of a day from the first, where a night tariff or a
# set-back begins, and one fitted on some weeks has another clock than one fitted on others
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile feature-engine==1.9.4 pandas==3.1.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
import pandas as pd
from feature_engine.creation import CyclicalFeatures


def circle(fitted_on, shown, **settings):
    fitted = CyclicalFeatures(drop_original=True, **settings).fit(pd.DataFrame({"at": fitted_on}))
    return fitted.transform(pd.DataFrame({"at": shown})).to_numpy()


def apart(points, one, other):
    return float(np.linalg.norm(points[one] - points[other]))


day, week = range(24), range(7)
hours = circle(day, day)
print(f"22:00 to 23:00 {apart(hours, 22, 23):.3f}, 23:00 to 00:00 {apart(hours, 23, 0):.3f}")
assert apart(hours, 22, 23) > 0.26 and apart(hours, 23, 0) < 1e-9
days = circle(week, week)
working = circle(range(5), week)
print(f"Sunday to Monday {apart(days, 6, 0):.3f}; fitted on working days Friday to Monday {apart(working, 4, 0):.3f}")
assert max(apart(days, 6, 0), apart(working, 4, 0), apart(working, 5, 1)) < 1e-9
told = circle(day, day, max_values={"at": 24})
print(f"with max_values of 24: 22:00 to 23:00 {apart(told, 22, 23):.3f}, 23:00 to 00:00 {apart(told, 23, 0):.3f}")
assert abs(apart(told, 22, 23) - apart(told, 23, 0)) < 1e-9
EOF
