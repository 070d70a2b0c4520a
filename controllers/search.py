"""The paper's solver: roll out a set of candidate trajectories and select the cheapest (paper sec:deployment)."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
from pydantic import Field

from controllers.problem import MPCProblem, Solution, checked_solution
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.scenario.settings import StrictModel


class SearchConfig(StrictModel):
    """Candidate trajectories: all pairs of a level for the first steps and a level for the rest."""

    levels: tuple[float, ...] = Field((0.0, 0.25, 0.5, 0.75, 1.0), min_length=2, description="levels tried, in [0, 1]")
    first_stretch_steps: tuple[int, ...] = Field(
        (1, 2, 3, 4, 6, 8, 12, 18), min_length=1, description="numbers of first steps tried"
    )


class CandidateSearch:
    """Evaluates all candidates, and the guess if given, in one vectorised rollout."""

    def __init__(self, operator: OperatorParameters, n_steps: int, config: SearchConfig) -> None:
        self.operator = operator
        self._candidates = _two_level_trajectories(config, n_steps)

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """The cheapest candidate. On failure `ok` is False and `problem` has the reason."""
        candidates = np.unique(np.minimum(self._candidates, problem.u_max), axis=0)
        if guess is not None:
            candidates = np.vstack([candidates, guess])
        costs = problem.cost(self.operator, candidates)
        if not np.isfinite(costs).any():
            return Solution(False, np.empty(0), "no candidate", len(costs), "no candidate has a finite cost")
        best = int(np.nanargmin(costs))
        modes_of = partial(problem.modes_K, self.operator)
        return checked_solution(problem, modes_of, candidates[best], float(costs[best]), "best_candidate", len(costs))


def _two_level_trajectories(config: SearchConfig, n_steps: int) -> Array:
    """All two-level trajectories, shape (candidates, n_steps)."""
    rows = []
    for first, then, length in itertools.product(config.levels, config.levels, config.first_stretch_steps):
        u = np.full(n_steps, then)
        u[:length] = first
        rows.append(u)
    return np.unique(np.array(rows), axis=0)
