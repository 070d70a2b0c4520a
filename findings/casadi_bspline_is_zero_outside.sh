#!/usr/bin/env bash
# A CasADi 'bspline' interpolant is 0 outside its grid; 'linear' goes on along its last line.
#
# Versions: casadi 3.8.2
# A good guess: both go on: 'linear' along its last line, 'bspline' along its last polynomial, or both stop with an
# error
# Seen: 'linear' extrapolates, 'bspline' gives exactly 0 just beyond the last grid point, value and derivative, and no
# status or warning
# Why it matters: a table of heat pump power or COP over outdoor temperature costs nothing on the first day that is
# colder than the table, and an optimiser is drawn there
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile casadi==3.8.2 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import casadi as ca

grid, values = [0, 1, 2, 3, 4, 5], [0, 1, 4, 9, 16, 25]
linear = ca.interpolant("linear", "linear", [grid], values)
spline = ca.interpolant("spline", "bspline", [grid], values)
x = ca.MX.sym("x")
slope = ca.Function("slope", [x], [ca.gradient(spline(x), x)])
print("at the last grid point:", float(linear(5)), float(spline(5)))
print("0.001 beyond:          ", float(linear(5.001)), float(spline(5.001)), "slope of the spline", float(slope(5.001)))
assert abs(float(linear(6)) - 34) < 1e-9
assert abs(float(spline(5)) - 25) < 1e-9 and float(spline(5.001)) == 0 and float(spline(-0.001)) == 0
assert float(slope(5.001)) == 0
EOF
