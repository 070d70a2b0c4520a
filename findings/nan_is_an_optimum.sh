#!/usr/bin/env bash
# Given a NaN in the linear cost, four QP solvers do four things; DAQP reports an optimum and quadprog returns without a word.
#
# Versions: daqp 0.11.0, quadprog 0.1.14, piqp 0.7.0, clarabel 0.11.1
# A good guess: each refuses the problem or ends with an error status: the flag of DAQP is not 1, quadprog raises
# ValueError
# Seen: DAQP: exit flag 1 (optimal) with x NaN after one iteration; quadprog: x and cost NaN, no error; PIQP: the status
# of too many iterations; Clarabel: NumericalError, x 0
# Why it matters: one missing price among 96 gives a plan of NaN that some solvers call optimal: numbers are to be
# checked before and after, whatever the status says
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile daqp==0.11.0 quadprog==0.1.14 piqp==0.7.0 clarabel==0.11.1 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" -W ignore - <<'EOF'
import clarabel
import daqp
import numpy as np
import piqp
import quadprog
import scipy.sparse as sp

nan = np.nan
x, cost, flag, info = daqp.solve(np.eye(1) * 2, np.array([nan]), np.eye(1), np.array([0.5]), np.array([0.0]), np.zeros(1, dtype=np.int32))
print("daqp     exit flag", flag, "(1: optimal) x", x)
assert flag == 1 and np.isnan(x).all()

x, cost, *_ = quadprog.solve_qp(np.eye(1) * 2, np.array([nan]), np.eye(1), np.zeros(1))
print("quadprog returns x", x, "cost", cost)
assert np.isnan(x).all() and np.isnan(cost)

solver = piqp.DenseSolver()
solver.setup(np.eye(1) * 2, np.array([nan]), None, None, None, None, None, np.zeros(1), np.array([0.5]))
status = solver.solve()
print("piqp    ", status)
assert status == piqp.Status.PIQP_MAX_ITER_REACHED

settings = clarabel.DefaultSettings()
settings.verbose = False
found = clarabel.DefaultSolver(sp.csc_matrix([[2.0]]), np.array([nan]), sp.csc_matrix([[1.0], [-1.0]]), np.array([0.5, 0.0]), [clarabel.NonnegativeConeT(2)], settings).solve()
print("clarabel", found.status, found.x)
assert found.status == clarabel.SolverStatus.NumericalError
EOF
