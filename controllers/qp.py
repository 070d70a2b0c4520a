"""The convex case of the MPC problem as a sparse quadratic programme: the fast path.

A duty plan is proportional to u and the modulation m(x) does not see the decisions, so with free-state features the
problem is a quadratic programme with constant structure. PIQP (Schwan et al. 2023) solves it; Clarabel (Goulart and
Chen 2024) stands behind it. What either reports is checked by our own rollout before it counts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import sparse

from controllers.errors import ControllerConfigError
from controllers.problem import PEAK_UNIT_W, MPCProblem, ProblemShape, Solution, checked_solution
from thermoforce_mpc.operator.parameters import OperatorParameters
from thermoforce_mpc.testcase import StrictModel
from thermoforce_mpc.types import Array

QPBackend = Literal["piqp", "clarabel"]


class QPConfig(StrictModel):
    """Options of the quadratic programme."""

    backends: tuple[QPBackend, ...] = Field(
        ("piqp", "clarabel"), min_length=1, description="solvers in the order in which they are tried"
    )
    tolerance: float = Field(1e-8, gt=0, description="absolute and relative tolerance of the solvers")
    max_iterations: int = Field(100, ge=1, description="iterations before a solver is given up")


class SparsePattern:
    """A sparse matrix whose values change and whose structure does not; entries are addressed in the order given."""

    def __init__(self, rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, int]) -> None:
        order = sparse.csc_matrix((np.arange(rows.size) + 1.0, (rows, columns)), shape=shape)
        self._order = order.data.astype(np.intp) - 1
        self._matrix = order

    def filled(self, values: Array) -> sparse.csc_matrix:
        """The matrix with `values`, one per entry in the order given at construction; valid until the next call."""
        self._matrix.data[:] = values[self._order]
        return self._matrix


class QPSolver:
    """Solves `MPCProblem`s of one operator and shape.

    Variables: moves v (M), states (N·r, step by step), slack s (N), and the peak where it is priced. The states are
    the modes F, but the forced response y = Σ F stands in the place of the first: comfort then concerns one state.

    Raises:
        ControllerConfigError: the problem is not convex (levels between off and `u_max` have their own efficiency).
    """

    def __init__(self, operator: OperatorParameters, shape: ProblemShape, config: QPConfig) -> None:
        if not shape.linear_in_u(operator):
            raise ControllerConfigError(
                "solver qp: power or heat is not proportional to u in this actuation, or the gain depends on the "
                "predicted temperature, so the problem is not convex; use actuation mode duty with a model of "
                "features: free, or solver: ipopt"
            )
        self.operator, self.shape, self.config = operator, shape, config
        n, r, m = shape.n_steps, operator.order, shape.n_moves
        self._n_variables = m + n * r + n + int(shape.peak)
        states = m + np.arange(n * r).reshape(n, r)
        slack = m + n * r + np.arange(n)

        # F_k − a F_{k−1} − g d_k v_move(k) = 0 for all modes but the first, and the sum over all modes in its place,
        # y_k − a_0 y_{k−1} − Σ_j (a_j − a_0) F_j,k−1 − Σ g d_k v_move(k) = 0; F_now is on the right in the first step.
        a, g = operator.poles, operator.gains
        row = np.arange(n * r).reshape(n, r)
        move = np.repeat(shape.move_of_step, r).reshape(n, r)
        self._dynamics = SparsePattern(
            np.concatenate([row.ravel(), row[1:].ravel(), np.repeat(row[1:, 0], r - 1), row.ravel()]),
            np.concatenate([states.ravel(), states[:-1].ravel(), states[:-1, 1:].ravel(), move.ravel()]),
            (n * r, self._n_variables),
        )
        self._fixed_entries = np.concatenate([np.ones(n * r), -np.tile(a, n - 1), -np.tile(a[1:] - a[0], n - 1)])
        self._gains = np.concatenate([[g.sum()], g[1:]])

        # y_k + s_k ≥ lower_k − T_free,k and y_k − s_k ≤ upper_k − T_free,k; power rows after them.
        step = np.arange(n)
        rows = [step, n + step, step, n + step]
        columns = [states[:, 0], states[:, 0], slack, slack]
        self._bound_entries = np.concatenate([np.ones(3 * n), -np.ones(n)])
        if shape.peak:
            rows += [2 * n + step, 2 * n + step]
            columns += [np.full(n, self._n_variables - 1), shape.move_of_step]
        n_rows = (3 if shape.peak else 2) * n
        self._bounds = SparsePattern(np.concatenate(rows), np.concatenate(columns), (n_rows, self._n_variables))

        self._counts = np.bincount(shape.move_of_step, minlength=m).astype(np.float64)
        self._quadratic = sparse.csc_matrix(sparse.diags(np.ones(self._n_variables)))
        self._quadratic.data[:] = 0.0
        self._solve_with: dict[QPBackend, Callable[[_Programme], _Answer]] = {
            "piqp": _Piqp(config),
            "clarabel": _Clarabel(config),
        }

    def solve(self, problem: MPCProblem) -> Solution:
        """Solve one instance. A failure is a value: `ok` is False and `problem` says what each solver did."""
        if not problem.finite():
            return Solution(False, np.empty(0), "not started", 0, "the problem holds numbers that are not finite")
        programme = self._programme(problem)
        failures: list[str] = []
        solution = Solution(False, np.empty(0), "not started", 0, "no solver")
        for backend in self.config.backends:
            solution = self._attempt(backend, programme, problem)
            if solution.ok:
                return solution
            failures.append(f"{backend}: {solution.problem}")
        return Solution(False, np.empty(0), solution.status, solution.iterations, "; ".join(failures))

    def _attempt(self, backend: QPBackend, programme: _Programme, problem: MPCProblem) -> Solution:
        answer = self._solve_with[backend](programme)
        status = f"{backend}:{answer.status}"
        if not answer.solved:
            return Solution(False, np.empty(0), status, answer.iterations, f"ended with {answer.status}")
        x = answer.x
        u = x[: self.shape.n_moves][self.shape.move_of_step]
        claimed = float(0.5 * x @ (programme.quadratic.data * x) + programme.linear @ x)
        return checked_solution(problem, self.operator, u, claimed, status, answer.iterations)

    def _programme(self, p: MPCProblem) -> _Programme:
        """The numbers of one instance in the form min ½ x'diag(q)x + c'x, A x = b, G x ≥ / ≤, bounds."""
        n, r, m = self.shape.n_steps, self.operator.order, self.shape.n_moves
        full = np.full(n, p.u_max)
        drive = self.operator.drive(full, p.features) / p.u_max
        power_per_u = p.power_W(full) / p.u_max
        A = self._dynamics.filled(np.concatenate([self._fixed_entries, -np.outer(drive, self._gains).ravel()]))
        b = np.zeros(n * r)
        b[:r] = self.operator.poles * p.forced_state_K
        b[0] = b[:r].sum()
        entries, low, high = self._bound_entries, p.lower_C - p.T_free_C, p.upper_C - p.T_free_C
        row_low, row_high = np.concatenate([low, np.full(n, -np.inf)]), np.concatenate([np.full(n, np.inf), high])
        c = np.zeros(self._n_variables)
        c[:m] = np.bincount(self.shape.move_of_step, weights=p.price_per_W * power_per_u, minlength=m)
        # F_0 = y − Σ F_j: what the first mode is worth is y's, and is taken off the others'.
        left = p.terminal_price_per_K
        c[m + (n - 1) * r : m + n * r] = -np.concatenate([left[:1], left[1:] - left[0]])
        c[m + n * r : m + n * r + n] = p.comfort_price
        if self.shape.peak:
            entries = np.concatenate([entries, np.ones(n), -power_per_u / PEAK_UNIT_W])
            row_low = np.concatenate([row_low, np.full(n, -p.peak_so_far_W / PEAK_UNIT_W)])
            row_high = np.concatenate([row_high, np.full(n, np.inf)])
            c[-1] = p.weights.peak * PEAK_UNIT_W
        quadratic = self._quadratic
        quadratic.data[:m] = 2.0 * p.weights.curvature * self._counts
        x_low, x_high = np.zeros(self._n_variables), np.full(self._n_variables, np.inf)
        x_low[m : m + n * r] = -np.inf
        x_high[:m] = p.u_max
        return _Programme(quadratic, c, A, b, self._bounds.filled(entries), row_low, row_high, x_low, x_high)


class _Programme:
    """One quadratic programme: min ½ x'diag(q)x + c'x s.t. A x = b, l ≤ G x ≤ h, x_low ≤ x ≤ x_high."""

    def __init__(
        self,
        quadratic: sparse.csc_matrix,
        linear: Array,
        A: sparse.csc_matrix,
        b: Array,
        G: sparse.csc_matrix,
        low: Array,
        high: Array,
        x_low: Array,
        x_high: Array,
    ) -> None:
        self.quadratic, self.linear, self.A, self.b = quadratic, linear, A, b
        self.G, self.low, self.high, self.x_low, self.x_high = G, low, high, x_low, x_high


class _Answer:
    """What a solver said."""

    def __init__(self, solved: bool, x: Array, status: str, iterations: int) -> None:
        self.solved, self.x, self.status, self.iterations = solved, x, status, iterations


class _Piqp:
    """PIQP, set up once and updated with the numbers of each instance."""

    def __init__(self, config: QPConfig) -> None:
        self._config = config
        self._solver: Any = None

    def __call__(self, q: _Programme) -> _Answer:
        import piqp

        if self._solver is None:
            solver = piqp.SparseSolver()
            solver.settings.kkt_solver = piqp.KKTSolver.sparse_ldlt_eq_cond  # the fastest of its five on this structure
            solver.settings.eps_abs = solver.settings.eps_rel = self._config.tolerance
            solver.settings.eps_duality_gap_abs = solver.settings.eps_duality_gap_rel = self._config.tolerance
            solver.settings.max_iter = self._config.max_iterations
            solver.setup(q.quadratic, q.linear, q.A, q.b, q.G, q.low, q.high, q.x_low, q.x_high)
            self._solver = solver
        else:
            self._solver.update(q.quadratic, q.linear, q.A, q.b, q.G, q.low, q.high, q.x_low, q.x_high)
        status = self._solver.solve()
        result = self._solver.result
        solved = status == piqp.PIQP_SOLVED
        if not solved:
            self._solver = None  # start afresh: nothing of a failed solve is carried on
        return _Answer(solved, np.array(result.x, dtype=np.float64), str(status.name), int(result.info.iter))


class _Clarabel:
    """Clarabel, built anew for each instance: it is called only when the first solver failed."""

    def __init__(self, config: QPConfig) -> None:
        self._config = config

    def __call__(self, q: _Programme) -> _Answer:
        import clarabel

        eye = sparse.identity(q.linear.size, format="csc")
        upper = [(q.G, q.high), (-q.G, -q.low), (eye, q.x_high), (-eye, -q.x_low)]
        kept = [(matrix[np.isfinite(bound)], bound[np.isfinite(bound)]) for matrix, bound in upper]
        A = sparse.vstack([q.A, *(matrix for matrix, _ in kept)], format="csc")
        b = np.concatenate([q.b, *(bound for _, bound in kept)])
        cones = [clarabel.ZeroConeT(q.b.size), clarabel.NonnegativeConeT(b.size - q.b.size)]
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_iter = self._config.max_iterations
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self._config.tolerance
        found = clarabel.DefaultSolver(q.quadratic, q.linear, A, b, cones, settings).solve()
        status = str(found.status)
        return _Answer(status == "Solved", np.array(found.x, dtype=np.float64), status, int(found.iterations))
