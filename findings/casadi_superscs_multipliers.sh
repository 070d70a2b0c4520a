#!/usr/bin/env bash
# SuperSCS by CasADi's 'conic' returns multipliers that do not satisfy the conditions of optimality.
#
# Versions: casadi 3.8.2 (its own SuperSCS)
# A good guess: lam_a and lam_x have one sign convention and agree between plugins to the solver's tolerance
# Seen: x is right to 1e-5, but with an active bound lam_a is 5.0 instead of 4.8 and lam_x -3.0 instead of -4.6:
# gradient + A' lam_a + lam_x is 1.8 instead of 0
# Why it matters: shadow prices (what a kelvin of comfort or a kilowatt of limit costs) and warm starts from these
# multipliers are wrong, though the plan is right
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile casadi==3.8.2 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import casadi as ca
import numpy as np

H, g, A = ca.DM([[2, 0], [0, 2]]), ca.DM([-2, -5]), ca.DM([[1, 1]])


def residual(plugin, options):
    solver = ca.conic("solver", plugin, {"h": H.sparsity(), "a": A.sparsity()}, options)
    found = solver(h=H, g=g, a=A, lbx=[0.9, -9], ubx=9, lba=-ca.inf, uba=1)
    x, of_row, of_bound = (np.array(found[k]).ravel() for k in ("x", "lam_a", "lam_x"))
    left = np.array(H) @ x + np.array(g).ravel() + np.array(A).T @ of_row + of_bound
    print(f"{plugin:8}", "x", x.round(4), "lam_a", of_row.round(4), "lam_x", of_bound.round(4), "stationarity", left.round(4))
    assert np.allclose(x, [0.9, 0.1], atol=1e-3)
    return abs(left).max()


for plugin, options in (("highs", {"highs": {"output_flag": False}}), ("piqp", {}), ("daqp", {})):
    assert residual(plugin, options) < 1e-5
assert residual("superscs", {"superscs": {"verbose": 0}}) > 1
EOF
