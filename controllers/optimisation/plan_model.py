"""The statement with the numbers of one operator and shape: what solvers solve, and what every answer is checked by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from controllers.optimisation.functions import functions_of
from controllers.optimisation.numbers import Numbers
from controllers.optimisation.problem import BOUND_TOLERANCE, MPCProblem, ProblemShape
from controllers.optimisation.qp_backends import QPData
from controllers.optimisation.structure import structure_of
from controllers.optimisation.transfer import groups_of
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.casadi_export import Buffered

# What a machine's share of running and the times that make it up can be at most; a bound that must not be active.
_MOST_RUNNING = 2.0


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What levels `u` (A, N) cost and bring, by the statement.

    `cost`: the objective; `energy_cost` (N,), currency; `power_W` (M, N), mean over each step; at the end of each step
    `forced_K` and `slack_K` (Z, N); `running` (M, N), share of each step. `broken`: which limit is left by how much,
    or ''. `values`: variables of the programme over the steps, by name.
    """

    u: Array
    cost: float
    energy_cost: Array
    power_W: Array
    forced_K: Array
    slack_K: Array
    running: Array
    broken: str
    values: Mapping[str, Array]


class PlanModel:
    """The statement of one operator and shape."""

    def __init__(self, operator: BuildingOperator, shape: ProblemShape) -> None:
        """Build its functions, or take those of another operator of the same structure.

        Raises:
            ControllerConfigError: the operator is not of these actuators, or its heat is for another lowest level.
        """
        machinery = shape.machinery
        couples = bool(shape.peak or shape.capped or machinery.shared.any())
        groups = groups_of(operator, power_couples=couples)
        keys = tuple((group.zone, tuple(int(a) for a in group.actuators)) for group in groups)
        self.structure = s = structure_of(operator, shape, keys)
        self.operator, self.shape, self.functions = operator, shape, functions_of(s)
        self.variables, self._numbers = self.functions.variables, Numbers(operator, shape, groups, s)
        self.n_variables, self.convex = len(self.variables.names), self.variables.convex
        self._local, self._check = Buffered(self.functions.local), Buffered(self.functions.check)
        at = self.variables.places
        low, high = np.full(self.n_variables, -np.inf), np.full(self.n_variables, np.inf)
        for name in set(at) - {"y", "drive", "inside"}:
            low[at[name]] = 0.0
        for name in {"runs", "theta", "excess"} & set(at):
            high[at[name]] = _MOST_RUNNING
        for name, (least, most) in self.variables.own.items():
            low[at[name]], high[at[name]] = least, most
        self.levels_at = at["v"].reshape(s.n_moves, s.A).T
        high[self.levels_at] = machinery.u_max[:, None]
        if s.signed:
            self._cold_at = at["cold"].reshape(s.n_moves, len(s.signed)).T
            high[self._cold_at] = -machinery.u_min[list(s.signed)][:, None]
        self.own_at = np.concatenate([np.zeros(0), *(at[name] for name in self.variables.own)]).astype(np.intp)
        self.choices = at.get("b", np.zeros(0, dtype=np.intp))
        high[self.choices] = 1.0
        self.x_low, self.x_high = low, high

    @property
    def held_steps(self) -> int | None:
        """Number of first steps in which levels are held, as it is solved; None: nothing is ever held."""
        m = self.shape.machinery
        return (self.shape.n_held if self.structure.chosen else 0) if m.held.any() or m.exclusive else None

    def numbers(self, problem: MPCProblem) -> Array:
        """The parameters of an instance as it is solved: relaxed after the first moves."""
        return self._numbers.of(problem, self.held_steps)

    def held_numbers(self, problem: MPCProblem) -> Array:
        """The parameters of an instance in which levels are held in all steps."""
        return self._numbers.of(problem, None)

    def evaluate(self, problem: MPCProblem, p: Array, u: Array, own: Array | None = None) -> Evaluation:
        """Evaluate levels `u` (A, N), with `own` variables of the user, at parameters `p`."""
        given = np.zeros(self.own_at.size) if own is None else own
        out = self._check(np.asarray(u, dtype=np.float64).ravel(order="F"), given, p)
        s = self.structure
        energy, power, forced, slack, running, required = (
            value.reshape(rows, -1, order="F").copy()
            for value, rows in zip(out[1:7], (1, s.M, s.Z, s.Z, s.M, 1), strict=True)
        )
        values = {
            name: value.reshape(self.functions.check.size_out(7 + i), order="F").copy()
            for i, (name, value) in enumerate(zip(self.variables.values, out[7:], strict=True))
        }
        least = required.ravel()
        worst = int(np.argmin(least)) if least.size else -1
        broken = self._in_words(worst, -least[worst]) if worst >= 0 and least[worst] < -BOUND_TOLERANCE else ""
        return Evaluation(u, float(out[0][0]), energy[0], power, forced, slack, running, broken, values)

    def _in_words(self, number: int, by: float) -> str:
        """What of the statement is broken."""
        kind, *numbers = self.variables.required[number].split(" ")
        machinery = self.shape.machinery
        if kind == "capacity":
            return f"u asks {by:.4g} more than the capacity of {machinery.machines[int(numbers[0])]}"
        if kind == "exclusive":
            names = ", ".join(machinery.actuators[int(a)] for a in numbers)
            return f"{names} act together, but exclude one another"
        return f"{self.variables.required[number]} is broken by {by:.4g}"

    def costs(self, p: Array, candidates: Array) -> Array:
        """Objective of levels (..., A, N), currency, infinite where a limit is left, (...,)."""
        flat = np.asarray(candidates, dtype=np.float64).reshape(-1, self.structure.A, self.structure.N)
        costs = np.empty(len(flat))
        for i, u in enumerate(flat):
            out = self._check(u.ravel(order="F"), np.zeros(0), p)
            costs[i] = out[0][0] if not out[6].size or out[6].min() >= -BOUND_TOLERANCE else np.inf
        return costs.reshape(candidates.shape[:-2])

    def bounds(self, p: Array) -> tuple[Array, Array]:
        """Least and largest values of the variables."""
        low, high = self.x_low.copy(), self.x_high.copy()
        lower, upper, T_free = (self._numbers.part(p, name) for name in ("lower", "upper", "T_free"))
        inside = self.variables.places["inside"]
        low[inside], high[inside] = lower - T_free, np.maximum(upper, lower) - T_free
        return low, high

    def local(self, p: Array, x: Array | None = None, multipliers: Array | None = None) -> QPData:
        """The quadratic programme of the step from `x`, by default from 0: for a convex instance, the instance."""
        x = np.zeros(self.n_variables) if x is None else x
        n_rows = self.functions.local.size1_in(2)
        f, gradient, H, equal, A, above, G = self._local(x, p, np.zeros(n_rows) if multipliers is None else multipliers)
        # Scaled by the largest slope, so that tolerances do not depend on the currency.
        unit, (low, high) = float(np.abs(gradient).max()) or 1.0, self.bounds(p)
        quadratic, A_, G_ = (pattern.copy() for pattern in self._patterns)
        quadratic.data, A_.data, G_.data = H / unit, A.copy(), G.copy()
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
        out = []
        for i in (2, 4, 6):
            pattern = self.functions.local.sparsity_out(i)
            columns, rows = np.array(pattern.colind()), np.array(pattern.row())
            out.append(sparse.csc_matrix((np.ones(rows.size), rows, columns), shape=pattern.shape))
        return out

    def outside(self, x: Array) -> str:
        """Which level of variables leaves its bounds by more than a solver's tolerance, or ''."""
        levels = x[self.levels_at]
        off = np.maximum(levels - self.shape.machinery.u_max[:, None], -levels).max(axis=1)
        worst = int(np.argmax(off))
        name = self.shape.machinery.actuators[worst]
        return f"u of {name} leaves its bounds by {off[worst]:.4g}" if off[worst] > BOUND_TOLERANCE else ""

    def levels(self, x: Array) -> Array:
        """Levels u (A, N) of variables, within their bounds."""
        s, machinery = self.structure, self.shape.machinery
        moves = np.clip(x[self.levels_at], 0.0, machinery.u_max[:, None])
        if s.signed:
            moves[list(s.signed)] -= x[self._cold_at]
        for b, a in zip(x[self.choices].reshape(s.n_chosen, -1).T if s.chosen else (), s.chosen, strict=True):
            # What a solver leaves of an actuator that is off, or lacks of its lowest level.
            lowest = machinery.lowest_level[a] if a in s.held else -np.inf
            moves[a, : s.n_chosen] = np.where(b > 0.5, np.maximum(moves[a, : s.n_chosen], lowest), 0.0)
        return np.clip(moves, machinery.u_min[:, None], machinery.u_max[:, None])[:, list(s.move_of_step)]

    def own(self, x: Array) -> Array:
        """The user's own variables among `x`."""
        return x[self.own_at]

    def start(self, problem: MPCProblem, p: Array, u: Array, own: Array | None = None) -> Array:
        """All variables for the first levels of each move of `u` (A, N)."""
        s, at = self.structure, self.variables.places
        u = u[:, s.first_steps][:, list(s.move_of_step)]
        evaluation, x = self.evaluate(problem, p, u, own), np.zeros(self.n_variables)
        for name, value in evaluation.values.items():
            by_steps = name in ("y", "drive", "inside", "below", "above", "over", "peak")
            columns = value if by_steps else value[:, s.first_steps[: s.n_chosen] if name == "b" else s.first_steps]
            if name in at:
                x[at[name]] = _in_order(name, columns, at[name].size)
        x[self.own_at] = 0.0 if own is None else own
        return x

    def rounded(self, x: Array) -> Array:
        """Choices (in the order of `choices`) near variables in which they need not be whole."""
        s, m = self.structure, self.shape.machinery
        first, on = slice(0, s.n_chosen), np.zeros((len(s.chosen), s.n_chosen))
        for i, a in enumerate(s.chosen):
            level = x[self.levels_at[a, first]] / m.u_max[a]
            if a in s.signed:
                level = np.maximum(level, x[self._cold_at[s.signed.index(a), first]] / -m.u_min[a])
            lowest = m.lowest_level[a] / m.u_max[a] if a in s.held else 0.5
            on[i] = np.where(level >= 0.5 * lowest, 1.0 + level, 0.0)
        for group in s.exclusive:
            rows = [s.chosen.index(a) for a in group]
            on[rows] = np.where(on[rows] < on[rows].max(axis=0), 0.0, on[rows])
        return np.asarray(np.minimum(on, 1.0).ravel(order="F"))


def _in_order(name: str, columns: Array, size: int) -> Array:
    """Values in the order of their variables: row after row where a name stands for several variables."""
    by_rows = name in ("runs", "theta", "excess")
    return (columns if by_rows else columns.T).ravel()[:size]
