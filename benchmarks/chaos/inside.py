"""Solvers and forecasters that fail, hang, or return what cannot be, on purpose."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from benchmarks.chaos.troubles import Trouble
from controllers import ThermoForceMPC
from controllers.mpc.planner import build_solver
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, Solver
from controllers.registry import controller_config
from thermoforce_mpc.data import Array, Boundary, FreeForecast, Observation, Plan, Record
from thermoforce_mpc.model.free_response.following import follow
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import FreeResponse
from thermoforce_mpc.scenario.testcase import TestCase

# What an absurd forecast is off by, K.
_ABSURD_K = 59_574.0


class Broken(RuntimeError):
    """Raised on purpose."""


class FailingMPC:
    """The MPC, whose solver and forecaster have the troubles of an episode; implements `Controller`."""

    def __init__(
        self,
        model: ThermalModel,
        testcase: TestCase,
        options: dict[str, Any],
        troubles: Sequence[Trouble],
        name: str = "thermoforce_mpc",
    ) -> None:
        config: Any = controller_config(name, options, testcase)
        said = config.free_response
        free = [build_free_response(said.name, rc=part, **said.options) for part in model.free]
        self._troubles, self._start_s, self._now_s = troubles, math.nan, math.nan
        self._made: dict[Trouble, int] = {}
        forecasters = [_Forecaster(method, lambda: self._trouble("forecaster")) for method in free]

        def solver(operator: BuildingOperator, shape: ProblemShape) -> Solver:
            return _Solver(build_solver(config, operator, shape), lambda: self._trouble("solver"))

        self._inner = ThermoForceMPC(model, config, free_response=forecasters, solver=solver, name=name)
        self.model = model
        self.name, self.step_s, self.horizon_s = name, self._inner.step_s, self._inner.horizon_s

    @property
    def made(self) -> dict[str, int]:
        """How often what was made."""
        return {trouble.kind: n for trouble, n in self._made.items()}

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """See `Controller.plan`."""
        self._now_s = observation.time_s
        self._start_s = self._now_s if math.isnan(self._start_s) else self._start_s
        return self._inner.plan(observation, state)

    def _trouble(self, who: str) -> str:
        """What goes wrong with this call, if anything; a hanging one hangs here."""
        for trouble in self._troubles:
            made = self._made.get(trouble, 0)
            now = trouble.from_s <= self._now_s - self._start_s < trouble.to_s
            if trouble.kind.startswith(who) and now and made < trouble.most:
                self._made[trouble] = made + 1
                what = trouble.kind.removeprefix(f"{who} ")
                if what == "hangs":
                    time.sleep(trouble.seconds)
                if what == "raises":
                    raise Broken(f"the {who} was made to fail")
                return what
        return ""


class _Solver:
    def __init__(self, inner: Solver, trouble: Callable[[], str]) -> None:
        self._inner, self._trouble = inner, trouble

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """See `Solver.solve`."""
        what = self._trouble()
        solution = self._inner.solve(problem, guess)
        if what == "nan":
            return replace(solution, u=solution.u * math.nan)
        if what == "out of range":
            return replace(solution, u=solution.u + 2.0)
        return replace(solution, u=solution.u[:, :-1]) if what == "of another shape" else solution


class _Forecaster:
    def __init__(self, inner: FreeResponse, trouble: Callable[[], str]) -> None:
        self._inner, self._trouble, self.name = inner, trouble, inner.name

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`."""
        return self.follow(free_C, history, boundary, None)[0]

    def follow(self, free_C: Array, history: Record, boundary: Boundary, state: object) -> tuple[FreeForecast, object]:
        """See `FollowingFreeResponse.follow`."""
        what = self._trouble()
        found, after = follow(self._inner, free_C, history, boundary, state)
        off_K = {"nan": math.nan, "absurd": _ABSURD_K}.get(what, 0.0)
        return replace(found, quantiles_C=found.quantiles_C + off_K), after
