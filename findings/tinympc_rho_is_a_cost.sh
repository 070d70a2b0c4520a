#!/usr/bin/env bash
# In TinyMPC the penalty rho of the algorithm is a part of the cost: a plan that has converged heats an eighth of what is optimal.
#
# Versions: tinympc 0.0.8
# A good guess: rho decides how fast ADMM converges, not what it converges to; the first input of the unconstrained problem is
# that of LQR with the Q and R that were given
# Seen: for a room with Q = 1 and R = 0.01 the optimum is 17.2; the plan begins with 12.3, 5.3, 2.2 and 1.7 at rho 0.01, 0.1, 1
# and 10, each "converged" (tolerances of 1e-8 change nothing): about what Q + rho and R + rho would give. With an upper bound
# of 3, which should act, rho 1 says 2.2
# Why it matters: a controller tuned by Q and R on a desk is another one on the microcontroller, and one that is slower to heat
# by a factor, without a sign in the answer, which holds states and inputs only
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile tinympc==0.0.8
"$work/venv/bin/python" -W ignore - <<'PY'
import numpy as np
import tinympc

a, b, q, r, steps, start = 0.99, 0.02, 1.0, 0.01, 24, -2.0


def regulator(q, r):
    p = q
    for _ in range(10_000):
        p = q + a * p * a - (a * p * b) ** 2 / (r + b * p * b)
    return -b * p * a / (r + b * p * b) * start


def tiny(rho, highest=None, **settings):
    solver = tinympc.TinyMPC()
    parts = (np.array([[part]]) for part in (a, b, q, r))
    solver.setup(*parts, steps, rho=rho, verbose=False, **settings)
    if highest:
        solver.set_bound_constraints(np.array([-1e6]), np.array([1e6]), np.array([0.0]), np.array([highest]))
    solver.set_x0(np.array([start]))
    return float(np.ravel(solver.solve()["controls"])[0])


optimum = regulator(q, r)
found = {rho: tiny(rho) for rho in (0.01, 0.1, 1.0, 10.0)}
tight = tiny(1.0, abs_pri_tol=1e-8, abs_dua_tol=1e-8, max_iter=100_000)
bounded = tiny(1.0, highest=3.0)
added = {rho: regulator(q + rho, r + rho) for rho in found}
print(f"optimum {optimum:.2f}, by rho:", {rho: round(u, 2) for rho, u in found.items()}, f"tight {tight:.2f}, bounded {bounded:.2f}")
print("regulator of Q + rho and R + rho:", {rho: round(u, 2) for rho, u in added.items()})
assert 17 < optimum < 17.5 and abs(tight - found[1.0]) < 0.01 and abs(bounded - found[1.0]) < 0.01
assert [round(u, 1) for u in found.values()] == [12.3, 5.3, 2.2, 1.7]
PY
