#!/usr/bin/env bash
# In CasADi a clip turns NaN into a limit, and which one depends on how the clip is written.
#
# Versions: casadi 3.8.2
# A good guess: NaN stays NaN, as in numpy.clip, numpy.minimum and torch.clamp
# Seen: fmin(fmax(x, 0), 1) of NaN is 0, fmax(fmin(x, 1), 0) is 1; mmax, mmin and norm_inf of a vector skip NaN, while
# norm_1 does not; if_else(x > 1, 1, x) keeps NaN
# Why it matters: a forecast or state that is not a number leaves a saturated actuator law as off or as full power, both
# plausible; a check for finite numbers has to stand before the clip
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile casadi==3.8.2 numpy==2.4.6
"$work/venv/bin/python" - <<'EOF'
import casadi as ca
import numpy as np

nan, x = float("nan"), ca.SX.sym("x")
seen = {
    "fmin(fmax(x, 0), 1)": float(ca.Function("f", [x], [ca.fmin(ca.fmax(x, 0), 1)])(nan)),
    "fmax(fmin(x, 1), 0)": float(ca.Function("f", [x], [ca.fmax(ca.fmin(x, 1), 0)])(nan)),
    "mmax([1, nan, 3])": float(ca.mmax(ca.DM([1, nan, 3]))),
    "norm_inf([1, nan, 3])": float(ca.norm_inf(ca.DM([1, nan, 3]))),
    "norm_1([1, nan, 3])": float(ca.norm_1(ca.DM([1, nan, 3]))),
    "numpy.clip": float(np.clip(nan, 0, 1)),
}
print(seen)
assert list(seen.values())[:4] == [0.0, 1.0, 3.0, 3.0]
assert np.isnan(seen["norm_1([1, nan, 3])"]) and np.isnan(seen["numpy.clip"])
EOF
