#!/usr/bin/env bash
# ht's mean temperature difference of a counterflow exchanger whose ends cross is that of its hot end.
#
# Versions: ht 1.2.0
# A good guess: temperatures that no exchanger can have (hot water that comes out colder than the cold water comes in) raise, or give
# NaN, as its efficiency formulas raise; and where one end has no difference left the mean goes to 0
# Seen: heating water from 60 to 40 °C against 45 to 50 °C has 10 K, as if it were an exchanger with 10 K throughout; so has one whose
# cold end has exactly 0 K, while 0.001 K there gives 1.1 K; crossed at the hot end the mean is -5 K. In co-current flow a crossing
# has 0 K
# Why it matters: readings of a station that stands, or of swapped sensors, are such temperatures: a heat transfer coefficient learned of
# them, kW per K, is finite, plausible and wrong
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile ht==1.2.0
"$work/venv/bin/python" - <<'EOF'
from ht import LMTD

for words, temperatures, seen in (
    ("as it may be", (60.0, 48.0, 45.0, 50.0), 5.81),
    ("the cold end has 0.001 K", (60.0, 45.001, 45.0, 50.0), 1.09),
    ("the cold end has 0 K", (60.0, 45.0, 45.0, 50.0), 10.0),
    ("the cold end is crossed by 5 K", (60.0, 40.0, 45.0, 50.0), 10.0),
    ("the hot end is crossed by 5 K", (45.0, 55.0, 45.0, 50.0), -5.0),
):
    mean = LMTD(*temperatures)
    print(f"{words}: {temperatures}: {mean:.2f} K")
    assert abs(mean - seen) < 0.01, mean
crossed = LMTD(60.0, 40.0, 50.0, 55.0, counterflow=False)
print(f"co-current, crossed at its end: {crossed} K")
assert crossed == 0.0
EOF
