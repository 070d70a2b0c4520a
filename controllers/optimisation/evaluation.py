"""What levels cost and bring, by the statement with the numbers of one operator and shape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from controllers.optimisation.problem import BOUND_TOLERANCE, MPCProblem, ProblemShape
from controllers.optimisation.statement.difference_equations import groups_of
from controllers.optimisation.statement.functions import check_of
from controllers.optimisation.statement.parameter_values import Numbers
from controllers.optimisation.statement.problem_statement import PARTS
from controllers.optimisation.statement.structure import structure_of
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.casadi_export import Buffered


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What levels `u` (A, N) cost and bring, by the statement.

    `cost`: the objective; `parts`: what it is the sum of, by name; `energy_cost` (N,), currency; `power_W` (M, N), mean
    over each step; at the end of each step `forced_K` and `slack_K` (Z, N); `running` (M, N), share of each step.
    `broken`: which limit is left by how much, or ''. `variables`: all of the programme.
    """

    u: Array
    cost: float
    parts: Mapping[str, float]
    energy_cost: Array
    power_W: Array
    forced_K: Array
    slack_K: Array
    running: Array
    broken: str
    variables: Array


class Evaluator:
    """The statement of one operator and shape, for levels that are given."""

    def __init__(self, operator: BuildingOperator, shape: ProblemShape) -> None:
        """Build its functions, or take those of another operator of the same structure.

        Raises:
            ControllerConfigError: the operator is not of these actuators, or its heat is for another lowest level.
        """
        couples = bool(shape.peak or shape.capped or shape.machinery.shared.any())
        groups = groups_of(operator, power_couples=couples)
        keys = tuple((group.zone, tuple(int(a) for a in group.actuators)) for group in groups)
        self.operator, self.shape, self.structure = operator, shape, structure_of(operator, shape, keys)
        self._numbers, self._checks = Numbers(operator, shape, groups, self.structure), check_of(self.structure)
        self._check = Buffered(self._checks.function)

    @cached_property
    def by_steps(self) -> Evaluator:
        """The same where every control step is a step of the plan."""
        by_steps = self.shape.by_steps
        if np.array_equal(self.shape.move_of_step, by_steps.move_of_step):
            return self
        return Evaluator(self.operator, by_steps)

    @property
    def own_names(self) -> tuple[str, ...]:
        """Names of the user's own variables."""
        return tuple(name.removeprefix("own ") for name in self._checks.own)

    def numbers(self, problem: MPCProblem) -> Array:
        """The parameters of an instance."""
        return self._numbers.of(problem)

    def brings(self, problem: MPCProblem, u: Array, own: Array | None = None) -> Evaluation:
        """Evaluate levels `u` (A, N), with `own` variables of the user, in an instance."""
        return self.evaluate(self.numbers(problem), u, own)

    def evaluate(self, p: Array, u: Array, own: Array | None = None) -> Evaluation:
        """Evaluate levels `u` (A, N), with `own` variables of the user, at parameters `p`."""
        given = np.zeros(sum(self._checks.own.values())) if own is None else own
        out = self._check(self._of_moves(u), given, p)
        s = self.structure
        energy, power, forced, slack, running, required = (
            value.reshape(rows, -1, order="F").copy()
            for value, rows in zip(out[1:7], (1, s.M, s.Z, s.Z, s.M, 1), strict=True)
        )
        parts = dict(zip(PARTS, map(float, out[7].ravel() + 0.0), strict=True))
        least = required.ravel()
        worst = int(np.argmin(least)) if least.size else -1
        broken = self._in_words(worst, -least[worst]) if worst >= 0 and least[worst] < -BOUND_TOLERANCE else ""
        return Evaluation(u, float(out[0][0]), parts, energy[0], power, forced, slack, running, broken, out[8].copy())

    def by_name(self, own: Array | None) -> dict[str, Array]:
        """The user's own variables by the names that the user gave them."""
        sizes = self._checks.own
        if own is None or not sizes:
            return {}
        values = np.split(np.asarray(own, dtype=np.float64), np.cumsum(list(sizes.values()))[:-1])
        return {name.removeprefix("own "): value for name, value in zip(sizes, values, strict=True)}

    def _in_words(self, number: int, by: float) -> str:
        """What of the statement is broken."""
        kind, *numbers = self._checks.required[number].split(" ")
        machinery = self.shape.machinery
        if kind == "capacity":
            return f"u asks {by:.4g} more than the capacity of {machinery.machines[int(numbers[0])]}"
        if kind == "exclusive":
            names = ", ".join(machinery.actuators[int(a)] for a in numbers)
            return f"{names} act together, but exclude one another"
        return f"{self._checks.required[number]} is broken by {by:.4g}"

    def _of_moves(self, u: Array) -> Array:
        return np.asarray(u, dtype=np.float64)[:, self.shape.first_steps].ravel(order="F")
