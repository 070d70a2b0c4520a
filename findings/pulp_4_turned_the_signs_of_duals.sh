#!/usr/bin/env bash
# PuLP: where an objective is maximised, CBC's and HiGHS' duals have opposite signs, and release 4 turned both round.
#
# Versions: pulp 4.2.0 beside 3.3.2, highspy 1.16.0, cbcbox 2.935, Python 3.12
# A good guess: `constraint.pi` of one problem is the same number from CBC as from HiGHS, and from a new release as from the last
# Seen: minimising, all say 2.5. Maximising the negative of the same cost, release 3.3 says -2.5 with CBC and 2.5 with HiGHS,
# release 4.2 says 2.5 with CBC and -2.5 with HiGHS
# Why it matters: a plan that maximises a profit gives prices of heat or of grid capacity whose sign depends on which solver was
# there and on the release: a coordinator pays for what it should charge
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cat >"$work/duals.py" <<'PY'
import pulp

new = pulp.__version__.startswith("4")
found = {}
for solver in ("COIN_CMD" if new else "PULP_CBC_CMD", "HiGHS"):
    for sign, sense in ((1, pulp.LpMinimize), (-1, pulp.LpMaximize)):
        problem = pulp.LpProblem("plan", sense)
        make = problem.add_variable if new else pulp.LpVariable
        x, y = make("x", 0, 10), make("y", 0, 10)
        problem += sign * (2 * x + 3 * y)
        problem += x + y >= 4, "need"
        problem += x - y == 1, "pair"
        problem.solve(pulp.getSolver(solver, msg=False))
        assert abs(x.value() - 2.5) < 1e-6 and abs(y.value() - 1.5) < 1e-6
        rows = problem.constraints() if callable(problem.constraints) else problem.constraints.values()
        found["HiGHS" if solver == "HiGHS" else "CBC", sign] = {row.name: row.pi for row in rows}["need"]
print("pulp", pulp.__version__, {f"{name} {'min' if sign > 0 else 'max'}": value for (name, sign), value in found.items()})
assert found["CBC", 1] == found["HiGHS", 1] == 2.5
assert (found["CBC", -1], found["HiGHS", -1]) == ((2.5, -2.5) if new else (-2.5, 2.5))
PY
for release in 3.3.2 4.2.0; do
    python3.12 -m venv "$work/$release"
    "$work/$release/bin/pip" install -q --no-compile "pulp==$release" highspy==1.16.0 $([ "$release" = 3.3.2 ] || echo cbcbox==2.935)
    "$work/$release/bin/python" -W ignore "$work/duals.py"
done
