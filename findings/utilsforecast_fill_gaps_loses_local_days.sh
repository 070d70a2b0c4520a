#!/usr/bin/env bash
# utilsforecast's fill_gaps drops every value of a table of local days, and returns their rows at 01:00 and 02:00, empty.
#
# Versions: utilsforecast 0.2.17, pandas 3.1.1
# A good guess: days that begin at local midnight get a row where a day is missing, 17 rows with 16 values; or a zone is refused
# Seen: 17 rows, all of them empty, at 02:00 before the change of clocks and 01:00 after it: days are counted from midnight in
# UTC, and what does not lie on them is left out without a word. Quarter hours are right: 100 on the day of the change
# Why it matters: daily energy of a meter, made ready for a forecast of load or price, is a series of gaps; what follows fills
# them, or learns from nothing
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile utilsforecast==0.2.17 pandas==3.1.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import pandas as pd
from utilsforecast.preprocessing import fill_gaps

ZONE = "Europe/Brussels"


def filled(times, step):
    table = pd.DataFrame({"unique_id": "meter", "ds": times, "y": 1.0})
    return fill_gaps(table, step)


days = filled(pd.date_range("2025-10-20", "2025-11-05", freq="D", tz=ZONE).delete(3), "D")
quarters = filled(pd.date_range("2025-10-26", "2025-10-27", freq="15min", tz=ZONE, inclusive="left").delete(5), "15min")
for name, table in (("days", days), ("quarters", quarters)):
    print(f"{name}: {len(table)} rows, {table['y'].notna().sum()} values, hours {sorted(set(table['ds'].dt.hour))[:4]}")
assert len(days) == 17 and days["y"].notna().sum() == 0 and set(days["ds"].dt.hour) == {1, 2}
assert len(quarters) == 100 and quarters["y"].notna().sum() == 99
PY
