#!/usr/bin/env bash
# CasADi's Opti gives the multiplier of one constraint with two signs: `dual` and `lam_g` differ where it is written as >=.
#
# Versions: casadi 3.8.2
# A good guess: multipliers of `x >= 1` in the minimum of x² are -2, as everywhere in CasADi (a lower bound that acts is
# negative), by `opti.dual(c)` as in `opti.lam_g`; of `bounded(1, x, 3)` one number whose sign tells the side
# Seen: dual is +2 and lam_g is -2; written as `-x <= -1` both are +2; dual of `bounded` is a vector of two (lower, upper),
# both positive, while lam_g holds one
# Why it matters: prices of comfort or of a power cap that are read from lam_g and from dual have opposite signs, and a warm
# start of lam_g by duals pushes the wrong way
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile casadi==3.8.2 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import casadi as ca
import numpy as np


def multipliers(constraint, target=0.0):
    opti = ca.Opti()
    x = opti.variable()
    opti.minimize((x - target) ** 2)
    c = constraint(opti, x)
    opti.subject_to(c)
    opti.solver("ipopt", {"print_time": 0, "ipopt.print_level": 0, "ipopt.sb": "yes"})
    found = opti.solve()
    return np.round(np.ravel(found.value(opti.dual(c))), 4).tolist(), np.round(np.ravel(found.value(opti.lam_g)), 4).tolist()


seen = {
    "x >= 1": multipliers(lambda opti, x: x >= 1),
    "-x <= -1": multipliers(lambda opti, x: -x <= -1),
    "bounded(1, x, 3) at 1": multipliers(lambda opti, x: opti.bounded(1, x, 3)),
    "bounded(1, x, 3) at 3": multipliers(lambda opti, x: opti.bounded(1, x, 3), 5.0),
}
for name, (dual, lam_g) in seen.items():
    print(f"{name}: dual {dual}, lam_g {lam_g}")
assert seen["x >= 1"] == ([2.0], [-2.0]) and seen["-x <= -1"] == ([2.0], [2.0])
assert seen["bounded(1, x, 3) at 1"] == ([2.0, 0.0], [-2.0]) and seen["bounded(1, x, 3) at 3"] == ([0.0, 4.0], [4.0])
EOF
