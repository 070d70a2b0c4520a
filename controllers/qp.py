"""The convex case of the MPC problem as a sparse quadratic programme: the fastest solver.

With duty actuation, power and heat are proportional to u and the modulation m(x) does not depend on the decisions, so
the problem is a quadratic programme with constant structure. The r modes are eliminated: comfort depends on their sum
y = Σ F_i only, which obeys one difference equation of order r, the transfer function of the modes,

    Π_i (1 − a_i q⁻¹) y_k  =  Σ_i g_i Π_{j≠i} (1 − a_j q⁻¹) d_k u_k,        q⁻¹ y_k = y_{k−1},

with d_k = m(x_k) v(1, T_out,k). This takes one variable and one equation per step instead of r of each. Every solution
is checked by a rollout of the r modes before it is accepted.

One zone's heating and cooling: u = v − n with n ≥ 0 of its own price. An optimum with both positive does not exist
while heat and cold cost anything.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.signal import lfilter

from controllers.errors import ControllerConfigError
from controllers.problem import PEAK_UNIT_W, MPCProblem, ProblemShape, Solution, checked_solution
from controllers.qp_backends import Clarabel, Piqp, QPBackend, QPConfig, QPData, SolverResult
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.operator.rollout import driven_rollout


class SparsePattern:
    """Sparse matrix with constant structure and changing values.

    Entries are addressed in the order given; entries at the same position are summed.
    """

    def __init__(self, rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, int]) -> None:
        places, self._slot = np.unique(columns * shape[0] + rows, return_inverse=True)
        starts = np.searchsorted(places, np.arange(shape[1] + 1) * shape[0])
        self._matrix = sparse.csc_matrix((np.zeros(places.size), places % shape[0], starts), shape=shape)

    def filled(self, values: Array) -> sparse.csc_matrix:
        """The matrix with `values`, one per entry in the order given at construction; valid until the next call."""
        self._matrix.data[:] = np.bincount(self._slot, weights=values, minlength=self._matrix.data.size)
        return self._matrix


class QPSolver:
    """Solves `MPCProblem`s of one operator and shape.

    Variables: moves v (M), forced response y (N), slack s (N), peak power if it is priced, and cooling moves n (M) if
    the lowest level is below 0.

    Raises:
        ControllerConfigError: the problem is not convex (levels between off and `u_max` have their own efficiency), or
            peak power is priced where there is cooling too.
    """

    def __init__(self, operator: OperatorParameters, shape: ProblemShape, config: QPConfig) -> None:
        if not shape.linear_in_u(operator):
            raise ControllerConfigError(
                "solver qp: power or heat is not proportional to u in this actuation, or the gain depends on the "
                "predicted temperature, so the problem is not convex; use actuation mode duty with a model of "
                "feedback: false, or solver: ipopt"
            )
        self.operator, self.shape, self.config = operator, shape, config
        if shape.peak and shape.u_min < 0.0:
            raise ControllerConfigError(
                "controller.options.objective.peak_price_per_kW: not available where one plant heats and cools; use 0"
            )
        n, m = shape.n_steps, shape.n_moves
        self._cooling = slice(m + 2 * n, m + 2 * n + (m if shape.u_min < 0.0 else 0))
        self._n_variables = m + 2 * n + int(shape.peak) + (m if shape.u_min < 0.0 else 0)
        step = np.arange(n)
        response, slack = m + step, m + n + step

        denominator, self._numerator = transfer_function(operator.poles, operator.gains)
        lagged = [(lag, step[lag:], step[: n - lag]) for lag in range(min(operator.order, n - 1) + 1)]
        driven = [entry for entry in lagged if entry[0] < operator.order]
        moves_of = [shape.move_of_step] + ([m + 2 * n + shape.move_of_step] if shape.u_min < 0.0 else [])
        self._dynamics = SparsePattern(
            np.concatenate([now for _, now, _ in lagged] + [now for _ in moves_of for _, now, _ in driven]),
            np.concatenate(
                [response[then] for *_, then in lagged] + [move[then] for move in moves_of for *_, then in driven]
            ),
            (n, self._n_variables),
        )
        self._response_entries = np.concatenate([np.full(now.size, denominator[lag]) for lag, now, _ in lagged])
        self._driven_lags = [lag for lag, *_ in driven]
        # The first r equations contain the free decay of the initial modes.
        faded = operator.poles ** np.arange(1, min(operator.order, n) + 1)[:, None]
        self._begin = lfilter(denominator, [1.0], faded, axis=0)
        self._kept = operator.gains * operator.poles ** (n - 1 - step)[:, None]

        # y_k + s_k ≥ lower_k − T_free,k and y_k − s_k ≤ upper_k − T_free,k; power rows after them.
        rows = [step, n + step, step, n + step]
        columns = [response, response, slack, slack]
        self._bound_entries = np.concatenate([np.ones(3 * n), -np.ones(n)])
        if shape.peak:
            rows += [2 * n + step, 2 * n + step]
            columns += [np.full(n, self._n_variables - 1), shape.move_of_step]
        n_rows = (3 if shape.peak else 2) * n
        self._bounds = SparsePattern(np.concatenate(rows), np.concatenate(columns), (n_rows, self._n_variables))

        self._x_low, self._x_high = np.zeros(self._n_variables), np.full(self._n_variables, np.inf)
        self._x_low[response] = -np.inf
        self._x_high[:m] = shape.u_max
        self._x_high[self._cooling] = -shape.u_min
        self._counts = np.bincount(shape.move_of_step, minlength=m).astype(np.float64)
        self._quadratic = sparse.csc_matrix(sparse.diags(np.ones(self._n_variables)))
        self._solve_with: dict[QPBackend, Callable[[QPData], SolverResult]] = {
            "piqp": Piqp(config),
            "clarabel": Clarabel(config),
        }

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance; `guess` is not used. On failure `ok` is False and `problem` has each solver's reason."""
        if not problem.finite():
            return Solution(False, np.empty(0), "not started", 0, "the problem holds numbers that are not finite")
        drive = self.operator.drive(np.full(self.shape.n_steps, problem.u_max), problem.features) / problem.u_max
        qp_data = self._qp_data(problem, drive)
        failures: list[str] = []
        solution = Solution(False, np.empty(0), "not started", 0, "no solver")
        for backend in self.config.backends:
            solution = self._attempt(backend, qp_data, problem, drive)
            if solution.ok:
                return solution
            failures.append(f"{backend}: {solution.problem}")
        return Solution(False, np.empty(0), solution.status, solution.iterations, "; ".join(failures))

    def _attempt(self, backend: QPBackend, qp_data: QPData, problem: MPCProblem, drive: Array) -> Solution:
        try:
            answer = self._solve_with[backend](qp_data)
        except Exception as error:  # on any exception the next solver is tried
            return Solution(False, np.empty(0), f"{backend}:raised", 0, f"raised {type(error).__name__}: {error}")
        status = f"{backend}:{answer.status}"
        if not answer.solved:
            return Solution(False, np.empty(0), status, answer.iterations, f"ended with {answer.status}")
        moves = answer.x[: self.shape.n_moves]
        if self.shape.u_min < 0.0:
            moves = moves - answer.x[self._cooling]
        u = moves[self.shape.move_of_step]
        claimed = qp_data.objective(answer.x)

        def modes_of(u: Array) -> Array:
            return driven_rollout(self.operator, problem.forced_state_K, drive * u)

        return checked_solution(problem, modes_of, u, claimed, status, answer.iterations)

    def _qp_data(self, p: MPCProblem, drive: Array) -> QPData:
        """The numbers of one instance; `drive` (N,) is m(x)·v of each step at u = 1."""
        n, m, operator = self.shape.n_steps, self.shape.n_moves, self.operator
        moves = slice(0, m)
        power_per_u = p.power_W(np.full(n, p.u_max)) / p.u_max
        driven = [-self._numerator[lag] * drive[: n - lag] for lag in self._driven_lags]
        if self.shape.u_min < 0.0:
            driven += [-entries for entries in driven]
        A = self._dynamics.filled(np.concatenate([self._response_entries, *driven]))
        b = np.zeros(n)
        b[: self._begin.shape[0]] = self._begin @ p.forced_state_K
        # Terminal value of the heat added by the moves.
        left = p.terminal_price_per_K
        kept = self._kept @ left * drive
        linear = np.zeros(self._n_variables)
        linear[moves] = np.bincount(self.shape.move_of_step, weights=p.price_per_W * power_per_u - kept, minlength=m)
        linear[m + n : m + 2 * n] = p.comfort_price
        if self.shape.u_min < 0.0:
            cost = p.cooling_cost_per_u + kept
            linear[self._cooling] = np.bincount(self.shape.move_of_step, weights=cost, minlength=m)
        low, high, unbounded = p.lower_C - p.T_free_C, p.upper_C - p.T_free_C, np.full(n, np.inf)
        row_low, row_high = np.concatenate([low, -unbounded]), np.concatenate([unbounded, high])
        entries = self._bound_entries
        if self.shape.peak:
            entries = np.concatenate([entries, np.ones(n), -power_per_u / PEAK_UNIT_W])
            row_low = np.concatenate([row_low, np.full(n, -p.peak_so_far_W / PEAK_UNIT_W)])
            row_high = np.concatenate([row_high, unbounded])
            linear[-1] = p.weights.peak * PEAK_UNIT_W
        curvature = np.zeros(self._n_variables)
        curvature[moves] = 2.0 * p.weights.curvature * self._counts
        if self.shape.u_min < 0.0:
            curvature[self._cooling] = curvature[moves]
        # Scale by the largest linear coefficient, so that tolerances do not depend on the currency.
        unit = float(np.abs(linear).max()) or 1.0
        self._quadratic.data[:] = curvature / unit
        constant = -float(left @ (operator.poles**n * p.forced_state_K))  # independent of the moves
        return QPData(
            self._quadratic, linear / unit, A, b, self._bounds.filled(entries), row_low, row_high,
            self._x_low, self._x_high, unit, constant,
        )  # fmt: skip


def transfer_function(poles: Array, gains: Array) -> tuple[Array, Array]:
    """Σ g_i / (1 − a_i q⁻¹) over a common denominator.

    Args:
        poles: a_i, shape (r,).
        gains: g_i, shape (r,).

    Returns:
        Coefficients of 1, q⁻¹, q⁻² … of the denominator, shape (r + 1,), and of the numerator, shape (r,).
    """
    numerator = sum(gain * np.atleast_1d(np.poly(np.delete(poles, i))) for i, gain in enumerate(gains))
    return np.asarray(np.poly(poles), dtype=np.float64), np.asarray(numerator, dtype=np.float64)
