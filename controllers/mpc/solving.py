"""The station `solve` of a step: from the numbers of a problem to a checked plan, without blocks.

Levels of the solver are checked by the statement, and carried out by commands where these are set in their place. Else
the on/off rule's levels act where the same statement prices them clearly lower, and levels become whole runs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from controllers.actuation.actuators import Actuators
from controllers.actuation.runs import in_runs, needs_runs
from controllers.checks import message_of
from controllers.mpc.commands.commanding import (
    MOST_SOLVES,
    NOT_BETTER,
    BuildingCommands,
    Commanded,
    CommandedPlan,
)
from controllers.mpc.config import MPCConfig
from controllers.mpc.courses import Courses
from controllers.mpc.formulation import Instance
from controllers.mpc.planner import Planner, Planners
from controllers.mpc.readings import Failure, Forecast, PlanPredictor, Readings, joined
from controllers.mpc.solved import Solved, beyond_rooms, power_limit, solved_plan
from controllers.optimisation.plan_model import Evaluation
from controllers.optimisation.problem import MPCProblem
from controllers.optimisation.solution import Solution, Solve
from controllers.safety.deadline import Overdue
from controllers.safety.fallback_policy import FallbackPolicy, GoodPlan
from controllers.safety.overrides import ActsTogether, Override
from thermoforce_mpc.commands.meter import scatter_of_days
from thermoforce_mpc.data import HOUR_S, Array, Plan, PlannedSaving, Record, steps_in
from thermoforce_mpc.data.dataframes import clock_s
from thermoforce_mpc.execution.cooperative import Computation, Request, perform, timed

# The rule acts where it costs less by this share of what the plan costs, and by more than so many K·h: what solvers and
# moves leave is well below (bestest_air, mix_day, 2026-11-28: the plan's cost was lower by 7 or more in all 96 hours).
_CLEARLY, _LEAST_KH = 0.05, 0.1


class _Checked(NamedTuple):
    """A solution and what its levels bring, which leave no limit, or one that what carries them out sees to: `broken`.

    By commands: `own`, what is set, and what it saves.
    """

    solution: Solution
    brought: Evaluation
    broken: str = ""
    own: CommandedPlan | None = None
    commanded: Commanded | None = None
    saving: PlannedSaving | None = None


class PlanSolver:
    """Solves the problem of a step, and checks what comes; it holds no state."""

    def __init__(
        self,
        config: MPCConfig,
        planners: Planners,
        prediction: PlanPredictor,
        actuators: Actuators,
        rules: Sequence[FallbackPolicy],
        commands: BuildingCommands,
        step_s: float,
    ) -> None:
        self._config, self._planners, self._prediction, self._commands = config, planners, prediction, commands
        self._actuators, self._rules, self._step_s = actuators, rules, step_s

    def solve(
        self,
        instance: Instance,
        forecast: Forecast,
        readings: Readings,
        overrides: Mapping[int, Override],
        joined_in: Mapping[int, ActsTogether],
    ) -> Computation[Solved | Failure]:
        """The plan of an instance, or why there is none.

        `joined_in`: actuators that others, which are held, take with them, as a command is of several.
        """
        forecast = self._prediction.record(forecast, readings)
        planner, seconds, problem = forecast.planner, forecast.context.seconds, instance.problem
        guess = self._guess(forecast.state.good, readings.time_s)
        own = self._commands.begin(
            planner.operator,
            planner.evaluator,
            problem,
            forecast.context.boundary,
            overrides,
            readings.history.origin,
            forecast.state.actuation,
            [a for a, one in joined_in.items() if one.held],
        )
        try:
            solution, refused, solve_s = yield from self._levels(planner, problem, own, guess)
            began = time.perf_counter()
            checked = None if refused else self._checked(planner, problem, solution, own, readings.history)
            seconds = {**seconds, "solve": solve_s, "check": time.perf_counter() - began}
        except Exception as error:  # whatever a solver raises, there is another way to act
            if isinstance(error, Overdue):
                self._planners.renew_solver(planner)
            return Failure(f"the solver failed ({message_of(error)})", forecast.state, "raised", seconds)
        if checked is None or checked.brought.broken:
            why = refused or f"the solver's levels leave a limit: {checked.brought.broken if checked else ''}"
            return Failure(why, forecast.state, solution.status, seconds)
        if beyond := beyond_rooms(problem, checked.brought, readings.observation.names.zones):
            return Failure(beyond, forecast.state, solution.status, seconds)
        if checked.commanded is None:
            checked, ruled = self._or_by_rule(problem, checked, forecast, readings)
            forecast = replace(forecast, state=replace(forecast.state, ruled=ruled))
        if self._config.whole_runs and not overrides.keys() >= set(self._in_runs):
            checked = self._with_runs(problem, checked, forecast, list(overrides))
        limit = power_limit(instance, checked.solution, checked.brought, planner.evaluator)
        free_steps = steps_in(self._config.move_blocking.free_h * HOUR_S, self._step_s)
        plan = solved_plan(instance, checked.solution, checked.brought, seconds, forecast, readings, free_steps)
        plan = self._with_commands(plan, checked, joined_in)
        return Solved(plan, problem, limit, checked.commanded, checked.solution.own_values)

    def _levels(
        self, planner: Planner, problem: MPCProblem, own: CommandedPlan | None, guess: Array | None
    ) -> Computation[tuple[Solution, str, float]]:
        """The solver's levels, why they are refused or '', and the seconds of the last solve.

        Commands bring what they do at the temperatures that they lead to: where levels ask for more, they are solved
        again within what commands bring at those.
        """
        shape = planner.stated.shape
        for again in range(MOST_SOLVES if own else 1):
            within = own.within_reach(guess).in_moves(shape) if own else problem
            solve = Solve(planner.solver, within, guess)
            request = Request(planner.solver, solve, seconds=self._config.deadline.solve_s)
            solution, solve_s = yield from timed(perform(request))
            refused = solution.problem if not solution.ok else within.unfit(solution.u)
            if refused or own is None or again + 1 == MOST_SOLVES or not own.beyond(solution.u, shape):
                break
            guess = solution.u
        return solution, refused, solve_s

    def _checked(
        self, planner: Planner, problem: MPCProblem, solution: Solution, own: CommandedPlan | None, history: Record
    ) -> _Checked:
        """What the levels bring, or those that commands make of them; of commands that save nothing, left alone."""
        commanded, saving = None, None
        if own is not None:
            commanded = own.realise(solution.u)
            saving = own.saving(commanded, self._power_spread(history), self._power_scatter(history))
            if not saving.gain > 0.0:
                own = own.without
                commanded = own.realise(solution.u)
            solution = replace(solution, u=commanded.u)
        brought, broken = planner.evaluator.brings(problem, solution.u, solution.own_values), ""
        if planner.evaluator.structure.chosen or own is not None:  # levels become blocks, or are answers
            brought, broken = replace(brought, broken=""), brought.broken
        return _Checked(solution, brought, broken, own, commanded, saving)

    def _or_by_rule(
        self, problem: MPCProblem, checked: _Checked, forecast: Forecast, readings: Readings
    ) -> tuple[_Checked, bool]:
        """The solution, or the on/off rule's where the same statement prices its levels clearly lower; which it is.

        It is looked at each hour, and while the rule acts.
        """
        if not forecast.state.ruled and round(readings.time_s) % round(HOUR_S):
            return checked, False
        planner, solution = forecast.planner, checked.solution
        layout, boundary = self._actuators.layout, forecast.context.boundary
        courses = Courses(problem, planner.operator, layout, self._rules, boundary, readings.zones.T_C)
        u = planner.stated.shape.in_moves(courses.follow(courses.rule))
        numbers = planner.stated.numbers(problem)
        planned, by_rule = (planner.stated.evaluate(numbers, levels, solution.own_values) for levels in (solution.u, u))
        dearer = planned.cost - by_rule.cost
        clearly = max(_CLEARLY * abs(planned.cost), _LEAST_KH * float(np.max(problem.weights.comfort)))
        if by_rule.broken or dearer <= clearly:
            return checked, False
        parts = {name: by_rule.parts[name] - cost for name, cost in planned.parts.items()}
        told = ", ".join(f"{name} {more:+.2f}" for name, more in parts.items() if abs(more) > 0.1 * dearer)
        why = (
            f"the on/off rule's levels act: by the same model and prices they cost {dearer:.3g} less than the solver's "
            f"({planned.cost:.3g} over the horizon; {told})"
        )
        evaluated = planner.evaluator.brings(problem, u, solution.own_values)
        found = replace(solution, u=u, optimal=False, evaluation=by_rule, problem=joined([solution.problem, why]))
        return checked._replace(solution=found, brought=evaluated, broken=evaluated.broken), True

    @property
    def _in_runs(self) -> list[int]:
        """Numbers of the actuators whose steps do not hold their minimum on and off times."""
        return [a for a, actuation in enumerate(self._actuators.each) if needs_runs(actuation, self._step_s)]

    def _with_runs(self, problem: MPCProblem, checked: _Checked, forecast: Forecast, left: Sequence[int]) -> _Checked:
        """The solution in whole runs (`MPCConfig.whole_runs`); `left`: numbers of those who do not follow it."""
        evaluator, solution, broken = forecast.planner.evaluator, checked.solution, checked.broken
        numbers = evaluator.numbers(problem)

        def cost(u: Array) -> float:
            found = evaluator.evaluate(numbers, u, solution.own_values)
            return math.inf if found.broken and not broken else found.cost

        u = in_runs(self._actuators, solution.u, self._step_s, forecast.state.actuation, left, cost)
        carried = evaluator.evaluate(numbers, u, solution.own_values)
        if carried.broken and not broken:
            said = f"the plan does not keep minimum on and off times, since in whole runs {carried.broken}"
            return checked._replace(solution=replace(solution, problem=joined([solution.problem, said])))
        return checked._replace(solution=replace(solution, u=u), brought=carried)

    def _with_commands(self, plan: Plan, checked: _Checked, joined_in: Mapping[int, ActsTogether]) -> Plan:
        """The plan with what is set in the place of levels, what that saves, and why some go with others."""
        own, commanded, saving = checked.own, checked.commanded, checked.saving
        if own is None or commanded is None:
            return plan
        plan = replace(plan, settings=own.settings(commanded, plan.time_s), saving=saving)
        if saving is not None and not saving.gain > 0.0:
            plan = replace(plan, why=f"{NOT_BETTER}; {plan.why}")
        told = self._actuators.layout.names.of_actuators({a: one.in_words for a, one in joined_in.items()})
        return replace(plan, why=joined([*told, plan.why]))

    def _guess(self, good: GoodPlan | None, time_s: float) -> Array | None:
        """Warm start (A, N): the plan of the previous step, shifted by one step; None without one."""
        if good is None or good.age(time_s, self._step_s) != 1:
            return None
        return np.concatenate([good.u[:, 1:], good.u[:, -1:]], axis=1)

    def _power_spread(self, history: Record) -> float:
        """Largest error, as a share, of what a change of levels does to the power of a machine."""
        model = self._planners.base.model
        return max(model.power_change(m, history).spread for m in range(len(model.machines)))

    def _power_scatter(self, history: Record) -> list[Array]:
        """Scatter of the meter of each machine around its law (M), W, see `scatter_of_days`."""
        at_s, out = clock_s(history.time_s[:-1], history.origin), []
        for m, power_W in enumerate(history.power_W):
            error_W = power_W - self._planners.base.model.power_by_law_of(m, history)
            out.append(scatter_of_days(error_W, at_s, history.step_s))
        return out
