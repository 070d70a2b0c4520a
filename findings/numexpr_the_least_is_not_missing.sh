#!/usr/bin/env bash
# numexpr's min and max pass over NaN, its sum and prod do not, and its sum of 32-bit counts turns negative.
#
# Versions: numexpr 2.14.2, NumPy 2.4.6
# A good guess: reductions give what NumPy gives: NaN where a reading is missing, and a sum of int32 in 64 bits
# Seen: of 20, 21.5, NaN and 19 °C the least is 19 and the most 21.5, at any place of the NaN; the sum is NaN. 2,000,000,000 +
# 1,000,000,000 Wh in int32 are -1,294,967,296; NumPy gives NaN and 3,000,000,000
# Why it matters: a check that a room never left its bounds passes where its sensor was lost, and a district's energy of a year
# is negative
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile numexpr==2.14.2 numpy==2.4.6
"$work/venv/bin/python" - <<'EOF'
import numexpr
import numpy as np

for place in range(4):
    room_C = np.insert(np.array([20.0, 21.5, 19.0]), place, np.nan)
    least, most, total = (float(numexpr.evaluate(f"{name}(room_C)")) for name in ("min", "max", "sum"))
    print(room_C, "numexpr", least, most, total, "NumPy", room_C.min(), room_C.max(), room_C.sum())
    assert (least, most) == (19.0, 21.5) and np.isnan([total, room_C.min(), room_C.max()]).all()
energy_Wh = np.array([2_000_000_000, 1_000_000_000], dtype=np.int32)
print("energy: numexpr", numexpr.evaluate("sum(energy_Wh)"), "NumPy", energy_Wh.sum())
assert numexpr.evaluate("sum(energy_Wh)") == -1_294_967_296 and energy_Wh.sum() == 3_000_000_000
EOF
