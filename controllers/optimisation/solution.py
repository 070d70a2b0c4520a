"""What a solver is and what it gives: the protocol, and the checks that every answer passes before it is acted on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.data import Array

# Relative tolerance between a solver's objective and the recomputed one: they differ if the solver accepted violated
# constraints.
_CLAIM_TOLERANCE = 1e-4
# Rounding of two costs that are the same.
_SAME_COST = 1e-9


class Solver(Protocol):
    """Solver of `MPCProblem`s of one operator and horizon."""

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance; a failure is returned as a `Solution` with `ok` False.

        `guess` (A, N): warm start, used by iterative solvers. The result does not depend on instances solved before.
        """
        ...


@dataclass(frozen=True, eq=False)
class Solve:
    """A solve that is asked for: called, it is made."""

    solver: Solver
    problem: MPCProblem
    guess: Array | None

    def __call__(self) -> Solution:
        """Solve it."""
        return self.solver.solve(self.problem, self.guess)


@dataclass(frozen=True)
class Solution:
    """Result of a solver; `ok` only if status, finiteness, bounds and objective passed the checks.

    `optimal` is False for levels that passed them without being the solver's optimum (`accept_suboptimal`).

    `u` (A, N): levels, empty when not ok; `status`: the solver's own status; `problem`: reason of a failure; `gap`:
    how much of its cost the solution may at most be above the optimum of what was solved, relative; 0 where it is
    convex.
    """

    ok: bool
    u: Array
    status: str
    iterations: int
    problem: str = ""
    gap: float = 0.0
    optimal: bool = True


def failed(status: str, iterations: int, why: str) -> Solution:
    """A solution that is none."""
    return Solution(False, np.empty((0, 0)), status, iterations, why)


def checked_solution(
    problem: MPCProblem,
    modes_of: Callable[[Array], Array],
    u: Array,
    claimed: float,
    status: str,
    iterations: int,
) -> Solution:
    """Check the result of a solver that reports success.

    The solution is refused unless it is finite, within bounds, capacities and exclusion, and its objective, recomputed
    by rollout, agrees with `claimed`. All other inequalities are soft, so such levels are feasible; a different
    objective shows that another problem was solved. `modes_of` maps levels (A, N) to forced states (Z, A, N, r), K.
    """
    m = problem.machinery
    if u.shape != (len(m.actuators), problem.n_steps) or not np.isfinite(u).all() or not np.isfinite(claimed):
        return failed(status, iterations, f"{status} was reported, but the solution is not finite")
    outside = problem.outside(u)
    if outside:
        return failed(status, iterations, f"{status} was reported, but {outside}")
    u = np.clip(u, m.u_min[:, None], m.u_max[:, None])
    cost = float(problem.cost_under(u, modes_of(u)))
    if not abs(cost - claimed) <= _CLAIM_TOLERANCE * (1.0 + abs(cost)):
        what = f"{status} was reported with an objective of {claimed:.6g}, but its levels cost {cost:.6g}"
        return failed(status, iterations, what)
    return Solution(True, u, status, iterations)


def accept_suboptimal(
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

    references = [np.zeros_like(u), np.broadcast_to(high, u.shape)]
    if guess is not None and guess.shape == u.shape:
        references.append(np.clip(guess, low, high))
    least = min((cost(levels) for levels in references if not problem.outside(levels)), default=np.inf)
    own_cost = cost(u)
    if not np.isfinite(own_cost) or own_cost > least + _SAME_COST * (1.0 + abs(least)):
        return failed(ended.status, ended.iterations, f"{ended.problem}, with levels dearer than without it")
    return Solution(True, u, ended.status, ended.iterations, ended.problem, optimal=False)
