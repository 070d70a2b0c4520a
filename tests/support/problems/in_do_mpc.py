"""What given levels cost in a peer that is written in do-mpc."""

from __future__ import annotations

from benchmarks.controller.do_mpc_peer import DoMpcPeer
from benchmarks.zones.do_mpc_building import DoMpcBuilding
from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.data import Array


def do_mpc_cost(peer: DoMpcPeer | DoMpcBuilding, problem: MPCProblem, u: Array) -> float:
    """do-mpc's objective for levels `u` (A, N), which are left nothing to decide; slacks are."""
    mpc = peer.mpc
    for k in range(problem.n_steps):
        mpc.lb_opt_x["_u", k, 0, "u"] = mpc.ub_opt_x["_u", k, 0, "u"] = u[:, k]
    peer.solve(problem)
    assert mpc.solver_stats["success"]
    return float(mpc.solver_stats["iterations"]["obj"][-1])
