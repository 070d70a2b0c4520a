"""Choices between off and on by mixed-integer programming: HiGHS (Huangfu and Hall 2018).

Not convex are actuators of which one may act at a time. Which of them acts is decided exactly in the first hours; later
they share a step in time. Only the first step is applied, and every plan decides its first hours anew.

The curvature term is left out of the choice. HiGHS starts from the relaxation, rounded and solved again, and stops at
its time limit with the best plan so far; how far that may be from the optimum of the programme solved is
`Solution.gap`. With its choices the programme is convex: solved again, it shows whether its levels are the optimum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from controllers.checks import ControllerConfigError
from controllers.optimisation.problem import ProblemShape
from controllers.optimisation.programme import QPData
from controllers.optimisation.solution import Solver, SolverAnswer, StatementSolver
from controllers.optimisation.solvers.highs import Highs, MilpConfig
from controllers.optimisation.solvers.qp import Piqp, QPConfig, SolverResult
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator

# By how much a plan of HiGHS may leave rows and bounds: its own default tolerance of whole numbers
# (`mip_feasibility_tolerance`).
_KEEPS = 1e-6


class MilpSolver(StatementSolver):
    """By HiGHS, or by `choose` in its place; `shape.chosen_steps` says for how long choices are decided.

    The problem must be convex but for its choices, and terms of the user linear. `qp`: options of the relaxation that
    HiGHS starts from.
    """

    name = "highs"

    def __init__(
        self,
        operator: BuildingOperator,
        shape: ProblemShape,
        config: MilpConfig,
        qp: QPConfig | None = None,
        choose: Callable[[QPData, NDArray[np.intp], Array | None], SolverResult] | None = None,
        fallback: Callable[[], Solver] | None = None,
    ) -> None:
        super().__init__(operator, shape, fallback)
        if not self.model.convex:
            raise ControllerConfigError(
                "solver milp: the gain depends on the predicted temperature, or another term is not linear; use "
                "solver: ipopt, or a model of feedback: false"
            )
        s, quadratic = self.model.structure, self.model.functions.local.sparsity_out(2).nnz()
        # Of u², with u = v − cold, and of how far levels are above the lowest.
        if s.terms and quadratic > s.N * (s.A + 3 * len(s.signed) + len(s.stepped)):
            raise ControllerConfigError(
                "solver milp: a term of the user is quadratic, which HiGHS leaves out; use solver: ipopt"
            )
        self._choose, self._relax = choose or Highs(config), Piqp(qp or QPConfig())

    def _answers(self, p: Array, guess: Array | None) -> Iterator[SolverAnswer]:
        programme = self.model.local(p)
        start = self._start(programme)
        found = self._choose(programme, self.model.choices, start)
        x, why = found.x, "" if found.solved else f"highs: ended with {found.status}"
        if not x.size and start is not None:
            x, why = start, f"{why} and no better plan than the one that it started from"
        if not x.size:
            yield SolverAnswer(x, None, f"highs:{found.status}", found.iterations, f"{why} and no plan")
            return
        linear, bound = programme.objective(x, with_quadratic=False), programme.constant + programme.unit * found.bound
        gap = max(linear - bound, 0.0) / max(abs(linear), 1e-9) if self.model.choices.size else 0.0
        if why:
            why += (
                f", at most {100.0 * gap:.1f} % above the optimum"
                if np.isfinite(gap)
                else ", before any bound of the optimum"
            )
        said = SolverAnswer(
            x, programme.objective(x), f"highs:{found.status}, gap {gap:.2g}", found.iterations, why, gap
        )
        if programme.violation(x) <= _KEEPS:  # else there is nothing to go on from
            yield from self._again(programme, said)
        yield said

    def _again(self, programme: QPData, said: SolverAnswer) -> Iterator[SolverAnswer]:
        """The answer with what shows that it is the optimum with its choices, and that optimum, by two methods."""
        choices = self.model.choices
        chosen = programme.fixed(choices, np.round(said.x[choices]))
        for solve in (self._relax, _linear):
            found = solve(chosen)
            if found.solved:
                shown = replace(said, multipliers=chosen.unit * found.multipliers)
                yield shown
                yield replace(shown, x=found.x, claimed=chosen.objective(found.x))

    def _start(self, programme: QPData) -> Array | None:
        """The relaxation with its choices rounded, and levels for them: what HiGHS improves on; None where it fails."""
        choices = self.model.choices
        if not choices.size:
            return None
        relaxed = next((found for found in (self._relax(programme), _linear(programme)) if found.solved), None)
        if relaxed is None:
            return None
        start = _linear(programme.fixed(choices, self.model.rounded(relaxed.x)))
        return start.x if start.solved else None


def _linear(programme: QPData) -> SolverResult:
    """Without choices or curvature."""
    return Highs(MilpConfig())(programme, np.zeros(0, dtype=np.intp))
