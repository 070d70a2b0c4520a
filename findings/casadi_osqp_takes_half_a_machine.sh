#!/usr/bin/env bash
# CasADi's osqp and superscs take `discrete` and leave it out: 1.05 heat pumps are on, and the plan is called a success.
#
# Versions: casadi 3.8.2 (its own solvers)
# A good guess: a solver without integers refuses variables that are declared whole, as the others do, or the answer is whole
# Seen: of twelve plugins of `conic` osqp and superscs alone return [1.05, 2.15] where the first was to be whole (the best is [1, 2.2]),
# with success; seven name the missing support for integers, daqp and cbc refuse this problem, and HiGHS says that it failed
# Why it matters: a change of the solver by its name, to one that is quick, turns machines that are on or off into parts of one: the plan
# is cheaper than any that can be carried out, and what is sent to the machine depends on who rounds it
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile casadi==3.8.2 numpy==2.4.6
cat >"$work/whole.py" <<'EOF'
import sys

import casadi as ca

OPTIONS = {"osqp": {"osqp": {"verbose": False}}, "superscs": {"superscs": {"verbose": 0}}, "highs": {"highs": {"output_flag": False}}}
OPTIONS["nlpsol"] = {"nlpsol": "ipopt", "nlpsol_options": {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}}
one_row, hessian = ca.DM([[1.0, 1.0]]), ca.diag(ca.DM([2.0, 2.0]))
seen = {}
for name in ("osqp", "superscs", "highs", "daqp", "cbc", "qrqp", "qpoases", "ipqp", "proxqp", "fatrop", "clp", "nlpsol"):
    options = {"discrete": [True, False], "error_on_fail": False} | OPTIONS.get(name, {})
    try:
        plan = ca.conic("plan", name, {"a": one_row.sparsity(), "h": hessian.sparsity()}, options)
        answer = plan(a=one_row, h=hessian, g=[-3.0, -5.2], lba=-ca.inf, uba=3.2, lbx=0, ubx=[2.7, 4.0])
    except RuntimeError as error:
        seen[name] = "whole refused" if "integer support" in str(error) else "refused"
    else:
        seen[name] = round(float(answer["x"][0]), 3) if plan.stats()["success"] else "failed"
print("first variable, which is to be whole:", seen, file=sys.stderr)
assert seen["osqp"] == seen["superscs"] == 1.05
assert seen["highs"] == "failed" and seen["daqp"] == seen["cbc"] == "refused"
assert all(seen[name] == "whole refused" for name in ("qrqp", "qpoases", "ipqp", "proxqp", "fatrop", "clp", "nlpsol"))
EOF
"$work/venv/bin/python" "$work/whole.py" >"$work/banners"
