#!/usr/bin/env bash
# In SciPy a bound that is NaN is no bound for linprog, while milp has no answer to the same problem.
#
# Versions: scipy 1.17.1
# A good guess: a NaN among the bounds is an error, as one among the costs is, in both
# Seen: linprog with bounds (0, NaN) answers the optimum without an upper bound, status 0; milp with Bounds(0, NaN), or with a
# NaN as limit of a constraint, gives status 2, which its documentation calls infeasible. Costs of NaN raise in both
# Why it matters: a power limit that is missing in the data vanishes from the plan in one function and leaves no plan at all
# in the other; neither says which number was missing
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile scipy==1.17.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
from scipy.optimize import Bounds, LinearConstraint, linprog, milp

known = linprog([-1.0], A_ub=[[1.0]], b_ub=[10.0], bounds=[(0.0, 5.0)])
missing = linprog([-1.0], A_ub=[[1.0]], b_ub=[10.0], bounds=[(0.0, np.nan)])
same = milp([-1.0], constraints=LinearConstraint([[1.0]], -np.inf, 10.0), bounds=Bounds([0.0], [np.nan]))
row = milp([-1.0], constraints=LinearConstraint([[1.0]], -np.inf, np.nan))
print(f"upper bound 5: {known.x}; NaN: linprog {missing.x}, status {missing.status}; milp status {same.status}: {same.message}")
assert known.x[0] == 5.0 and missing.status == 0 and missing.x[0] == 10.0 and same.status == 2 and row.status == 2
EOF
