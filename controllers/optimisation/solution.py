"""What a solver is and what it gives: the protocol, and the checks that every answer passes before it is acted on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from controllers.optimisation.plan_model import Evaluation, PlanModel
from controllers.optimisation.problem import MPCProblem, ProblemShape
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
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

    `optimal` is False for levels that passed them without being the solver's optimum. `u` (A, N): levels, empty when
    not ok; `status`: solver and its own status; `problem`: reason of a failure; `gap`: how much of its cost the
    solution may at most be above the optimum of what was solved, relative; 0 where it is convex. `evaluation`: what the
    levels bring, as they are held; None when not ok. `export_calls`: calls of the exported operator that it took.
    `own`: the user's own variables (n,), by name.
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


@dataclass(frozen=True, eq=False)
class Answer:
    """What a method says: variables `x` with an objective of `claimed`, None where it ended before its optimum.

    `status`, `iterations`, `gap`: as of `Solution`. `why`: why `x` is not the optimum, '' where it is.
    """

    x: Array
    claimed: float | None
    status: str
    iterations: int
    why: str = ""
    gap: float = 0.0


class StatementSolver(ABC):
    """Solves the statement of one operator and shape; a subclass says how.

    `fallback` builds the solver that is asked where this one finds no optimum.

    Raises:
        ControllerConfigError: the problem does not fit the method, or the operator is not of these actuators.
    """

    name = ""

    def __init__(
        self, operator: BuildingOperator, shape: ProblemShape, fallback: Callable[[], Solver] | None = None
    ) -> None:
        self.model, self._fallback = PlanModel(operator, shape), fallback

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance, from `guess` (A, N) where the method starts somewhere; `Solver.solve`.

        Levels that are not the optimum must not cost more than `guess`.
        """
        p = self.model.numbers(problem)
        if not np.isfinite(p).all():
            return failed("not started", 0, "the problem holds numbers that are not finite")
        return first_of(self._solutions(problem, p, guess))

    def _solutions(self, problem: MPCProblem, p: Array, guess: Array | None) -> Iterator[Solution]:
        try:
            for answer in self._answers(p, guess):
                yield checked(self.model, problem, p, answer, guess)
        except Exception as error:  # a failed solve is a value
            yield failed(f"{self.name}:raised", 0, f"{self.name}: raised {type(error).__name__}: {error}")
        if self._fallback is not None:
            yield self._fallback().solve(problem, guess)

    @abstractmethod
    def _answers(self, p: Array, guess: Array | None) -> Iterator[Answer]:
        """What the method answers at parameters `p`; a further answer is asked for where one is not the optimum."""


def first_of(solutions: Iterable[Solution]) -> Solution:
    """The first optimum, or else the first acceptable levels, or a failure with all reasons."""
    tried: list[Solution] = []
    for solution in solutions:
        if solution.ok and solution.optimal:
            return solution
        tried.append(solution)
    acceptable = next((solution for solution in tried if solution.ok), None)
    reasons = "; ".join(dict.fromkeys(solution.problem for solution in tried))
    return acceptable or replace(tried[0], problem=reasons)


def checked(model: PlanModel, problem: MPCProblem, p: Array, answer: Answer, guess: Array | None = None) -> Solution:
    """The solution that an answer is at parameters `p`.

    Refused are variables that are not finite, or out of bounds, capacities or exclusion, and those whose objective, as
    the statement counts it mode by mode, is not what was claimed: another problem was solved. All other inequalities
    are soft, so such levels are feasible.

    Without a claim the levels must not cost more than nothing, full level, or `guess`, the previous plan one step on.
    """
    refused = failed(answer.status, answer.iterations, answer.why)
    if answer.x.size != model.n_variables or not np.isfinite(answer.x).all():
        said = f"{answer.status} was reported, but the solution is not finite"
        return refused if answer.claimed is None else replace(refused, problem=said)
    u, own = model.levels(answer.x), model.own(answer.x)
    found = model.evaluate(p, u, own)
    if answer.claimed is None:
        why = found.broken or _dearer(model, problem, p, found.cost, own, guess)
        if why:
            return replace(refused, problem=f"{answer.why}, with levels {why}")
    else:
        why = model.outside(answer.x) or found.broken
        if not why and not abs(found.cost - answer.claimed) <= _CLAIM_TOLERANCE * (1.0 + abs(found.cost)):
            why = f"of an objective of {answer.claimed:.6g} its levels cost {found.cost:.6g}"
        if why:
            return replace(refused, problem=f"{answer.status} was reported, but {why}")
    return replace(
        refused, ok=True, u=u, gap=answer.gap, optimal=not answer.why, evaluation=found, own=model.by_name(own)
    )


def _dearer(model: PlanModel, problem: MPCProblem, p: Array, cost: float, own: Array, guess: Array | None) -> str:
    low, high = problem.level_bounds
    others = [np.clip(np.zeros_like(high), low, high), high]
    if guess is not None and guess.shape == high.shape:
        others.append(np.clip(guess, low, high))
    found = [model.evaluate(p, levels, own) for levels in others]
    least = min((other.cost for other in found if not other.broken), default=np.inf)
    return "" if cost <= least + _SAME_COST * (1.0 + abs(least)) else "dearer than without it"
