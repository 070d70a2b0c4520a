#!/usr/bin/env bash
# cvxpy's new nonlinear way (nlp=True) says "optimal" of problems without a feasible point, and of unbounded ones, and has no duals.
#
# Versions: cvxpy 1.9.3, unopy 0.4.16
# A good guess: statuses and duals are those that cvxpy gives of a convex problem: infeasible, unbounded, prices of constraints
# Seen: with the solver UNO two rooms that need 40 kW together and may have 3 are "optimal" with 3, a cost, and the sum constraint violated
# by 37; a cost without a bound is "optimal" at -1.8e20; every dual_value is None, at true optima too. The same problems by
# Clarabel are infeasible and unbounded. Uno itself distinguishes these ends: its first status, "success", means that it ended
# Why it matters: whoever moves a controller to nlp=True for one nonlinear law and checks `status == "optimal"`, as before, sends
# commands of a plan that there is not
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile cvxpy==1.9.3 unopy==0.4.16
cat >"$work/statuses.py" <<'PY'
import cvxpy as cp


def feasible(x):
    return cp.Minimize(cp.square(x[0]) + 3 * cp.square(x[1])), [x[0] + x[1] >= 4, x[0] <= 1]


def infeasible(x):
    return cp.Minimize(cp.square(x[0]) + 3 * cp.square(x[1])), [x[0] + x[1] >= 40, x[0] <= 1, x[1] <= 2]


def unbounded(x):
    return cp.Minimize(x[0] + x[1]), [x[0] - x[1] >= 0]


for problem_of, truth in ((feasible, "optimal"), (infeasible, "infeasible"), (unbounded, "unbounded")):
    convex, problem = (cp.Problem(*problem_of(cp.Variable(2))) for _ in range(2))
    convex.solve(solver="CLARABEL")
    assert convex.status == truth
    problem.solve(solver="UNO", nlp=True)
    worst = max(float(row.violation()) for row in problem.constraints)
    duals = [row.dual_value for row in problem.constraints]
    print(f"FOUND {truth}: {problem.status}, cost {problem.value:.3g}, violated by {worst:.3g}, duals {duals}")
    assert problem.status == "optimal" and duals == [None] * len(duals)
    assert (worst > 36) == (truth == "infeasible") and (problem.value < -1e18) == (truth == "unbounded")
PY
"$work/venv/bin/python" -W ignore "$work/statuses.py" | grep FOUND
