"""Faults to order: houses, forecasts and solvers that differ from what is believed of them, by small functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from simple_house import OutdoorResponse, SimpleHouse, outdoor_C

from controllers.mpc.config import MPCConfig
from controllers.mpc.planner import build_solver
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, Solver
from thermoforce_mpc.data import HOUR_S, Array, Boundary, FreeForecast, Measurement, Record
from thermoforce_mpc.model.operator.building import BuildingOperator


class FaultyHouse(SimpleHouse):
    """A simple house that differs from what is believed of it; every function is told the house first.

    `shows(house, measurement)`: what sensors and meters say. `says(house, boundary)`: what the weather service says; it
    may raise. `gives(house, u)`: the level that the machine gives when `u` is asked for (None: by native control).
    `moves(house, hours)`: K that come from elsewhere in the hours before a step.
    """

    def __init__(
        self,
        shows: Callable[[FaultyHouse, Measurement], Measurement] = lambda house, measurement: measurement,
        says: Callable[[FaultyHouse, Boundary], Boundary] = lambda house, boundary: boundary,
        gives: Callable[[FaultyHouse, float | None], float | None] = lambda house, u: u,
        moves: Callable[[FaultyHouse, float], float] = lambda house, hours: 0.0,
    ) -> None:
        super().__init__()
        self.shows, self.says, self.gives, self.moves = shows, says, gives, moves
        self.asked: float | None = None  # of the step under way, which began at `began_s`

    @property
    def hours(self) -> float:
        """Hours since the start of the run, negative during the warm-up."""
        return (self.now_s - self.start_s) / HOUR_S

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        self.start_s, self.began_s, self.asked = start_s, start_s - warmup_s, None
        return super().reset(start_s, warmup_s, price)

    def measure(self, u: float = np.nan) -> Measurement:
        return self.shows(self, super().measure(u))

    def step(self, u: float | None, duration_s: float) -> Measurement:
        self.asked, self.began_s = u, self.now_s
        self.T += self.moves(self, duration_s / HOUR_S)
        return super().step(self.gives(self, u), duration_s)

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        return self.says(self, super().forecast(horizon_s, interval_s))


def draught_K(house: SimpleHouse, share_per_h: float, hours: float) -> float:
    """What an open window brings in some hours, K: so much of the distance to the outdoor temperature an hour."""
    return share_per_h * hours * (float(outdoor_C(house.now_s)) - house.T)


class ChangedResponse:
    """The exact free response of the simple house, with `changed(number of the call, forecast)` in between."""

    name = "exact"

    def __init__(self, changed: Callable[[int, FreeForecast], FreeForecast]) -> None:
        self.changed, self.calls = changed, 0

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        self.calls += 1
        return self.changed(self.calls - 1, OutdoorResponse().forecast(free_C, history, boundary))


def shifted(off_K: float) -> ChangedResponse:
    """A forecast that is finite, confident and wrong by `off_K`."""
    return ChangedResponse(lambda n, right: replace(right, quantiles_C=right.quantiles_C + off_K))


class ChangedSolver:
    """Builds the solvers that `config` names, with `changed(number of the call, solution)` in between."""

    def __init__(self, config: MPCConfig, changed: Callable[[int, Solution], Solution]) -> None:
        self.config, self.changed, self.calls = config, changed, 0

    def __call__(self, operator: BuildingOperator, shape: ProblemShape) -> Solver:
        return _Changed(self, build_solver(self.config, operator, shape))


class _Changed:
    def __init__(self, by: ChangedSolver, inner: Solver) -> None:
        self.by, self.inner = by, inner

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        self.by.calls += 1
        return self.by.changed(self.by.calls - 1, self.inner.solve(problem, guess))


FAILED = Solution(False, np.empty(0), "failed", 0, "failed on purpose")
