"""What a solver is and what it gives: the protocol, and the checks that every answer passes before it is acted on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from controllers.optimisation.evaluation import Evaluation, Evaluator
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.casadi_export import export_calls

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
        """Solve it, and count the calls of the exported operator."""
        before = export_calls()
        solution = self.solver.solve(self.problem, self.guess)
        if not isinstance(solution, Solution):  # whoever asked refuses it
            return solution
        return replace(solution, export_calls=export_calls() - before)


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a solver; `ok` only if status, finiteness, bounds and objective passed the checks.

    `optimal` is False for levels that passed them without being the solver's optimum (`accept_suboptimal`).

    `u` (A, N): levels, empty when not ok; `status`: solver and its own status; `problem`: reason of a failure; `gap`:
    how much of its cost the solution may at most be above the optimum of what was solved, relative; 0 where it is
    convex. `evaluation`: what the levels bring, as they are held; None when not ok. `export_calls`: calls of the
    exported operator that it took, see `casadi_export.export_calls`. `own`: the user's own variables (n,), by name.
    """

    ok: bool
    u: Array
    status: str
    iterations: int
    problem: str = ""
    gap: float = 0.0
    optimal: bool = True
    evaluation: Evaluation | None = None
    export_calls: int = 0
    own: Mapping[str, Array] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """The objective, currency; NaN when not ok."""
        return float("nan") if self.evaluation is None else self.evaluation.cost

    @property
    def own_values(self) -> Array | None:
        """The user's own variables one after another; None without any."""
        return np.concatenate(list(self.own.values())) if self.own else None


def failed(status: str, iterations: int, why: str) -> Solution:
    """A solution that is none."""
    return Solution(False, np.empty((0, 0)), status, iterations, why)


def not_finite(p: Array) -> Solution | None:
    """A failed solution where the parameters of an instance are not all finite."""
    if np.isfinite(p).all():
        return None
    return failed("not started", 0, "the problem holds numbers that are not finite")


def checked_solution(
    model: Evaluator,
    problem: MPCProblem,
    p: Array,
    u: Array,
    claimed: float,
    status: str,
    iterations: int,
    own: Array | None = None,
) -> Solution:
    """Check the levels `u` (A, N) of a solver that reports success with an objective of `claimed`.

    They are refused unless they are finite, within bounds, capacities and exclusion, and their objective, recomputed by
    the statement mode by mode, agrees with `claimed`. All other inequalities are soft, so such levels are feasible; a
    different objective shows that another problem was solved. `p`: parameters; `own`: variables of the user.
    """
    if u.shape != (model.structure.A, problem.n_steps) or not np.isfinite(u).all() or not np.isfinite(claimed):
        return failed(status, iterations, f"{status} was reported, but the solution is not finite")
    found = model.evaluate(problem, p, u, own)
    outside = problem.unfit(u) or found.broken
    if outside:
        return failed(status, iterations, f"{status} was reported, but {outside}")
    if not abs(found.cost - claimed) <= _CLAIM_TOLERANCE * (1.0 + abs(found.cost)):
        what = f"{status} was reported with an objective of {claimed:.6g}, but its levels cost {found.cost:.6g}"
        return failed(status, iterations, what)
    return Solution(True, u, status, iterations, evaluation=found, own=model.by_name(own))


def checked_variables(
    model: PlanModel, problem: MPCProblem, p: Array, x: Array, claimed: float, status: str, iterations: int
) -> Solution:
    """Check the variables `x` of a solver that reports success, as `checked_solution` does levels."""
    if x.size != model.n_variables or not np.isfinite(x).all():
        return failed(status, iterations, f"{status} was reported, but the solution is not finite")
    outside = model.outside(x)
    if outside:
        return failed(status, iterations, f"{status} was reported, but {outside}")
    return checked_solution(model, problem, p, model.levels(x), claimed, status, iterations, model.own(x))


def accept_suboptimal(
    model: PlanModel, problem: MPCProblem, p: Array, x: Array, guess: Array | None, ended: Solution
) -> Solution:
    """A solver's last variables `x` as a solution that is not optimal, or `ended` where they are not acceptable.

    Their levels must not cost more than nothing, full level, or `guess`, the previous plan one step on (A, N).
    """
    if x.size != model.n_variables or not np.isfinite(x).all():
        return ended
    m, u, own = problem.machinery, model.levels(x), model.own(x)
    low, high = m.u_min[:, None], m.u_max[:, None]
    own_evaluation = model.evaluate(problem, p, u, own)
    if own_evaluation.broken:
        return ended
    references = [np.zeros_like(u), np.broadcast_to(high, u.shape)]
    if guess is not None and guess.shape == u.shape:
        references.append(np.clip(guess, low, high))
    evaluations = [model.evaluate(problem, p, levels, own) for levels in references]
    least = min((found.cost for found in evaluations if not found.broken), default=np.inf)
    if not own_evaluation.cost <= least + _SAME_COST * (1.0 + abs(least)):
        return failed(ended.status, ended.iterations, f"{ended.problem}, with levels dearer than without it")
    return replace(ended, ok=True, u=own_evaluation.u, optimal=False, evaluation=own_evaluation, own=model.by_name(own))


class FirstOf:
    """Solvers in the order in which they are tried: the first optimum, or else the first acceptable levels."""

    def __init__(self, solvers: Sequence[Solver]) -> None:
        self.solvers = tuple(solvers)

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance. On failure `ok` is False and `problem` has each solver's reason."""
        tried: list[Solution] = []
        for solver in self.solvers:
            tried.append(solver.solve(problem, guess))
            if tried[-1].ok and tried[-1].optimal:
                return tried[-1]
        acceptable = next((solution for solution in tried if solution.ok), None)
        reasons = "; ".join(solution.problem for solution in tried if solution.problem)
        return acceptable or replace(tried[0], problem=reasons)
