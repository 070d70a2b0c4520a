#!/usr/bin/env bash
# CoolProp raises on an impossible state given alone and returns inf for it inside a vector.
#
# Versions: CoolProp 8.0.0
# A good guess: a vector with one impossible element raises, as the scalar call does
# Seen: PropsSI('H', 'T', [280, 290, 9999], 'Q', 1, 'R290') returns the third as inf; alone it raises ValueError
# Why it matters: a table of a heat pump's working points carries an inf into regressions and maps
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile CoolProp==8.0.0 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
from CoolProp.CoolProp import PropsSI

values = PropsSI("H", "T", [280.0, 290.0, 9999.0], "Q", 1, "R290")
print("vector:", values)
assert np.isfinite(values[:2]).all() and np.isinf(values[2])
try:
    PropsSI("H", "T", 9999.0, "Q", 1, "R290")
except ValueError as error:
    print("alone:", str(error)[:90])
else:
    raise SystemExit("taken")
EOF
