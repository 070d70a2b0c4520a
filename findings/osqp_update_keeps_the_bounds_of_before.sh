#!/usr/bin/env bash
# OSQP's update with a lower bound above an upper one raises nothing, takes nothing over, and the next answer is "solved".
#
# Versions: osqp 1.1.3, scipy 1.17.1, numpy 2.4.6
# A good guess: update raises what setup raises for the same bounds
# Seen: setup raises OSQPException; update prints "Problem data validation" on standard error and returns None, as it does
# when all is well. The costs that were given in the same call are not taken over either: solve() gives the answer of the
# problem of before, status "solved". Costs of a wrong length pass without a line
# Why it matters: controllers set a problem up once and update it each step. In the step whose comfort bounds cross, the
# plan is that of the step before, prices included, and no status tells
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile osqp==1.1.3 scipy==1.17.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
import osqp
from scipy.sparse import csc_matrix

EYE = csc_matrix(np.eye(2))


def solver(lower, upper):
    made = osqp.OSQP()
    made.setup(EYE, np.array([-1.0, -1.0]), EYE, np.array(lower), np.array(upper), verbose=False, eps_abs=1e-8, eps_rel=1e-8)
    return made


try:
    solver([1.0, 1.0], [0.5, 0.5])
    at_setup = "nothing"
except osqp.OSQPException as problem:
    at_setup = f"OSQPException {problem}"
crossed = solver([0.0, 0.0], [0.5, 0.5])
crossed.solve()
answer = crossed.update(q=np.array([5.0, 5.0]), l=np.array([1.0, 1.0]))
then = crossed.solve()
longer = solver([0.0, 0.0], [0.5, 0.5])
longer_answer = longer.update(q=np.full(3, 5.0))
print(f"lower above upper: setup raises {at_setup}; update gives {answer}, then {then.info.status} {then.x.round(3)}")
print(f"three costs for two variables: update gives {longer_answer}, then {longer.solve().info.status}")
assert at_setup.startswith("OSQPException") and answer is None and longer_answer is None
assert then.info.status == "solved" and np.allclose(then.x, 0.5, atol=1e-4)
assert longer.solve().info.status == "solved"
EOF
