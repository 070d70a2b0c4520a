"""ThermoForce MPC: one control step, from what is believed to blocks, with the plan or what takes its place."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from controllers.actuation.runs import limits_not_planned, without_owed
from controllers.checks import check_names, message_of
from controllers.monitoring.watch import Watch
from controllers.mpc.acting import ActuatedController
from controllers.mpc.commands.commanding import BuildingCommands, with_command_states, with_commands
from controllers.mpc.commands.costs import meters_of
from controllers.mpc.config import MPCConfig
from controllers.mpc.courses import Courses
from controllers.mpc.formulation import Formulation, Instance
from controllers.mpc.margins import Margins
from controllers.mpc.planner import (
    Planners,
    SolverBuilder,
    actuations_of,
    at_step,
    build_solver,
    check_exclusive,
    check_power,
    free_responses_of,
    plan_shape,
)
from controllers.mpc.readings import (
    Failure,
    Forecast,
    PlanPredictor,
    Readings,
    ReadingsFilter,
    WatchedPredictions,
    joined,
)
from controllers.mpc.realisation import Realisation
from controllers.mpc.solved import Solved, first_demands
from controllers.mpc.solving import PlanSolver
from controllers.mpc.state import MPCState
from controllers.optimisation.hot_water import PRICE_SHARES, HotWater, TankWay, TankWays
from controllers.optimisation.plan_model import Evaluator
from controllers.optimisation.problem import MPCProblem
from controllers.optimisation.solution import Solver
from controllers.optimisation.statement.terms import Terms, load_terms, of_controller
from controllers.safety.deadline import BoundedCalls
from controllers.safety.fallback_policy import FallbackPolicy, GoodPlan
from controllers.safety.overrides import (
    ActsTogether,
    ComfortGuard,
    CompetenceGate,
    LostZone,
    Override,
    OverrideRule,
    SharedCommands,
    Situation,
    UntoldCommand,
    WatchAlarm,
    decide,
)
from thermoforce_mpc.commands.loop import LearnedCommand, left_alone
from thermoforce_mpc.commands.tank import LearnedTank
from thermoforce_mpc.data import HOUR_S, Array, Boundary, Observation, Plan, Record, steps_in
from thermoforce_mpc.errors import DataError, check_kind
from thermoforce_mpc.execution.cooperative import Computation, DirectHandler, run, within
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.predictor import PredictionContext, Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import FreeResponse

# Share of what a plan costs from which what is believed of hours of the day is put to the test: nine days of a light
# house whose card says wrongly that nothing comes in four hours take 7 % more energy, 2 % with tests; such an hour is
# worth 0.6 to 4 % of a plan (2026-11-30).
_COSTS = 0.005
# Solvers that did not return and were replaced, before no more are started; besides a forecaster of each zone. By
# judgement: each holds a thread.
_SOLVERS_ABANDONED = 3


class ThermoForceMPC(ActuatedController):
    """Receding-horizon control over the superposition of a free and a forced response (paper eq:compose).

    ```python
    from controllers import ThermoForceMPC
    from thermoforce_mpc.model.thermal_model import load_model

    controller = ThermoForceMPC(load_model("my_model"))
    plan = controller.plan(observation)
    later = controller.plan(next_observation, plan.state)
    ```
    """

    def __init__(
        self,
        model: ThermalModel,
        config: MPCConfig | None = None,
        *,
        free_response: FreeResponse | Sequence[FreeResponse] | None = None,
        solver: SolverBuilder | None = None,
        commands: Mapping[str, LearnedCommand] | None = None,
        hot_water: LearnedTank | None = None,
        name: str = "thermoforce_mpc",
    ) -> None:
        """Build what the stations of a step need.

        `free_response` (one for all zones, or one per zone (Z,)) and `solver` replace those that `config` names;
        `commands`: what is set in the place of the level of an actuator, by name; `hot_water`: a tank that one of its
        machines heats too; `name`: in reports.

        Raises:
            DataError: `model` or `config` is none.
            ControllerConfigError: the horizon is shorter than a step, the model is not certified at that step and
                horizon, the actuation does not fit the step, an option names what there is not, or a term of the user
                cannot be stated.
            BackboneError, ConfigError: the free response cannot be built.
        """
        check_kind(model, ThermalModel, "model", "identify or load_model gives one")
        check_kind(config or MPCConfig(), MPCConfig, "config", "give MPCConfig(...)")
        learned = dict(commands or {})
        self.config = c = with_commands(config or MPCConfig(), learned)
        model, n_steps = at_step(model, c)
        layout, zones = model.layout, model.names.zones
        check_names("commands", learned, "actuator", layout.names.actuators)
        check_names("actuations", c.actuations, "actuator", layout.names.actuators)
        check_names("sensors", c.sensors, "zone", zones)
        check_exclusive(layout, learned)
        check_power(model)
        zone_models = [model.actuator(a) for a in range(len(layout.names.actuators))]
        choices = actuations_of(c, model, layout)
        by_number = {a: learned[one] for a, one in enumerate(layout.names.actuators) if one in learned}
        self._by_command = tuple(by_number)
        actuations = [choice.actuation for choice in choices]
        super().__init__(name, model.operator.step_s, n_steps, layout, actuations, c.fallback, by_number)
        cards = [zone.card for zone in zone_models]
        self._commands = BuildingCommands(layout, by_number, cards, meters_of(model, by_number.values()))
        if hot_water is not None:
            check_names("hot_water.machine", [hot_water.machine], "machine", layout.names.machines)
        self.hot_water = hot_water
        self._tank = None if hot_water is None else HotWater(hot_water, layout, self.step_s)
        self._shared = SharedCommands(layout, by_number, cards)
        reasons = {a: by_number[a].in_words if a in by_number else choice.why for a, choice in enumerate(choices)}
        self.actuation_in_words = "; ".join(layout.names.of_actuators(reasons))
        self._handler = DirectHandler(BoundedCalls(len(zones) + _SOLVERS_ABANDONED))
        powers = [choices[fed[0]].power for fed in layout.actuators_of_machines]
        self._formulation = Formulation(c, model, self._actuators, powers)
        shape_of = partial(
            plan_shape,
            c,
            machinery=self._formulation.machinery,
            curved=self._formulation.bent,
            terms=of_controller(self.terms()),
        )
        self._planners = Planners(
            model,
            self._actuators,
            free_responses_of(c.free_response, model, free_response),
            solver or partial(build_solver, c),
            shape_of,
        )
        expected_power = self._formulation.expected_power_W
        watches = [
            Watch(
                c.watch, zone, n_steps, partial(expected_power, a), shared=len(layout.fed_by(layout.machine_of[a])) > 1
            )
            for a, zone in enumerate(zone_models)
        ]
        self._gate = CompetenceGate(c.gate, cards, self._fallbacks, self._shared)
        self._watched = WatchedPredictions(
            watches, self._planners.of, model, enabled=c.watch.enabled and not self._gate.closes_all
        )
        self._readings = ReadingsFilter(c, model, self._planners.base.predictor, n_steps)
        self._prediction = PlanPredictor(
            self._planners, self._readings.sensors, self._watched, n_steps, c.deadline.forecast_s
        )
        alarms = (WatchAlarm(self._fallbacks),) if self._watched.enabled else ()
        untold = UntoldCommand(left_alone(by_number), self._fallbacks)
        self._overrides: tuple[OverrideRule, ...] = (*alarms, self._gate, untold, LostZone(self._fallbacks))
        guard = ComfortGuard(c.guard, layout, [actuation.highest for actuation in self._actuators.each])
        self._solving = PlanSolver(
            c, self._planners, self._prediction, self._actuators, self._fallbacks, self._commands, self.step_s
        )
        self._realisation = Realisation(self._actuators, self._fallbacks, guard, self.step_s)

    def terms(self) -> Terms:
        """Functions that add to objective and constraints (`PlanExpressions`); a subclass may return further ones.

        It is called while the controller is built, when only `config` is set; `(*super().terms(), ramp)` keeps what
        `controller.options.terms` names.
        """
        return load_terms(self.config.terms)

    def with_warmer_tank(self, more_K: float) -> ThermoForceMPC:
        """The same controller, whose tank of hot water is to be `more_K` warmer than is wanted."""
        assert self.hot_water is not None
        other = copy.copy(self)
        other._tank = HotWater(self.hot_water, self._layout, self.step_s, more_K)
        return other

    @property
    def model(self) -> ThermalModel:
        """The model as identified, at the control step."""
        return self._planners.base.model

    @property
    def predictor(self) -> Predictor:
        """The predictor of `model`."""
        return self._planners.base.predictor

    @property
    def solver(self) -> Solver:
        """The solver for `model`."""
        return self._planners.base.solver

    @property
    def rules(self) -> tuple[FallbackPolicy, ...]:
        """The fallback policy of each actuator (A,)."""
        return self._fallbacks

    @property
    def planning_operator(self) -> BuildingOperator:
        """The operator of `model`, adjusted to the actuation, as `instance` goes with it."""
        return self._planners.base.operator

    @property
    def evaluator(self) -> Evaluator:
        """What any levels cost and bring, step by step, by `planning_operator`."""
        return self._planners.base.evaluator

    def courses(self, operator: BuildingOperator, problem: MPCProblem, boundary: Boundary, T_zone_C: Array) -> Courses:
        """Rules in the instance of a plan, see `Courses`."""
        return Courses(problem, operator, self._layout, self._fallbacks, boundary, T_zone_C)

    def instance(
        self,
        context: PredictionContext,
        history: Record,
        margins: Margins | None = None,
        peak_W: float = 0.0,
        good: GoodPlan | None = None,
    ) -> MPCProblem:
        """The optimisation problem of a step for the model as identified.

        `margins` and `peak_W` (W) are what a run has learned, `good` its last plan; by default nothing. Raises
        `DataError` where a bound or price of the boundary is missing.
        """
        names = self._layout.names
        margins = margins or Margins.nothing(len(names.zones), len(names.machines))
        return self._formulation.instance(self.planning_operator, context, history, margins, peak_W, good=good).problem

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """Plan for the next step.

        An exception of forecast or solver is not raised: the fallback policy decides, and `Plan.why` holds the reason.
        An actuator whose model or zone is not trusted is left to native control or the rule alone; the others follow
        the plan.

        Raises:
            DataError: error of the caller: the observation is of another building, the boundary forecast does not begin
                now or is too short, its step or that of the history is not `step_s`, what the meter read is missing
                where peaks have a price and others are behind it, or `state` is not from an earlier plan of this
                controller.
        """
        return run(self.planning(observation, state), self._handler)

    def planning(self, observation: Observation, state: object = None) -> Computation[Plan]:
        """`plan` as a computation that requests its forecasts and its solve, so that many plans are made together.

        It changes nothing but caches: one controller may make the plans of several buildings of the same model.
        """
        check_kind(observation, Observation, "observation", "give Observation(record, boundary)")
        aims, others = self.config.objective, observation.boundary.others_W.size
        if aims.prices_peaks and aims.at_the_meter and others and not observation.history.meter_W.size:
            raise DataError(
                "history: what the meter read (`meter_W`) is missing, with which peaks of plans are compared where the "
                "forecast has other loads or generation"
            )
        before, actuation = self._resume(observation, state, MPCState)
        if before is None:
            watch = self._watched.begin(observation.time_s, observation.history.origin)
            before = MPCState.begin(observation.time_s, self._layout.names, watch, self._readings.meters.begin)
        if self.config.whole_runs:
            actuation = without_owed(self._actuators, actuation, self.step_s)
        before = replace(before, actuation=actuation, last_s=observation.time_s)
        try:
            return (yield from self._step(observation, before))
        except Exception as error:  # whatever is wrong, the building is not left without control
            return self._realisation.release(before, message_of(error))

    def _step(self, observation: Observation, state: MPCState) -> Computation[Plan]:
        """One control step: each line a station, from what is believed to what is applied."""
        readings, state = yield from self._clean(observation, state)
        state = yield from self._watch(readings, state)
        situation = Situation(readings.observation, readings.zones, state.watch)
        overrides, joined_in = self._shared.open(decide(self._overrides, situation))
        before, state = state.margins, self._learn(readings, state)
        limits = self._formulation.margins.news(before, state.margins)
        others = self.model.news_of_others(readings.history, observation.history)
        if len(overrides) == len(self._fallbacks):
            plan = self._realisation.stand_back(overrides, state)
        else:
            result = yield from self._solved(observation, readings, state, overrides, joined_in)
            plan = self._realise(result, readings, overrides, situation)
        return self._watched.record_request(readings.observation, plan.with_news(*readings.news, limits, others))

    def _solved(
        self,
        observation: Observation,
        readings: Readings,
        state: MPCState,
        overrides: Mapping[int, Override],
        joined_in: Mapping[int, ActsTogether],
    ) -> Computation[Solved | Failure]:
        """From readings to a plan without blocks: predict, formulate, solve; then an hour to try, and the tank.

        `observation`: what came, with the tank, of which readings say nothing.
        """
        forecast = yield from self._prediction.predict(readings, state)
        if isinstance(forecast, Failure):
            return forecast
        formulate = partial(self._formulate, forecast, readings, overrides=overrides)
        instance = formulate(state)
        if isinstance(instance, Failure):
            return instance
        solve = partial(
            self._solving.solve, forecast=forecast, readings=readings, overrides=overrides, joined_in=joined_in
        )
        result = yield from solve(instance)
        if isinstance(result, Failure):
            return result
        evaluator = forecast.planner.evaluator
        result, instance = yield from self._with_trial(result, instance, state, overrides, formulate, solve, evaluator)
        if self._tank is None:
            return result
        begin = forecast.context.boundary, readings.history.origin
        ways = self._tank.begin(*begin, observation.tank_C, observation.tank_charges, state.tank)
        return (yield from self._with_tank(result, instance, ways, evaluator, solve))

    def _clean(self, observation: Observation, state: MPCState) -> Computation[tuple[Readings, MPCState]]:
        """What is believed; a model that may not act says nothing of readings."""
        as_identified = self._planners.of(state.adaptation) is self._planners.base
        return self._readings.clean(
            observation, state, with_model=not self._gate.closes_all, as_identified=as_identified
        )

    def _watch(self, readings: Readings, state: MPCState) -> Computation[MPCState]:
        """The state with the predictions that came due, and new ones of models that do not act at present."""
        if not self._watched.enabled:
            return state
        state = self._watched.validate(state, readings.history, readings.forced_K)
        if not any(watch.alarm for watch in state.watch):
            return state
        ahead = self._prediction.ahead(readings.observation)
        return (yield from within(self.config.deadline.forecast_s, self._watched.predict_in_background(ahead, state)))

    def _learn(self, readings: Readings, state: MPCState) -> MPCState:
        """The state with what the last step taught of bounds, predictions, capacities and peak power."""
        margins = self._formulation.margins.learn(
            self.planning_operator, state.margins, state.good, readings.observation, readings.forecast
        )
        aims = self.config.objective
        peak_W = state.peak_after(readings.observation, aims.peak_of, at_the_meter=aims.at_the_meter)
        return replace(state, margins=margins, peak_W=peak_W)

    def _formulate(
        self, forecast: Forecast, readings: Readings, state: MPCState, overrides: Mapping[int, Override]
    ) -> Instance | Failure:
        """The numbers of the problem.

        The level of an overridden actuator stays a variable: what acts in its place is a loop that answers to its zone,
        which a plan that keeps the zone in its band describes better than a level that is fixed beforehand.
        """
        operator, context = forecast.planner.operator, forecast.context
        try:
            hours = [(watch.blocked, watch.hours) for watch in state.watch]
            instance = self._formulation.instance(
                operator, context, readings.history, state.margins, state.peak_W, hours, overrides, state.good
            )
            for a, watch in enumerate(state.watch):
                if (level := watch.trial(readings.time_s)) and a not in overrides:
                    left_s = watch.tried[0] + HOUR_S - readings.time_s
                    instance = instance.asking(a, level, steps_in(left_s, self.step_s))
            return instance
        except Exception as error:  # of a forecast that lacks what the problem needs
            return Failure(f"no prediction ({message_of(error)})", state)

    def _with_trial(
        self,
        alone: Solved,
        instance: Instance,
        state: MPCState,
        overrides: Mapping[int, Override],
        formulate: Callable[[MPCState], Instance | Failure],
        solve: Callable[[Instance], Computation[Solved | Failure]],
        evaluator: Evaluator,
    ) -> Computation[tuple[Solved, Instance]]:
        """The plan and its instance, or those with a try of the hour that begins, where what is believed of it costs.

        Where the same model without that belief has a plan that costs clearly less, the hour is asked for once, if that
        costs no more than the belief does. `alone`: the plan that does without it.
        """
        levels = self._levels_to_try(alone, state, overrides)
        if not levels:
            return alone, instance
        other = formulate(
            replace(state, watch=tuple(one.without_hours if a in levels else one for a, one in enumerate(state.watch)))
        )
        a, level = next(iter(levels.items()))
        asking = instance.asking(a, level, round(HOUR_S / self.step_s))
        without = other if isinstance(other, Failure) else (yield from solve(other))
        if isinstance(without, Failure):
            return alone, instance
        cost, least = (evaluator.brings(one.problem, one.plan.u, one.own_values).cost for one in (alone, without))
        if cost - least <= _COSTS * abs(cost):
            return alone, instance
        tried = yield from solve(asking)
        if isinstance(tried, Failure):
            return alone, instance
        price = evaluator.brings(tried.problem, tried.plan.u, tried.own_values).cost - cost
        if price > cost - least:
            return alone, instance
        told = (
            f"what is believed of hours of the day makes the plan {cost - least:.3g} dearer by the same model "
            f"({cost:.3g} over the horizon): {100.0 * abs(level):.0f} % is asked for in this hour, "
            "to see whether it holds"
        )
        planned = tried.plan.state
        assert isinstance(planned, MPCState)
        watch = list(planned.watch)
        news = joined([watch[a].news, told])
        watch[a] = replace(watch[a], tried=(float(tried.plan.time_s[0]), level), news=news)
        return tried._replace(plan=replace(tried.plan, state=replace(planned, watch=tuple(watch)))), asking

    def _levels_to_try(self, plan: Solved, state: MPCState, overrides: Mapping[int, Override]) -> dict[int, float]:
        """Levels to ask for in the hour that begins, by number of the actuator, see `Watch.level_to_try`.

        Of those that the plan decides and asks for less.
        """
        problem, found = plan.problem, dict[int, float]()
        steps = round(HOUR_S / self.step_s)
        for a, z in enumerate(self._layout.home):
            if not steps or a in overrides or a in self._by_command or problem.machinery.excluded[a]:
                continue
            heats = problem.T_free_C[z, 0] < 0.5 * (problem.lower_C[z, 0] + problem.upper_C[z, 0])
            level = self._watched.level_to_try(state, a, float(plan.plan.time_s[0]), heats=bool(heats))
            if level and float(plan.plan.u[a, :steps].mean()) / level < 1.0:
                found[a] = level
        return found

    def _with_tank(
        self,
        alone: Solved,
        instance: Instance,
        ways: TankWays | None,
        evaluator: Evaluator,
        solve: Callable[[Instance], Computation[Solved | Failure]],
    ) -> Computation[Solved | Failure]:
        """The plan of the rooms with what the best way to charge the tank leaves them, see `hot_water`.

        `alone`: their plan with the whole machine.
        """
        tank = self._tank
        assert tank is not None
        if ways is None:
            return alone.with_tank(None, "the tank is left to the device: its temperature is not known")

        def cost_of(one: Solved) -> float:
            return evaluator.brings(one.problem, one.plan.u, one.own_values).cost

        whole = cost_of(alone)
        price = tank.price(evaluator, alone.problem, alone.plan.u)
        best: tuple[float, Solved, TankWay] | None = None
        tried, least = set[tuple[float | None, ...]](), math.inf
        for share in PRICE_SHARES:
            way = ways.cheapest(share * price)
            least = min(least, way.cost + whole)
            if way.plan.command in tried:
                continue
            tried.add(way.plan.command)
            found = yield from solve(instance._replace(problem=tank.beside(instance.problem, way.plan)))
            if isinstance(found, Failure):
                continue
            cost = cost_of(found)
            if best is None or way.cost + cost < best[0]:
                best = way.cost + cost, found, way
        if best is None:
            return alone.with_tank(None, "the tank is left to the device: the rooms have no plan beside it")
        total, found, way = best
        told = replace(way.plan, solves=len(tried), gap=max(total - least, 0.0))
        return found.with_tank(told, "")

    @property
    def limits_not_planned(self) -> list[str]:
        """What a plan in whole runs does not keep of minimum times and starts an hour, in words, see `runs`."""
        return limits_not_planned(self._actuators, self.step_s, self._by_command)

    def _realise(
        self, result: Solved | Failure, readings: Readings, overrides: Mapping[int, Override], situation: Situation
    ) -> Plan:
        if isinstance(result, Failure):
            doubtful = [self._watched.doubtful(result.state, a) for a in range(len(self._fallbacks))]
            return self._realisation.fall_back(result, overrides, doubtful, readings.doubts, situation)
        plan, problem, limit, commanded, _ = result
        demands = first_demands(
            self.config, self._actuators, self.step_s, plan, readings, commanded, most_u=problem.most_u
        )
        capacity = None if problem.capacity is None else problem.capacity[:, 0]
        by_command = commanded.guard(self.step_s) if commanded is not None else None
        realised = self._realisation.realise(plan, demands, overrides, situation, limit, capacity, by_command)
        return realised if commanded is None else with_command_states(realised, commanded)
