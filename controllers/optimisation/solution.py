"""What a solver is and what it gives: the protocol, and the checks that every answer passes before it is acted on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from controllers.optimisation.plan_model import Evaluation, PlanModel
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.programme import QPData
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator

# Two costs are the same within this share of what they consist of: of all but discomfort, of energy at full level, and
# of discomfort, beside which even at extreme weights prices are to be seen.
OF_WORTH, _OF_FULL, _OF_DISCOMFORT = 1e-4, 1e-5, 1e-10
# And within as many kelvin at the end of every step, which is what rounding leaves of a temperature.
_ROUNDING_K = 1e-12
# By how much a solver may leave bounds and rows: what that is worth, its objective may be off. Ipopt relaxes bounds by
# 1e-8 of 1 or of themselves; PIQP and HiGHS keep rows to 1e-7.
_LEAVES = 1e-7


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


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a solver; `ok` only if status, finiteness, bounds and objective passed the checks.

    `optimal` is False for levels that passed them without being shown to be the optimum; `problem` says why. `u`
    (A, N): levels, empty when not ok; `status`: solver and its own status; `problem`: reason of a failure; `gap`: how
    much of its cost the solution may at most be above the optimum for its choices, relative; 0 where it has none.
    `evaluation`: what the levels bring, as they are held; None when not ok. `variables` of
    the programme that was solved, and `parameters` of the operator in it: how many. `own`: the user's own variables
    (n,), by name.
    """

    ok: bool
    u: Array
    status: str
    iterations: int
    problem: str = ""
    gap: float = 0.0
    optimal: bool = True
    evaluation: Evaluation | None = None
    variables: int = 0
    parameters: int = 0
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
class SolverAnswer:
    """What a method says: variables `x` with an objective of `claimed`, None where it ended before its optimum.

    `status`, `iterations`, `gap`: as of `Solution`. `why`: why `x` is not the optimum, '' where it is said to be.
    `multipliers` of the equations, then of the inequalities, currency: without them it cannot be shown. `shown`:
    whether it was, in a programme of which this is a part.
    """

    x: Array
    claimed: float | None
    status: str
    iterations: int
    why: str = ""
    gap: float = 0.0
    multipliers: Array = field(default_factory=lambda: np.zeros(0))
    shown: bool = False


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
        if self._fallback is None:
            return
        try:
            yield self._fallback().solve(problem, guess)
        except Exception as error:
            yield failed("fallback:raised", 0, f"its fallback raised {type(error).__name__}: {error}")

    @abstractmethod
    def _answers(self, p: Array, guess: Array | None) -> Iterator[SolverAnswer]:
        """What the method answers at parameters `p`; a further answer is asked for where one is not the optimum."""


def first_of(solutions: Iterable[Solution]) -> Solution:
    """The first optimum, or else the acceptable levels that cost least, or a failure with all reasons."""
    tried: list[Solution] = []
    for solution in solutions:
        if solution.ok and solution.optimal:
            return solution
        tried.append(solution)
    acceptable = [solution for solution in tried if solution.ok]
    reasons = "; ".join(dict.fromkeys(solution.problem for solution in tried))
    return replace(min(acceptable, key=lambda solution: solution.cost, default=tried[0]), problem=reasons)


def checked(
    model: PlanModel, problem: MPCProblem, p: Array, answer: SolverAnswer, guess: Array | None = None
) -> Solution:
    """The solution that an answer is at parameters `p`.

    Refused are variables that are not finite, or out of bounds, capacities or exclusion, and those whose objective, as
    the statement counts it mode by mode, is not what was claimed: another problem was solved. All other inequalities
    are soft, so such levels are feasible.

    An optimum is not believed either: its multipliers must show that no levels cost less (`QPData.above_least`; where
    the problem is not convex none nearby, where it has choices none with the same). Levels that are not shown to be the
    optimum must not cost more than nothing, full level, or `guess`, the previous plan one step on.
    """
    refused = failed(answer.status, answer.iterations, answer.why)
    if answer.x.size != model.n_variables or not np.isfinite(answer.x).all():
        said = f"{answer.status} was reported, but the solution is not finite"
        return refused if answer.claimed is None else replace(refused, problem=said)
    u, own = model.levels(answer.x), model.own(p, answer.x)
    found, sizes = model.evaluate(p, u, own), _Sizes(model, problem, p)
    why = answer.why
    if answer.claimed is None:
        if found.broken:
            return replace(refused, problem=f"{why}: {found.broken}")
    else:
        nearby = model.local(p, found.variables, answer.multipliers if answer.multipliers.size else None)
        broken = model.outside(p, answer.x) or found.broken
        if not broken and not abs(found.cost - answer.claimed) <= sizes.claim(found, nearby, answer.multipliers):
            broken = f"of an objective of {answer.claimed:.6g} its levels cost {found.cost:.6g}"
        if broken:
            return replace(refused, problem=f"{answer.status} was reported, but {broken}")
        why = why or _not_shown(model, sizes, found, nearby, answer)
    if why and (gone := model.gone(own)):
        return replace(refused, problem=f"{why}: {gone}")
    # What said that it is the optimum, and is none, is one to a coarser tolerance.
    within = sizes.same(found) + (0.0 if answer.claimed is None else sizes.of_all(found))
    if why and (dearer := _dearer(model, problem, p, found.cost - within, own, guess)):
        return replace(refused, problem=f"{why}, with levels {dearer}")
    return replace(
        refused,
        ok=True,
        u=u,
        problem=why,
        gap=answer.gap,
        optimal=not why,
        evaluation=found,
        variables=model.n_variables,
        parameters=model.n_parameters,
        own=model.by_name(own),
    )


class _Sizes:
    """What the terms of an instance weigh, and so within what two of its costs are the same."""

    def __init__(self, model: PlanModel, problem: MPCProblem, p: Array) -> None:
        highest = np.repeat(problem.machinery.u_max[:, None], problem.n_steps, axis=1)
        self._full = model.evaluate(p, highest)
        self._comfort = float(problem.comfort_price.sum()) * problem.n_steps
        self._curvature = problem.weights.curvature * float((highest**2).sum())  # only makes the optimum unique

    def same(self, found: Evaluation) -> float:
        """Difference of costs that is none, currency."""
        discomfort = found.parts["discomfort"]
        others = sum(map(abs, found.parts.values())) - discomfort
        full, rounding = float(np.abs(self._full.energy_cost).sum()), _ROUNDING_K * self._comfort
        return OF_WORTH * others + _OF_FULL * full + _OF_DISCOMFORT * discomfort + rounding + self._curvature

    def claim(self, found: Evaluation, nearby: QPData, multipliers: Array) -> float:
        """What a solver's objective may differ by from the cost of its levels, currency."""
        slopes = nearby.unit * np.abs(nearby.linear).sum() + np.abs(multipliers).sum()
        return self.of_all(found) + self.same(found) + _LEAVES * float(slopes)

    @staticmethod
    def of_all(found: Evaluation) -> float:
        """A coarser difference, of all that levels cost, currency."""
        return OF_WORTH * sum(map(abs, found.parts.values()))


def _not_shown(model: PlanModel, sizes: _Sizes, found: Evaluation, nearby: QPData, answer: SolverAnswer) -> str:
    """Why an answer is not shown to be the optimum, or ''."""
    if answer.shown:
        return ""
    said = f"{answer.status} was reported, but"
    if answer.multipliers.size != nearby.b.size + nearby.low.size or not np.isfinite(answer.multipliers).all():
        return f"{said} without what shows that it is the optimum"
    if model.convex and not nearby.convex:
        return f"{said} a term is not convex, so that levels far from them may cost less"
    step = np.zeros(nearby.linear.size)
    chosen = nearby.fixed(model.choices, step[model.choices]) if model.choices.size else nearby
    above = chosen.above_least(step, answer.multipliers / nearby.unit)
    return "" if above <= sizes.same(found) else f"{said} its levels may cost {above:.3g} more than others"


def _dearer(model: PlanModel, problem: MPCProblem, p: Array, cost: float, own: Array, guess: Array | None) -> str:
    low, high = problem.level_bounds
    others = [np.clip(np.zeros_like(high), low, high), high]
    if guess is not None and guess.shape == high.shape:
        others.append(np.clip(guess, low, high))
    tried = [model.evaluate(p, levels, own) for levels in others]
    least = min((other.cost for other in tried if not other.broken), default=np.inf)
    return "" if cost <= least else "dearer than without it"
