"""HiGHS (Huangfu and Hall 2018): programmes that are linear, or linear but for choices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from controllers.optimisation.programme import QPData
from controllers.optimisation.solvers.qp import SolverResult
from thermoforce_mpc.data import HOUR_S, Array, steps_in
from thermoforce_mpc.scenario.settings import StrictModel

# Largest factor of the objective. HiGHS takes a reduced cost of 1e-7 as none: beside a weight of comfort that is large
# it ignores prices and calls that optimal, so the objective is scaled until the least of its numbers is 1.
_MOST_SCALE = 2.0**24
# By how much rows may be left: what that saves, a weight of comfort multiplies. 1e-10 is the least that HiGHS takes.
_TOLERANCE = 1e-9

# Relative gap to the bound of a programme with choices: a thousandth of what a plan costs, forecasts miss far more.
GAP = 1e-3


class MilpConfig(StrictModel):
    """Options of the mixed-integer programme."""

    hours: float = Field(1.0, gt=0, description="first part of the horizon in which choices are decided, h")
    gap: float = Field(GAP, ge=0, description="relative gap to the bound at which the solver stops")
    # Choices are made anew a quarter of an hour later, so that a good plan now is worth more than the best.
    max_seconds: float = Field(2.0, gt=0, description="time after which the best plan so far is taken, s")

    def chosen_steps(self, step_s: float) -> int:
        """Number of steps of `step_s` seconds in which choices are decided, at least one."""
        return steps_in(self.hours * HOUR_S, step_s)


class Highs:
    """HiGHS on programmes without their quadratic term."""

    def __init__(self, config: MilpConfig) -> None:
        limits = {"time_limit": config.max_seconds, "mip_rel_gap": config.gap}
        exact = dict.fromkeys(("primal_feasibility_tolerance", "mip_feasibility_tolerance"), _TOLERANCE)
        self._options: dict[str, Any] = {"output_flag": False, **exact, **limits}

    def __call__(self, q: QPData, choices: NDArray[np.intp], start: Array | None = None) -> SolverResult:
        """Solve one programme in which the columns `choices` are whole, from `start` (all columns) if given.

        `x` is empty without a plan; at the time limit it is one that is not `solved`. `multipliers` of the equations,
        then of G, without choices; `bound` with choices.
        """
        costs = np.abs(q.linear[q.linear != 0.0])
        scale = min(1.0 / costs.min(), _MOST_SCALE / costs.max()) if costs.size else 1.0
        solver = self._run(self._model(q, choices, scale), start, 1)
        if str(solver.getModelStatus().name) == "kNotset":
            # The process has used HiGHS with another number of threads, which stays as it is.
            solver = self._run(self._model(q, choices, scale), start, 0)
        info, solution, word = (
            solver.getInfo(),
            solver.getSolution(),
            solver.modelStatusToString(solver.getModelStatus()),
        )
        feasible = solver.solutionStatusToString(info.primal_solution_status) == "Feasible"
        x = np.array(solution.col_value) if feasible else np.empty(0)
        multipliers, bound = np.zeros(0), -np.inf
        if choices.size:
            bound = float(info.mip_dual_bound) / scale
        elif solution.dual_valid:
            multipliers = -np.array(solution.row_dual) / scale
        return SolverResult(word == "Optimal", x, word, int(info.simplex_iteration_count), multipliers, bound)

    def _run(self, model: Any, start: Array | None, threads: int) -> Any:
        import highspy

        solver = highspy.Highs()
        for name, value in {"threads": threads, **self._options}.items():
            solver.setOptionValue(name, value)
        solver.passModel(model)
        if start is not None:
            begin = highspy.HighsSolution()
            begin.col_value = list(start)
            solver.setSolution(begin)
        solver.run()
        return solver

    def _model(self, q: QPData, choices: NDArray[np.intp], scale: float) -> Any:
        import highspy
        from scipy import sparse

        rows, model = sparse.vstack([q.A, q.G], format="csc"), highspy.HighsLp()
        model.num_row_, model.num_col_ = rows.shape
        model.col_cost_, model.col_lower_, model.col_upper_ = scale * q.linear, q.x_low, q.x_high
        model.row_lower_, model.row_upper_ = np.concatenate([q.b, q.low]), np.concatenate([q.b, q.high])
        model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
        model.a_matrix_.start_, model.a_matrix_.index_, model.a_matrix_.value_ = rows.indptr, rows.indices, rows.data
        if choices.size:
            kinds = [highspy.HighsVarType.kContinuous] * q.linear.size
            for column in choices:
                kinds[column] = highspy.HighsVarType.kInteger
            model.integrality_ = kinds
        return model
