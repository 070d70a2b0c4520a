"""The statement as a nonlinear programme, solved by Ipopt (Wächter and Biegler 2006): the reference."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from pydantic import Field

from controllers.optimisation.problem import ProblemShape
from controllers.optimisation.solution import SolverAnswer, StatementSolver
from controllers.optimisation.solvers.highs import GAP, Highs, MilpConfig
from controllers.optimisation.solvers.qp import Piqp, QPConfig
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.scenario.settings import StrictModel

# Statuses with which Ipopt reports an optimum, to its tolerance or to a looser one; any other is a failed solve.
_OPTIMAL, _ACCEPTED = "Solve_Succeeded", {"Solve_Succeeded", "Solved_To_Acceptable_Level"}
# Of the last try.
_CAREFUL = {"mehrotra_algorithm": "no"}
# From an optimum with its multipliers: nothing is pushed away from its bound.
_PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
_FROM_OPTIMUM = {
    **_CAREFUL,
    "warm_start_init_point": "yes",
    **{f"warm_start_{push}": 1e-12 for push in _PUSHES},
    "mu_strategy": "monotone",
}
# One iteration from there is usual, and four were the most of three instances of each case of
# `tests/support/problems/structures.py` (2026-11-29); who needs more begins better elsewhere.
_FEW = 5


class IpoptConfig(StrictModel):
    """Options of Ipopt."""

    # From a guess twelve are usual.
    max_iterations: int = Field(200, ge=1, description="iterations before a solve counts as failed")
    # Ipopt's own default tolerance.
    tolerance: float = Field(1e-8, gt=0, description="Ipopt's overall tolerance")
    # A third of `DeadlineConfig.solve_s`: there is time for a second try.
    max_seconds: float = Field(20.0, gt=0, description="wall time before a solve counts as failed, s")


class IpoptSolver(StatementSolver):
    """By Ipopt. Where the problem is convex, it starts from the optimum and multipliers that PIQP finds.

    Otherwise, or where that fails, from the guess; where that fails too, cold, with a line search.

    Choices between off and on are relaxed, rounded, and solved again as they are then: good, but not the best of all.
    Beside a weight of comfort that is extreme, Ipopt, which scales its objective down, ends above the optimum of convex
    instances: there HiGHS, which leaves the curvature out, has the last word.
    """

    name = "ipopt"

    def __init__(self, operator: BuildingOperator, shape: ProblemShape, config: IpoptConfig) -> None:
        super().__init__(operator, shape)
        self._options: dict[str, Any] = {
            "print_level": 0,
            "sb": "yes",
            "max_iter": config.max_iterations,
            "tol": config.tolerance,
            "max_wall_time": config.max_seconds,
            # Predictor and corrector without a line search: fewer iterations where the problem is convex.
            "mehrotra_algorithm": "yes" if self.model.convex else "no",
            "mu_strategy": "adaptive",
            # Below the tolerance; less makes the system singular, and the last steps restore what that costs.
            "mu_min": 0.1 * config.tolerance,
            "min_refinement_steps": 0,
        }
        if not shape.terms:
            # For its scaling MUMPS orders by pairs of pivots: a factorisation of five rooms takes 2.4 times as long, at
            # the same iterations (`python -m benchmarks.speed`, row five, 2026-11-28). Rows of a user may need it.
            self._options["mumps_scaling"] = 0
        few = {"mu_init": self._options["mu_min"], "max_iter": min(config.max_iterations, _FEW)}
        self._near = {**self._options, **_FROM_OPTIMUM, **few}
        # Convex without choices: other solvers can begin it and have the last word.
        self._piqp = Piqp(QPConfig()) if self.model.convex and not self.model.choices.size else None
        self.programme  # noqa: B018 - built once

    @property
    def programme(self) -> ca.Function:
        """What Ipopt is given: CasADi's solver with its functions `nlp_f`, `nlp_g` and their derivatives."""
        return self.model.ipopt(self._options if self._piqp is None else self._near).function

    def _answers(self, p: Array, guess: Array | None) -> Iterator[SolverAnswer]:
        cold, answers = self.model.cold(), []
        if (answer := self._from_optimum(p)) is not None:
            answers.append(answer)
            yield answer
        for start, options in ((cold if guess is None else guess, self._options), (cold, self._options | _CAREFUL)):
            answers.append(self._answer(p, start, options))
            yield answers[-1]
        if self._piqp is not None and any(answer.claimed is not None for answer in answers):
            programme = self.model.local(p)
            found = Highs(MilpConfig())(programme, self.model.choices)
            why, claimed = "" if found.solved else f"HiGHS ended with {found.status}", programme.objective(found.x)
            multipliers = programme.unit * found.multipliers
            yield SolverAnswer(
                found.x, claimed, f"highs:{found.status}", found.iterations, why, multipliers=multipliers
            )

    def _from_optimum(self, p: Array) -> SolverAnswer | None:
        """Its answer from the optimum that PIQP finds; None where there is none."""
        if self._piqp is None:
            return None
        programme, (low, high) = self.model.local(p), self.model.bounds(p)
        try:
            found = self._piqp(programme)
        except Exception:  # whatever it raises, there are other beginnings
            return None
        if not found.solved:
            return None
        of_rows, of_bounds = found.multipliers, -programme.reduced_costs(found.x, found.multipliers)
        begin = {"lam_g0": programme.unit * of_rows, "lam_x0": programme.unit * of_bounds}
        return self._ipopt(p, np.clip(found.x, low, high), low, high, self._near, begin)

    def _answer(self, p: Array, start: Array, options: Mapping[str, Any]) -> SolverAnswer:
        """Its answer from levels (A, N)."""
        model, (low, high) = self.model, self.model.bounds(p)
        begin = self._ipopt(p, model.evaluate(p, start).variables, low, high, options)
        if not (model.choices.size and begin.claimed is not None):
            return begin
        low[model.choices] = high[model.choices] = model.rounded(begin.x)
        found = self._ipopt(p, np.clip(begin.x, low, high), low, high, options)
        found = replace(found, iterations=begin.iterations + found.iterations)
        if found.claimed is None or found.why:
            return found
        gap = max(found.claimed - begin.claimed, 0.0) / max(abs(found.claimed), 1e-9)
        if gap <= GAP:
            return replace(found, gap=gap)
        why = f"its choices are rounded, {100.0 * gap:.1f} % above what they cost where they need not be whole"
        return replace(found, why=why, gap=gap)

    def _ipopt(
        self, p: Array, x: Array, low: Array, high: Array, options: Mapping[str, Any], begin: Mapping[str, Array] = {}
    ) -> SolverAnswer:
        """From `x`, and multipliers to `begin` with by CasADi's names."""
        n_rows, n_equal = self.model.functions.rows.size1_out(1), self.model.functions.n_equal
        upper = np.full(n_rows, np.inf)
        upper[:n_equal] = 0.0
        solver, p = self.model.ipopt(options), self.model.ipopt_parameters(p)
        with self.model.functions.busy:  # one call at a time
            found = solver.named(x0=x, p=p, lbx=low, ubx=high, ubg=upper, **begin)
            stats, x, multipliers = solver.stats, found["x"].copy(), found["lam_g"].copy()
            objective = float(found["f"][0])
        status = str(stats["return_status"])
        claimed, why = objective if status in _ACCEPTED else None, f"Ipopt ended with {status}"
        why = "" if status == _OPTIMAL else why
        return SolverAnswer(x, claimed, f"ipopt:{status}", int(stats["iter_count"]), why, multipliers=multipliers)
