#!/usr/bin/env bash
# suncalc puts the sun of a pandas 3 column in January 1970: it takes every stamp for nanoseconds.
#
# Versions: suncalc 0.1.3, pandas 3.1.1
# A good guess: a column of times gives the positions that its times give one by one
# Seen: on 21 June at noon in Brussels the sun stands 62.4° high, asked alone or with stamps in nanoseconds, and 8.6° with those
# in microseconds, which pandas 3 makes of text; -61° in milliseconds; no error
# Why it matters: solar gains, shading and PV of a whole table are of another season and hour, by night in the one that is asked,
# and values are smooth and plausible enough to pass
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile suncalc==0.1.3 pandas==3.1.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import numpy as np
import pandas as pd
import suncalc

times = pd.Series(pd.to_datetime(["2026-06-21 12:00", "2026-12-21 09:00"]))
alone = [np.degrees(suncalc.get_position(time.to_pydatetime(), 4.35, 50.85)["altitude"]) for time in times]
found = {
    unit: np.degrees(np.asarray(suncalc.get_position(times.dt.as_unit(unit), 4.35, 50.85)["altitude"]))
    for unit in ("ns", "us", "ms")
}
print("pandas makes", times.dtype, "| one by one", np.round(alone, 1), {unit: list(np.round(v, 1)) for unit, v in found.items()})
assert times.dtype == "datetime64[us]"
assert np.allclose(found["ns"], alone) and abs(found["us"] - alone).min() > 30 and abs(found["ms"] - alone).min() > 60
PY
