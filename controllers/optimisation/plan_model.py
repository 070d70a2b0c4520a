"""The programme that solvers solve: the statement with the numbers of one operator and shape."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse

from controllers.optimisation.evaluation import Evaluator
from controllers.optimisation.problem import BOUND_TOLERANCE, ProblemShape
from controllers.optimisation.solvers.qp_backends import QPData
from controllers.optimisation.statement.functions import functions_of
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.casadi_export import Buffered

# Level from which a solve without a guess starts, as a share of the highest.
_START = 0.3


class PlanModel(Evaluator):
    """The statement of one operator and shape, for solvers."""

    def __init__(self, operator: BuildingOperator, shape: ProblemShape) -> None:
        """Build its functions, or take those of another operator of the same structure.

        Raises:
            ControllerConfigError: the operator is not of these actuators, or its heat is for another lowest level.
        """
        super().__init__(operator, shape)
        s, self.functions = self.structure, functions_of(self.structure)
        self._bounds, self._local = Buffered(self.functions.bounds), Buffered(self.functions.local)
        self.n_variables, self.convex, at = len(self.functions.names), self.functions.convex, self.functions.places
        self.levels_at = at["v"].reshape(s.N, s.A).T
        self._cold_at = at["cold"].reshape(s.N, len(s.signed)).T if s.signed else at["v"][:0]
        self.own_at = np.concatenate([np.zeros(0), *(at[name] for name in self._checks.own)]).astype(np.intp)
        self.choices = at.get("b", np.zeros(0, dtype=np.intp))

    def cold(self) -> Array:
        """Levels (A, N) from which a solve without a guess starts."""
        return np.repeat(_START * self.shape.machinery.u_max[:, None], self.shape.n_steps, axis=1)

    def bounds(self, p: Array) -> tuple[Array, Array]:
        """Least and largest values of the variables."""
        low, high = self._bounds(p)
        return low.copy(), high.copy()

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
            # What a solver leaves of an actuator that is off.
            moves[a, : s.n_chosen] = np.where(b > 0.5, moves[a, : s.n_chosen], 0.0)
        return np.clip(moves, machinery.u_min[:, None], machinery.u_max[:, None])[:, self.shape.move_of_step]

    def own(self, x: Array) -> Array:
        """The user's own variables among `x`."""
        return x[self.own_at]

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
