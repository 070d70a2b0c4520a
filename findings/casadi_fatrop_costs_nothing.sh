#!/usr/bin/env bash
# CasADi's fatrop, as a solver of QPs, says of each plan that it costs nothing: `cost` is 0, and qpsol's `f` is the constant of the cost.
#
# Versions: casadi 3.8.2 (its own solvers)
# A good guess: with `success`, f is the cost of the x that is returned, as from the other solvers of QPs
# Seen: for a room of four steps fatrop's x and multipliers are those of qrqp, OSQP and HiGHS to six digits; their f is 42.254 and
# fatrop's 2000, five times 20² from (T - 20)². With conic, which has no constant, cost is 0. Fatrop as a solver of NLPs has 42.254
# Why it matters: what two plans cost decides which one is taken (whether a start of a machine is worth it, a window of a tariff, the
# better of two starts of a nonlinear problem), and of all plans by fatrop the first is then the cheapest
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile casadi==3.8.2 numpy==2.4.6
cat >"$work/cost.py" <<'EOF'
import sys

import casadi as ca

STEPS = 4
room, heat = ca.SX.sym("room", STEPS + 1), ca.SX.sym("heat", STEPS)
x = ca.vertcat(*[ca.vertcat(room[k], heat[k]) for k in range(STEPS)], room[STEPS])
rows = [room[k + 1] - 0.9 * room[k] - 0.5 * heat[k] - 1 for k in range(STEPS)] + [room[0] - 15]
problem = {"x": x, "f": ca.sumsqr(room - 20) + 0.1 * ca.sumsqr(heat), "g": ca.vertcat(*rows)}
bounds = {"lbg": 0, "ubg": 0, "lbx": [-ca.inf, 0] * STEPS + [-ca.inf], "ubx": [ca.inf, 5] * STEPS + [ca.inf]}
cost = ca.Function("cost", [x], [problem["f"]])
OPTIONS = {"osqp": {"osqp": {"verbose": False, "eps_abs": 1e-9, "eps_rel": 1e-9}}, "highs": {"highs": {"output_flag": False}}}
plans = {name: ca.qpsol("plan", name, problem, OPTIONS.get(name, {})) for name in ("qrqp", "osqp", "highs", "fatrop")}
plans["fatrop as NLP"] = ca.nlpsol("plan", "fatrop", problem)
seen = {}
for name, plan in plans.items():
    found = plan(**bounds)
    assert plan.stats()["success"]
    seen[name] = float(found["f"])
    print(f"{name}: f = {seen[name]:.6f}, cost of its x = {float(cost(found['x'])):.6f}", file=sys.stderr)
    assert abs(float(cost(found["x"])) - 42.253715) < 1e-5
assert all(abs(seen[name] - 42.253715) < 1e-5 for name in ("qrqp", "osqp", "highs", "fatrop as NLP"))
assert seen["fatrop"] == 2000
alone = ca.conic("alone", "fatrop", {"h": ca.Sparsity.diag(1), "a": ca.Sparsity.dense(0, 1)})
found = alone(h=2, g=-6, lbx=0, ubx=2)
print("(x - 3)² - 9 up to x = 2, by conic:", found["x"], found["cost"], file=sys.stderr)
assert abs(float(found["x"]) - 2) < 1e-5 and float(found["cost"]) == 0
EOF
"$work/venv/bin/python" "$work/cost.py" >"$work/banners"
