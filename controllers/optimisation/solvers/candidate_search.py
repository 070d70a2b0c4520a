"""The paper's solver: roll out a set of candidate trajectories and select the cheapest (paper sec:deployment)."""

from __future__ import annotations

import itertools
from typing import Annotated

import numpy as np
from pydantic import Field

from controllers.optimisation.evaluation import Evaluator
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, checked_solution, failed
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.scenario.settings import StrictModel

# Rounds over all actuators before the search stops.
_MOST_SWEEPS = 5


class SearchConfig(StrictModel):
    """Candidate trajectories: all pairs of a level for the first steps and a level for the rest."""

    levels: tuple[Annotated[float, Field(ge=0, le=1)], ...] = Field(
        (0.0, 0.25, 0.5, 0.75, 1.0), min_length=2, description="levels tried, in [0, 1]"
    )
    first_stretch_steps: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        (1, 2, 3, 4, 6, 8, 12, 18), min_length=1, description="numbers of first steps tried"
    )


class CandidateSearch:
    """Evaluates all candidates, and the guess if given.

    With several actuators, the candidates of one are tried while the others keep theirs, in turn until none gains: a
    plan that no change of a single actuator to a candidate improves, which need not be the cheapest of all.
    """

    def __init__(self, operator: BuildingOperator, shape: ProblemShape, config: SearchConfig) -> None:
        self.model, self.operator = Evaluator(operator, shape), operator
        self._candidates = _two_level_trajectories(config, shape.n_steps)

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """The cheapest candidate. On failure `ok` is False and `problem` has the reason."""
        highest, p = problem.machinery.u_max, self.model.numbers(problem)
        best, least, tried = np.zeros((highest.size, problem.n_steps)), np.inf, 0
        starts = [] if guess is None else [guess]
        for _ in range(1 if highest.size == 1 else _MOST_SWEEPS):
            before = least
            for a, own in enumerate(highest):
                candidates = np.unique(np.minimum(self._candidates, own), axis=0)
                trials = np.repeat(best[None], len(candidates), axis=0)
                trials[:, a] = candidates
                trials = np.concatenate([trials, *(start[None] for start in starts)])
                costs = self.model.costs(p, trials)
                tried += len(trials)
                if not np.isfinite(costs).any():
                    return failed("search: no candidate", tried, "no candidate has a finite cost")
                costs = np.where(np.isfinite(costs), costs, np.inf)
                best, least = trials[int(np.argmin(costs))], float(costs.min())
                starts = [best]
            if not least < before:
                break
        return checked_solution(self.model, problem, p, best, least, "search:best_candidate", tried)


def _two_level_trajectories(config: SearchConfig, n_steps: int) -> Array:
    """All two-level trajectories, shape (candidates, n_steps)."""
    rows = []
    for first, then, length in itertools.product(config.levels, config.levels, config.first_stretch_steps):
        u = np.full(n_steps, then)
        u[:length] = first
        rows.append(u)
    return np.unique(np.array(rows), axis=0)
