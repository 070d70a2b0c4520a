#!/usr/bin/env bash
# CasADi's derivative of fmax (and of fmin, mmax) where both sides are equal is one half for each.
#
# Versions: casadi 3.8.2
# A good guess: one side wins: (1, 0), as a comparison x >= y would give, while fabs'(0) is 0
# Seen: fmax(x, y) at x == y has the gradient (0.5, 0.5), for SX and MX; the sum of fabs' and the half agree, since
# fmax(x, 0) = (x + |x|) / 2
# Why it matters: a hinge of discomfort max(0, lower - T) pulls with half its weight exactly at the bound, where a plan
# without margin stands; torch and JAX give 0 or 1 there (relu), or a half (maximum), so trained and exported gradients
# differ at such points
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile casadi==3.8.2 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import casadi as ca

for kind in (ca.SX, ca.MX):
    x, y = kind.sym("x"), kind.sym("y")
    both = ca.vertcat(x, y)
    for name, value in (("fmax", ca.fmax(x, y)), ("fmin", ca.fmin(x, y)), ("mmax", ca.mmax(both))):
        slope = ca.Function("slope", [x, y], [ca.jacobian(value, both)])
        print(kind.__name__, name, slope(1, 1))
        assert [float(v) for v in slope(1, 1).full().ravel()] == [0.5, 0.5]
    hinge = ca.Function("hinge", [x], [ca.gradient(ca.fmax(x, 0), x)])
    assert float(hinge(0)) == 0.5 and float(hinge(1e-300)) == 1 and float(hinge(-1e-300)) == 0
EOF
