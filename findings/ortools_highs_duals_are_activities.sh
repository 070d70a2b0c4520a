#!/usr/bin/env bash
# OR-Tools with HiGHS returns as the dual value of a constraint what stands on its left side.
#
# Versions: ortools 9.15.6755
# A good guess: `dual_value()` of one linear programme is the same number by GLOP, CLP, PDLP and HiGHS, the price of one unit more
# Seen: GLOP, CLP and PDLP say 2.5, 0 and -0.5; HIGHS and HIGHS_LP say 4, 2.5 and 1: the rows' own values at the optimum. Plan,
# cost and status are right, nothing is said
# Why it matters: the marginal price of heat or of a connection, by which units, houses or periods are coordinated, is a power
# in kW as soon as another solver is chosen
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile ortools==9.15.6755
"$work/venv/bin/python" -W ignore - <<'PY'
from ortools.linear_solver import pywraplp


def solved(name):
    solver = pywraplp.Solver.CreateSolver(name)
    x, y = solver.NumVar(0, 10, "x"), solver.NumVar(0, 10, "y")
    rows = [solver.Add(x + y >= 4), solver.Add(x <= 3), solver.Add(x - y == 1)]
    solver.Minimize(2 * x + 3 * y)
    assert solver.Solve() == solver.OPTIMAL and abs(solver.Objective().Value() - 9.5) < 1e-6
    left = [x.solution_value() + y.solution_value(), x.solution_value(), x.solution_value() - y.solution_value()]
    return [round(row.dual_value(), 6) for row in rows], [round(value, 6) for value in left]


for name in ("GLOP", "CLP", "PDLP", "HIGHS", "HIGHS_LP"):
    duals, left = solved(name)
    print(f"{name}: duals {duals}, left sides {left}")
    assert duals == (left if "HIGHS" in name else [2.5, 0.0, -0.5])
PY
