#!/usr/bin/env bash
# temporian with NumPy 2, as pip installs it: moving sums, means, cumulative sums and resampling are the last value everywhere.
#
# Versions: temporian 0.9.0, numpy 2.4.6, pandas 3.1.1 (by pip alone); numpy 1.26.4, pandas 2.3.3 (right)
# A good guess: a package that installs and imports with a NumPy computes with it what it computes with another one
# Seen: with NumPy 1.26 a moving sum over two hours of 1, 2, 3, 4 is 1, 3, 5, 7; with NumPy 2 it is 7, 7, 7, 7, and a
# cumulative sum 10, 10, 10, 10. Nothing is raised or warned of; times, arithmetic and calendar features are right
# Why it matters: features of past hours, made for a forecast of load or temperature, hold the end of the record in every
# row: a model trained on them has seen the future, scores well where it is tested, and is blind where it runs
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cat > "$work/sums.py" <<'PY'
import json

import numpy
import pandas as pd
import temporian as tp

hours = pd.date_range("2026-01-01", periods=4, freq="h")
readings = tp.from_pandas(pd.DataFrame({"timestamp": hours, "load": [1.0, 2.0, 3.0, 4.0]}))
later = tp.from_pandas(pd.DataFrame({"timestamp": hours + pd.Timedelta("20min"), "load": 0.0}))
two_hours = tp.duration.hours(2)


def column(events):
    return tp.to_pandas(events)["load"].tolist()


found = {
    "moving_sum": column(readings.moving_sum(two_hours)),
    "simple_moving_average": column(readings.simple_moving_average(two_hours)),
    "cumsum": column(readings.cumsum()),
    "resample": column(readings.resample(later)),
    "twice": column(readings * 2.0),
}
print(json.dumps([numpy.__version__, found]))
PY
for numbers in "numpy==1.26.4 pandas==2.3.3" "numpy==2.4.6 pandas==3.1.1"; do
    venv=$work/venv-${numbers//[^0-9]/}
    python3 -m venv "$venv"
    # shellcheck disable=SC2086
    "$venv/bin/pip" install -q --no-compile temporian==0.9.0 $numbers
    "$venv/bin/python" -W ignore "$work/sums.py" | tee -a "$work/found.txt"
done
python3 - "$work/found.txt" <<'PY'
import json
import sys

(_, before), (_, by_default) = map(json.loads, open(sys.argv[1]))
assert before == {
    "moving_sum": [1, 3, 5, 7], "simple_moving_average": [1, 1.5, 2.5, 3.5], "cumsum": [1, 3, 6, 10],
    "resample": [1, 2, 3, 4], "twice": [2, 4, 6, 8],
}
assert by_default == before | {
    "moving_sum": [7] * 4, "simple_moving_average": [3.5] * 4, "cumsum": [10] * 4, "resample": [4] * 4,
}
PY
