"""Sparse quadratic programmes and PIQP, which solves them (Schwan et al. 2023)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import Field
from scipy import sparse

from thermoforce_mpc.data import Array
from thermoforce_mpc.scenario.settings import StrictModel


class QPConfig(StrictModel):
    """Options of PIQP."""

    tolerance: float = Field(1e-7, gt=0, description="absolute and relative tolerance")
    max_iterations: int = Field(100, ge=1, description="iterations before a solve counts as failed")


@dataclass(frozen=True)
class QPData:
    """One quadratic programme: min ½ x'Qx + c'x s.t. A x = b, low ≤ G x ≤ high, x_low ≤ x ≤ x_high.

    The objective in currency is `unit` times this one plus `constant`.
    """

    quadratic: sparse.csc_matrix
    linear: Array
    A: sparse.csc_matrix
    b: Array
    G: sparse.csc_matrix
    low: Array
    high: Array
    x_low: Array
    x_high: Array
    unit: float
    constant: float

    def objective(self, x: Array, *, with_quadratic: bool = True) -> float:
        """Objective at `x` including the constant, currency; NaN where `x` is of another size."""
        if x.size != self.linear.size:
            return float("nan")
        bend = 0.5 * x @ (self.quadratic @ x) if with_quadratic else 0.0
        return self.constant + self.unit * float(bend + self.linear @ x)


@dataclass(frozen=True)
class SolverResult:
    """Result of a solver of programmes; `solved`: `x` is its optimum. `bound`: lower bound of the linear objective."""

    solved: bool
    x: Array
    status: str
    iterations: int
    multipliers: Array = field(default_factory=lambda: np.zeros(0))
    bound: float = -np.inf


class Piqp:
    """PIQP, set up once and updated with the numbers of each instance."""

    def __init__(self, config: QPConfig) -> None:
        self._config = config
        self._solver: Any = None

    def __call__(self, q: QPData) -> SolverResult:
        """Solve one programme; all programmes share the structure. `multipliers` of the equations, then of G."""
        import piqp

        solver, self._solver = self._solver, None  # after a failed solve the solver is set up again
        if solver is None:
            solver = piqp.SparseSolver()
            settings = solver.settings
            settings.kkt_solver = piqp.KKTSolver.sparse_ldlt  # the fastest of its five on this structure
            # K, shares and prices relative to the largest are already well scaled.
            settings.preconditioner_iter = 0
            # Longer steps towards the bounds than the default 0.99 save an iteration.
            settings.tau = 0.999
            # Residuals of the difference equation accumulate over the rows, so they need a tighter tolerance.
            settings.reg_lower_limit = 1e-8
            settings.reg_finetune_lower_limit = 1e-10
            settings.eps_abs = settings.eps_rel = self._config.tolerance
            settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = self._config.tolerance
            settings.max_iter = self._config.max_iterations
            solver.setup(q.quadratic, q.linear, q.A, q.b, q.G, q.low, q.high, q.x_low, q.x_high)
        else:
            solver.update(
                P=q.quadratic, c=q.linear, A=q.A, b=q.b, G=q.G, h_l=q.low, h_u=q.high, x_l=q.x_low, x_u=q.x_high
            )
        status = solver.solve()
        result = solver.result
        solved = status == piqp.PIQP_SOLVED
        if solved:
            self._solver = solver
        multipliers = np.concatenate([result.y, result.z_u - result.z_l])
        x = np.array(result.x, dtype=np.float64)
        return SolverResult(solved, x, str(status.name), int(result.info.iter), multipliers)
