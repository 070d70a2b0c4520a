#!/usr/bin/env bash
# A QP whose Hessian is handed over as one triangle is another QP, and which triangle is right depends on the solver.
#
# Versions: osqp 1.1.3, clarabel 0.11.1, piqp 0.7.0, proxsuite 0.8.0, daqp 0.11.0
# A good guess: a Hessian that is not symmetric is refused or symmetrised; one solver's dense and sparse form agree
# Seen: OSQP, Clarabel and PIQP read the upper triangle and drop what stands in the lower one; so does sparse ProxQP,
# while dense ProxQP reads the lower one and drops the upper; DAQP takes the lower one as a diagonal and the upper as
# neither. All report an optimum. With both triangles all agree
# Why it matters: scipy.linalg and HiGHS hand out and want lower triangles; whoever saves memory by passing one gets plans
# without any coupling between steps, from a solver that says "solved"
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile osqp==1.1.3 clarabel==0.11.1 piqp==0.7.0 proxsuite==0.8.0 daqp==0.11.0 \
    numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" -W ignore - <<'EOF'
import clarabel
import daqp
import numpy as np
import osqp
import piqp
import proxsuite
from scipy.sparse import csc_matrix

P = np.array([[2.0, 1.0], [1.0, 2.0]])
q, A, lower, upper = np.array([-3.0, -1.0]), np.eye(2), np.full(2, -9.0), np.full(2, 9.0)


def by_osqp(P):
    solver = osqp.OSQP()
    solver.setup(csc_matrix(P), q, csc_matrix(A), lower, upper, verbose=False, eps_abs=1e-8, eps_rel=1e-8)
    return solver.solve().x


def by_clarabel(P):
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones, bounds = [clarabel.NonnegativeConeT(4)], np.r_[upper, -lower]
    return clarabel.DefaultSolver(csc_matrix(P), q, csc_matrix(np.r_[A, -A]), bounds, cones, settings).solve().x


def by_piqp(P):
    solver = piqp.SparseSolver()
    solver.setup(csc_matrix(P), q, None, None, csc_matrix(A), lower, upper)
    solver.solve()
    return solver.result.x


def by_sparse_proxqp(P):
    return proxsuite.proxqp.sparse.solve(csc_matrix(P), q, None, None, csc_matrix(A), lower, upper).x


def by_dense_proxqp(P):
    return proxsuite.proxqp.dense.solve(P, q, None, None, A, lower, upper).x


def by_daqp(P):
    return daqp.solve(P, q, A, upper, lower, np.zeros(2, dtype=np.int32))[0]


optimum, uncoupled = np.array([5 / 3, -1 / 3]), np.array([1.5, 0.5])
seen = {}
for solve in (by_osqp, by_clarabel, by_piqp, by_sparse_proxqp, by_dense_proxqp, by_daqp):
    seen[solve.__name__] = [np.round(np.asarray(solve(M)), 3) for M in (P, np.tril(P), np.triu(P))]
    print(f"{solve.__name__[3:]:13} both {seen[solve.__name__][0]} lower {seen[solve.__name__][1]} upper {seen[solve.__name__][2]}")
for name, (both, low, up) in seen.items():
    assert np.allclose(both, optimum, atol=2e-3), name
    wrong = up if name == "by_dense_proxqp" else low
    assert np.allclose(wrong, uncoupled, atol=2e-3), name
assert not np.allclose(seen["by_daqp"][2], optimum, atol=0.05)
EOF
