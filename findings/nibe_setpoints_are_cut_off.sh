#!/usr/bin/env bash
# The client of NIBE heat pumps cuts off what a register cannot hold: 21.99 °C is set as 21.9.
#
# Versions: nibe 2.25.0
# A good guess: a value finer than the register (tenths of a degree) is rounded, or refused by `validate`
# Seen: it passes `validate` and is cut off towards zero; and where a register holds hundredths, 2.3 is sent as 2.29, since
# 2.3 x 100 is a little less than 230
# Why it matters: what is read back differs from what was set by more than a rounding, always to the same side; a controller that
# sees this as a change by hand leaves the heat pump alone
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile nibe==2.25.0
"$work/venv/bin/python" -W ignore - <<'EOF'
from nibe.coil import Coil, CoilData


def read_back(value, factor):
    coil = Coil(47398, "room-setpoint-47398", "Room setpoint", "s16", factor=factor, write=True, min=-300, max=3000)
    data = CoilData(coil, value)
    data.validate()
    return CoilData.from_raw_value(coil, data.raw_value).value


for value, factor, seen in ((21.3, 10, 21.3), (21.99, 10, 21.9), (-2.37, 10, -2.3), (2.3, 100, 2.29)):
    found = read_back(value, factor)
    print(f"{value} in a register of 1/{factor}: {found}")
    assert found == seen
EOF
