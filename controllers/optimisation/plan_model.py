"""The statement with the numbers of one operator and shape: what levels bring, and the programme that solvers solve."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from controllers.optimisation.problem import BOUND_TOLERANCE, MPCProblem, ProblemShape
from controllers.optimisation.programme import FAR, QPData
from controllers.optimisation.statement.algebra import groups_of, structure_of
from controllers.optimisation.statement.functions import check_of, functions_of
from controllers.optimisation.statement.parameter_values import Numbers
from controllers.optimisation.statement.problem_statement import PARTS
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.casadi_export import Buffered

if TYPE_CHECKING:
    from scipy import sparse


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What levels `u` (A, N) cost and bring, by the statement.

    `cost`: the objective; `parts`: what it is the sum of, by name; `energy_cost` (N,), currency; `power_W` (M, N), mean
    over each step; at its end `forced_K` and `slack_K` (Z, N); `running` (M, N), share of each step. `broken`: which
    limit is left by how much, or ''. `variables`: all of the programme.
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

        Raises `ControllerConfigError` where the operator is not of these actuators, or its heat is for another lowest
        level.
        """
        couples = bool(shape.peak or shape.capped or shape.exchange or shape.machinery.shared.any())
        groups = groups_of(operator, len(shape.lengths), power_couples=couples)
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
        """The parameters of an instance: those of the structure, then those of gains that these do not hold."""
        return self._numbers.of(problem)

    @property
    def sees_the_meter(self) -> bool:
        """Whether it counts what all machines take together: what is bought, its peak, or what is above a cap."""
        s = self.structure
        return bool(s.peak or s.capped or s.exchange)

    def beside(self, p: Array, power_W: Array) -> Array:
        """Parameters `p` with `power_W` (N,) on the meter beside what levels take: not its energy at the machine's own
        price, which is the caller's, but what is bought above a surplus, a peak or a cap."""
        return self._numbers.beside(p, power_W)

    def brings(self, problem: MPCProblem, u: Array, own: Array | None = None) -> Evaluation:
        """Evaluate levels `u` (A, N), with `own` variables of the user, in an instance."""
        return self.evaluate(self.numbers(problem), u, own)

    def evaluate(self, p: Array, u: Array, own: Array | None = None) -> Evaluation:
        """Evaluate levels `u` (A, N), with `own` variables of the user, at parameters `p`."""
        given = np.zeros(self._n_own) if own is None else own
        moves = np.asarray(u, dtype=np.float64)[:, self.shape.first_steps].ravel(order="F")
        out = self._check(moves, given, p[: self._numbers.n_own])
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

    def slopes(self, p: Array, u: Array) -> tuple[float, Array]:
        """The cost of levels `u` (A, N) at parameters `p`, and its gradient by them (A, N), currency."""
        firsts = self.shape.first_steps
        cost, slopes = self._slope(u[:, firsts].ravel(order="F"), np.zeros(self._n_own), p[: self._numbers.n_own])
        found = np.zeros(u.shape)
        found[:, firsts] = slopes.reshape(u.shape[0], -1, order="F")
        return float(cost[0]), found

    @cached_property
    def _slope(self) -> Buffered:
        check = self._checks.function
        (u, *_), (cost, *_) = check.name_in(), check.name_out()
        return Buffered(check.factory("slope", check.name_in(), [cost, f"grad:{cost}:{u}"]))

    @property
    def _n_own(self) -> int:
        return sum(self._checks.own.values())

    def by_name(self, own: Array | None) -> dict[str, Array]:
        """The user's own variables by the names that the user gave them."""
        sizes = self._checks.own
        if own is None or not sizes:
            return {}
        values = np.split(np.asarray(own, dtype=np.float64), np.cumsum(list(sizes.values()))[:-1])
        return {name.removeprefix("own "): value for name, value in zip(sizes, values, strict=True)}

    def _in_words(self, number: int, by: float) -> str:
        kind, *numbers = self._checks.required[number].split(" ")
        machinery = self.shape.machinery
        if kind == "capacity":
            return f"u asks {by:.4g} more than the capacity of {machinery.machines[int(numbers[0])]}"
        if kind == "exclusive":
            names = ", ".join(machinery.actuators[int(a)] for a in numbers)
            return f"{names} act together, but exclude one another"
        return f"{self._checks.required[number]} is broken by {by:.4g}"


def _like(pattern: sparse.csc_matrix, values: Array) -> sparse.csc_matrix:
    """A matrix of the same pattern; a constructor's checks would take longer than all else of a programme."""
    matrix = copy(pattern)
    matrix.data = values
    return matrix


# Level from which a solve without a guess starts, as a share of the highest: the mean level of a heating season; of
# iterations only.
_START = 0.3


class PlanModel(Evaluator):
    """The statement of one operator and shape, for solvers."""

    def __init__(self, operator: BuildingOperator, shape: ProblemShape) -> None:
        """As `Evaluator`."""
        super().__init__(operator, shape)
        s, self.functions = self.structure, functions_of(self.structure)
        self._bounds, self._local = Buffered(self.functions.bounds), Buffered(self.functions.local)
        self.n_variables, self.convex, at = len(self.functions.names), self.functions.convex, self.functions.places
        self.levels_at = at["v"].reshape(s.N, s.A).T
        self._cold_at = at["cold"].reshape(s.N, len(s.signed)).T if s.signed else at["v"][:0]
        self.own_at = np.concatenate([np.zeros(0), *(at[name] for name in self._checks.own)]).astype(np.intp)
        self.choices = at.get("b", np.zeros(0, dtype=np.intp))

    @property
    def n_parameters(self) -> int:
        """Number of parameters of the operator that a programme depends on."""
        return self.operator.n_used

    def ipopt(self, options: Mapping[str, Any]) -> Buffered:
        """Ipopt on the statement as a nonlinear programme, the exported gains in it (`Functions.ipopt`)."""
        return self.functions.ipopt(options, self._numbers.hidden)

    def ipopt_parameters(self, p: Array) -> Array:
        """The parameters of `ipopt` of those of an instance."""
        n_gain = self.functions.n_gain if self._numbers.hidden else 0
        n = self._numbers.n_own
        return np.concatenate([p[: n - n_gain], p[n:]])

    def cold(self) -> Array:
        """Levels (A, N) from which a solve without a guess starts."""
        return np.repeat(_START * self.shape.machinery.u_max[:, None], self.shape.n_steps, axis=1)

    def bounds(self, p: Array) -> tuple[Array, Array]:
        """Least and largest values of the variables."""
        low, high = self._bounds(p[: self._numbers.n_own])
        return low.copy(), high.copy()

    def local(self, p: Array, x: Array | None = None, multipliers: Array | None = None) -> QPData:
        """The quadratic programme of the step from `x`, by default from 0: for a convex instance, the instance."""
        x = np.zeros(self.n_variables) if x is None else x
        n_rows = self.functions.local.size1_in(2)
        y, own = np.zeros(n_rows) if multipliers is None else multipliers, p[: self._numbers.n_own]
        f, gradient, H, equal, A, above, G = self._local(x, own, y)
        # Scaled by the largest slope, so that tolerances do not depend on the currency.
        unit, (low, high) = float(np.abs(gradient).max()) or 1.0, self.bounds(p)
        second = np.zeros(self._patterns[0].nnz)
        second[self._in_quadratic] = H / unit
        each = (second, A.copy(), G.copy())
        quadratic, A_, G_ = (_like(pattern, values) for pattern, values in zip(self._patterns, each, strict=True))
        return QPData(
            quadratic,
            gradient / unit,
            A_,
            -equal,
            G_,
            -above,
            np.full(above.size, np.inf),
            low - x,
            high - x,
            unit,
            float(f[0]),
        )

    @cached_property
    def _patterns(self) -> list[sparse.csc_matrix]:
        from scipy import sparse

        n, function = self.n_variables, self.functions.local
        patterns = [function.sparsity_out(2) + ca.Sparsity.diag(n), function.sparsity_out(4), function.sparsity_out(6)]
        out = []
        for pattern in patterns:
            columns, rows = np.array(pattern.colind()), np.array(pattern.row())
            out.append(sparse.csc_matrix((np.ones(rows.size), rows, columns), shape=pattern.shape))
        return out

    @cached_property
    def _in_quadratic(self) -> NDArray[np.intp]:
        """Where the second derivatives stand among the elements of the programme's, which hold the diagonal too."""
        pattern, n = self.functions.local.sparsity_out(2), self.n_variables
        ours = self._patterns[0]
        at = np.repeat(np.arange(n), np.diff(pattern.colind())) * n + np.array(pattern.row(), dtype=np.intp)
        return np.searchsorted(np.repeat(np.arange(n), np.diff(ours.indptr)) * n + ours.indices, at)

    def outside(self, p: Array, x: Array) -> str:
        """Which level, or variable of the user, leaves its bounds by more than a solver's tolerance, or ''."""
        levels, m = x[self.levels_at], self.shape.machinery
        off = np.maximum(levels - m.u_max[:, None], -levels).max(axis=1)
        worst = int(np.argmax(off))
        if off[worst] > BOUND_TOLERANCE:
            return f"u of {m.actuators[worst]} leaves its bounds by {off[worst]:.4g}"
        if not self.own_at.size:
            return ""
        raw, within = x[self.own_at], self.own(p, x)
        beyond = np.abs(raw - within) - BOUND_TOLERANCE * np.maximum(1.0, np.abs(within))
        worst = int(np.argmax(beyond))
        name = self.functions.names[self.own_at[worst]]
        return f"{name} leaves its bounds by {abs(raw[worst] - within[worst]):.4g}" if beyond[worst] > 0.0 else ""

    def gone(self, own: Array) -> str:
        """Which variable of the user has run away, or ''."""
        for name, values in self.by_name(own).items():
            if np.abs(values).max(initial=0.0) >= FAR:
                return f"{name} goes to {values[np.argmax(np.abs(values))]:.3g}; is there a least cost?"
        return ""

    def levels(self, x: Array) -> Array:
        """Levels u (A, N) of variables, within their bounds."""
        s, machinery = self.structure, self.shape.machinery
        moves = np.clip(x[self.levels_at], 0.0, machinery.u_max[:, None])
        if s.signed:
            moves[list(s.signed)] -= x[self._cold_at]
        for b, a in zip(x[self.choices].reshape(s.n_chosen, -1).T if s.chosen else (), s.chosen, strict=True):
            # What a solver leaves of an actuator that is off.
            moves[a, : s.n_chosen] = np.where(b > 0.5, moves[a, : s.n_chosen], 0.0)
        return np.clip(moves, machinery.u_min[:, None], machinery.u_max[:, None])[:, self.shape.move_of_step]

    def own(self, p: Array, x: Array) -> Array:
        """The user's own variables among `x`, within their bounds."""
        if not self.own_at.size:
            return np.zeros(0)
        low, high = self.bounds(p)
        return np.clip(x[self.own_at], low[self.own_at], high[self.own_at])

    def rounded(self, x: Array) -> Array:
        """Choices (in the order of `choices`) near variables in which they need not be whole."""
        s, m = self.structure, self.shape.machinery
        first, on = slice(0, s.n_chosen), np.zeros((len(s.chosen), s.n_chosen))
        for i, a in enumerate(s.chosen):
            level = x[self.levels_at[a, first]] / m.u_max[a]
            if a in s.signed:
                level = np.maximum(level, x[self._cold_at[s.signed.index(a), first]] / -m.u_min[a])
            on[i] = np.where(level >= 0.25, 1.0 + level, 0.0)
        for group in s.exclusive:
            rows = [s.chosen.index(a) for a in group]
            on[rows] = np.where(on[rows] < on[rows].max(axis=0), 0.0, on[rows])
        return np.asarray(np.minimum(on, 1.0).ravel(order="F"))
