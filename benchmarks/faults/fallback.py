"""`tf-mpc bench fallback`: what broken sensors, forecasts and solvers cost, with protection and without it.

The embedded plant with the synthetic year from day 16, three days of probing, default configuration. A fault lasts for
the hours of its row from the middle of the third day, where it does not last until the end. Without protection the
same controller believes every reading inside the limits and every forecast (`sensor.enabled: false` and
`free_response.substitutes: false`); there is no such column where only a fallback level can act.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from benchmarks.faults.faulty_plant import FaultyPlant
from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from controllers.mpc.planner import build_solver
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, Solver
from controllers.registry import controller_config
from controllers.rules.native import NativeController
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Observation, Plan, PlanStatus, Record
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.model.free_response.following import follow
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_testcase

_START_DAY, _FROM_DAYS, _LONGEST_DAYS = 16, 2.5, 14.0
_UNPROTECTED: dict[str, Any] = {"sensor": {"enabled": False}, "free_response": {"substitutes": False}}
# Goal: discomfort beside that without a fault, as a factor and K·h more; for good: at most that of native control.
_FACTOR, _MORE_KH = 1.5, 1.0

Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One fault: options of `FaultyPlant`, or what is broken inside the controller, for `hours` of a run of `days`."""

    plant: Mapping[str, Any] = field(default_factory=lambda: {"fault": "none"})
    hours: float = 24.0
    days: float = 5.0
    forecaster: Callable[[FreeForecast], FreeForecast] | None = None
    solver_raises: bool = False
    unprotected: bool = True

    @property
    def broken(self) -> bool:
        """Whether there is a fault."""
        return bool(self.forecaster or self.solver_raises or self.plant["fault"] != "none")


CASES: dict[str, Case] = {
    "none": Case(unprotected=False),
    "sensor reads 0 K": Case({"fault": "reads", "reading_C": -273.15}, 6.0),
    "sensor reads 0 °C": Case({"fault": "reads", "reading_C": 0.0}, 6.0),
    "sensor silent": Case({"fault": "reads", "reading_C": math.nan}, unprotected=False),
    "sensor 2 K too high": Case({"fault": "offset", "offset_K": 2.0}),
    "sensor 2 K too low": Case({"fault": "offset", "offset_K": -2.0}),
    "sensor stuck for a day": Case({"fault": "frozen"}),
    "sensor stuck for good": Case({"fault": "frozen"}, math.inf, _LONGEST_DAYS),
    "forecaster raises": Case(forecaster=lambda found: _raised(), unprotected=False),
    "forecaster says −50 °C": Case(forecaster=lambda found: replace(found, quantiles_C=found.quantiles_C * 0 - 50.0)),
    "weather forecast missing": Case({"fault": "no weather"}, unprotected=False),
    "prices missing": Case({"fault": "no prices"}, unprotected=False),
    "forecast ends after 3 h": Case({"fault": "short forecast"}, unprotected=False),
    "solver raises": Case(solver_raises=True, unprotected=False),
}
_QUICK = ("none", "sensor reads 0 K", "forecaster raises", "weather forecast missing")


def run_fallback_bench(*, quick: bool = False, progress: Callable[[str], None] = lambda line: None) -> dict[str, Any]:
    """Run every case.

    Args:
        quick: some of them.
        progress: callback for progress lines.
    """
    plant = EmbeddedPlant(synthetic_weather())
    testcase = load_testcase("bestest_hydronic_heat_pump")
    period = plant.period(str(_START_DAY))
    progress("probing and identifying")
    model = identify_on(plant, before=period, days=3.0, testcase=testcase)

    def run(case: Case, options: Mapping[str, Any]) -> RunResult:
        from_s = period.start_s + _FROM_DAYS * DAY_S
        to_s = from_s + case.hours * HOUR_S
        config = controller_config("thermoforce_mpc", options, testcase)
        assert isinstance(config, MPCConfig)
        controller = _Broken(model, config, case, from_s, to_s)
        faulty = FaultyPlant(plant, from_s=from_s, to_s=to_s, **case.plant)
        return run_closed_loop(faulty, controller, replace(period, scored_s=case.days * DAY_S))

    progress("native control")
    native = run_closed_loop(plant, NativeController(), replace(period, scored_s=_LONGEST_DAYS * DAY_S))
    rows = [_row("native control", Case(days=_LONGEST_DAYS), native, None)]
    for name in _QUICK if quick else CASES:
        progress(name)
        case = CASES[name]
        without = run(case, _UNPROTECTED).kpis["tdis_tot"] if case.unprotected else None
        rows.append(_row(name, case, run(case, {}), without))
    return results_json("fallback", rows, _targets(rows))


class _Broken:
    """The MPC, whose forecaster or solver is broken in the hours of a case."""

    def __init__(self, model: ThermalModel, config: MPCConfig, case: Case, from_s: float, to_s: float) -> None:
        self.model, self._now = model, _Now()

        def solver(operator: BuildingOperator, shape: ProblemShape) -> Solver:
            working = build_solver(config, operator, shape)
            return _BrokenSolver(working, self._now) if case.solver_raises else working

        self._inner = ThermoForceMPC(model, config, solver=solver)
        if case.forecaster:
            inner = self._inner.predictor.free_responses[0]
            method = _BrokenForecaster(getattr(inner, "method", inner), case.forecaster, self._now)
            self._inner = ThermoForceMPC(model, config, free_response=method, solver=solver)
        self._from_s, self._to_s = from_s, to_s
        self.name, self.step_s, self.horizon_s = self._inner.name, self._inner.step_s, self._inner.horizon_s

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """See `Controller.plan`."""
        self._now.broken = self._from_s <= observation.time_s < self._to_s
        return self._inner.plan(observation, state)


@dataclass
class _Now:
    """Whether what is broken is broken now."""

    broken: bool = False


class _BrokenForecaster:
    def __init__(self, inner: Any, broken: Callable[[FreeForecast], FreeForecast], now: _Now) -> None:
        self._inner, self._broken, self._now = inner, broken, now
        self.name = inner.name

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`."""
        return self.follow(free_C, history, boundary, None)[0]

    def follow(self, free_C: Array, history: Record, boundary: Boundary, state: object) -> tuple[FreeForecast, object]:
        """See `FollowingFreeResponse.follow`."""
        found, after = follow(self._inner, free_C, history, boundary, state)
        return (self._broken(found) if self._now.broken else found), after


class _BrokenSolver:
    def __init__(self, inner: Any, now: _Now) -> None:
        self._inner, self._now = inner, now

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """See `Solver.solve`."""
        if self._now.broken:
            raise RuntimeError("broken on purpose")
        solution: Solution = self._inner.solve(problem, guess)
        return solution


def _raised() -> FreeForecast:
    raise RuntimeError("broken on purpose")


def _row(name: str, case: Case, result: RunResult, without_Kh: float | None) -> Row:
    """Discomfort with protection and without, and how often which level of the fallback acted."""
    as_planned = (PlanStatus.SOLVED, PlanStatus.RULE)
    counts = {status: n for status, n in result.fallback_levels().items() if n and status not in as_planned}
    first = next((step.plan.why for step in result.steps if step.plan.status not in as_planned), "")
    return {
        "fault": name,
        "hours": "for good" if math.isinf(case.hours) else f"{case.hours:g}" if case.broken else None,
        "days": case.days,
        "discomfort_Kh": result.kpis["tdis_tot"],
        "unprotected_Kh": without_Kh,
        "cost": result.kpis["cost_tot"],
        "steps": ", ".join(f"{n} {status}" for status, n in counts.items()),
        "reason": first,
    }


def _targets(rows: list[Row]) -> list[Target]:
    native_Kh, goal = rows[0]["discomfort_Kh"], _FACTOR * rows[1]["discomfort_Kh"] + _MORE_KH
    return [
        Target(
            f"{row['fault']}: discomfort, K·h",
            row["discomfort_Kh"],
            max(goal, native_Kh) if row["hours"] == "for good" else goal,
        )
        for row in rows[2:]
    ]
