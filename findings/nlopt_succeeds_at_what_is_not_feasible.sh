#!/usr/bin/env bash
# NLopt ends with a success code at a point that violates its constraint by 29, for a problem that has no feasible point.
#
# Versions: nlopt 2.11.0, numpy 2.4.6
# A good guess: a problem without a feasible point ends in a negative code, an exception, or the code of a limit that was reached
# Seen: MMA, CCSAQ and COBYLA return XTOL_REACHED, one of the codes that the manual calls success, and the point's cost as the
# optimum; SLSQP raises RoundoffLimited, as it also may after a good solve
# Why it matters: on a cold day comfort cannot be kept at any power; the answer looks like that of any other day, so a caller has
# to evaluate the constraints again before a command leaves
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile nlopt==2.11.0 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import nlopt
import numpy as np


def cost(x, slope):
    if slope.size:
        slope[:] = [2 * x[0], 6 * x[1]]
    return float(x[0] ** 2 + 3 * x[1] ** 2)


def shortfall(x, slope):
    """x0 + x1 >= 40, while the bounds allow at most 11."""
    if slope.size:
        slope[:] = [-1, -1]
    return float(40 - x[0] - x[1])


for name in ("LD_MMA", "LD_CCSAQ", "LN_COBYLA"):
    solver = nlopt.opt(getattr(nlopt, name), 2)
    solver.set_min_objective(cost)
    solver.add_inequality_constraint(shortfall, 1e-6)
    solver.set_lower_bounds([-10, -10])
    solver.set_upper_bounds([1, 10])
    solver.set_xtol_rel(1e-6)
    solver.set_maxeval(5000)
    point = solver.optimize([0, 0])
    code, short = solver.last_optimize_result(), shortfall(point, np.array([]))
    print(f"{name}: code {code}, point {point}, evaluations {solver.get_numevals()}, constraint violated by {short:.1f}")
    assert code == nlopt.XTOL_REACHED == 4 and abs(short - 29) < 1e-3 and solver.get_numevals() < 5000
PY
