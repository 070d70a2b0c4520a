"""Levels of a solver that stopped before its optimum: what makes them good enough to act on.

All comfort bounds are soft, so levels inside bounds, capacities and exclusion are feasible. They are acceptable where
they cost no more, by our own rollout, than what a controller could do without the solver: the previous plan one step
on, everything off, everything at full level.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from controllers.problem import MPCProblem, Solution, failed
from thermoforce_mpc.data import Array

# Rounding of two costs that are the same.
_SAME_COST = 1e-9


def checked_iterate(
    problem: MPCProblem,
    modes_of: Callable[[Array], Array],
    u: Array,
    guess: Array | None,
    ended: Solution,
) -> Solution:
    """The levels `u` (A, N) as a solution that is not optimal, or `ended` where they are not acceptable.

    Args:
        problem: the instance.
        modes_of: forced states (Z, A, N, r), K, of levels (A, N).
        u: the solver's last levels; whatever it left there.
        guess: the previous plan, one step on (A, N); None without one.
        ended: the failed solution with status and reason of the solver.
    """
    m = problem.machinery
    if u.shape != (len(m.actuators), problem.n_steps) or not np.isfinite(u).all():
        return ended
    low, high = m.u_min[:, None], m.u_max[:, None]
    u = np.clip(u, low, high)
    if problem.outside(u):
        return ended

    def cost(levels: Array) -> float:
        return float(problem.cost_under(levels, modes_of(levels)))

    others = [np.zeros_like(u), np.broadcast_to(high, u.shape)]
    if guess is not None and guess.shape == u.shape:
        others.append(np.clip(guess, low, high))
    least = min((cost(levels) for levels in others if not problem.outside(levels)), default=np.inf)
    found = cost(u)
    if not np.isfinite(found) or found > least + _SAME_COST * (1.0 + abs(least)):
        return failed(ended.status, ended.iterations, f"{ended.problem}, with levels dearer than without it")
    return Solution(True, u, ended.status, ended.iterations, ended.problem, optimal=False)
