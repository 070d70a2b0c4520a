"""ThermoForce MPC: predict free and forced response, solve, check the solution, convert it to blocks, or fall back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from controllers.actuation.actuator import ActuationState
from controllers.actuation.choice import choose_actuation
from controllers.actuation.room_setpoints import room_blocks, within_C
from controllers.checks import ControllerConfigError, check_names, message_of
from controllers.monitoring.meters import Meters
from controllers.monitoring.single_actuator import single_actuator_records
from controllers.monitoring.sun_on_sensors import Sunlit
from controllers.monitoring.watch import Watch
from controllers.monitoring.watch_state import WatchState
from controllers.monitoring.zone_sensor import Sensor
from controllers.monitoring.zone_sensor_state import SensorState
from controllers.monitoring.zone_sensors import Zones, ZoneSensors
from controllers.mpc.config import FreeResponseConfig, MPCConfig
from controllers.mpc.fallback import FallbackController
from controllers.mpc.formulation import Formulation
from controllers.mpc.margins import OF_LOOPS, LearnedMargin, learned_K, of_plans
from controllers.mpc.model_watch import WatchedPredictions
from controllers.mpc.planner import Planners, build_solver
from controllers.mpc.reason import reason_of, with_news
from controllers.mpc.state import MPCState
from controllers.optimisation.problem import MPCProblem
from controllers.optimisation.solution import Solution, Solve, Solver
from controllers.safety.deadline import BoundedCalls, Overdue
from controllers.safety.fallback_policy import FallbackPolicy, GoodPlan, Override
from controllers.safety.overrides import gate_reason
from thermoforce_mpc.data import HOUR_S, Array, Block, Observation, Plan, PlanStatus, Record
from thermoforce_mpc.execution.cooperative import Computation, DirectHandler, Request, perform, run, timed, within
from thermoforce_mpc.identification.estimation.adaptation import AdaptationState, OnlineAdaptation
from thermoforce_mpc.model.forced_state import ForcedState
from thermoforce_mpc.model.forecast_gaps import completed, whole
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.free_response.substitute import WithSubstitutes
from thermoforce_mpc.model.gaps import gapless
from thermoforce_mpc.model.machine.part_load import CostAtPartLoad
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.features import ZONE
from thermoforce_mpc.model.predictor import PredictionContext, Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import FreeResponse

# Largest offset added to a prediction, K: beyond, the model is wrong rather than off.
_OFFSET_K = 0.3

# Solvers that did not return and were replaced, before no more are started; besides a forecaster of each zone.
_SOLVERS_ABANDONED = 3


class ThermoForceMPC(FallbackController):
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
        name: str = "thermoforce_mpc",
    ) -> None:
        """Build predictor and solver.

        Args:
            model: identified thermal model, at any step.
            config: options.
            free_response: replaces the free response named in `config`; one for all zones, or one per zone (Z,).
            name: name in reports.

        Raises:
            ControllerConfigError: the horizon is shorter than a step, the actuation does not fit the step, or an option
                names a zone, an actuator or a meter that there is not.
            BackboneError, ConfigError: the free response cannot be built.
        """
        self.config = c = config or MPCConfig()
        step_s = c.step_s or model.operator.step_s
        model = replace(model, operator=model.operator.resampled(step_s))
        n_steps = c.n_steps(step_s)
        if n_steps < 1:
            raise ControllerConfigError(
                f"controller.options.horizon_h: {c.horizon_h:g} h is shorter than one control step"
                f" ({step_s:g} s); give at least {step_s / HOUR_S:g}"
            )
        layout = model.layout
        check_names("actuations", c.actuations, "actuator", layout.names.actuators)
        for machine, power in zip(model.machines, model.power, strict=True):
            if power is None:
                of = "" if len(model.machines) == 1 else f" of {machine}"
                raise ControllerConfigError(
                    f"the model was identified without measured power{of}: energy cost cannot be computed;"
                    " identify it anew from measurements with power (without a meter: the level times full power)"
                )
        self._zones = tuple(model.actuator(a) for a in range(len(layout.names.actuators)))
        choices = [
            choose_actuation(
                c.actuation_of(actuator),
                zone.power,
                zone.operator.heat_input,
                CostAtPartLoad.of(zone.card.uncertainty),
            )
            for actuator, zone in zip(layout.names.actuators, self._zones, strict=True)
            if zone.power is not None
        ]
        for choice, lowest in zip(choices, layout.lowest, strict=True):
            if choice.actuation.by_rooms != (lowest < 0.0):
                raise ControllerConfigError(
                    "controller.options.actuation.mode: room_setpoints and a model of heating and cooling belong "
                    "together"
                )
        super().__init__(name, step_s, n_steps, layout, [choice.actuation for choice in choices], c.fallback, c.guard)
        self._actuation_why = "; ".join(dict.fromkeys(self._told(a, choice.why) for a, choice in enumerate(choices)))
        self._formulation = Formulation(c, model, self._actuators)
        self._adaptations = tuple(OnlineAdaptation(zone, c.adaptation) for zone in self._zones)
        self._answer = DirectHandler(BoundedCalls(len(layout.names.zones) + _SOLVERS_ABANDONED))
        given = free_response or [_build_free_response(c.free_response, free) for free in model.free]
        methods = given if isinstance(given, Sequence) else [given] * len(layout.names.zones)
        free_responses = [self._with_substitutes(method) for method in methods]
        zones = layout.names.zones
        check_names("sensors", c.sensors, "zone", zones)
        self._sensing = ZoneSensors([Sensor(c.sensor_of(zone), "" if len(zones) == 1 else zone) for zone in zones])
        self._sunlit = Sunlit(model, [c.sensor_of(zone).enabled for zone in zones])
        self._meters = Meters(layout, c.meter, c.meters)
        self._planners = Planners(model, self._actuators, free_responses, c.estimator, self._solver_of())
        watches = [
            Watch(c.watch, zone, n_steps, partial(self._formulation.expected_power_W, a))
            for a, zone in enumerate(self._zones)
        ]
        self._watched = WatchedPredictions(watches, self._planners.of, model)

    @property
    def model(self) -> ThermalModel:
        """The model as identified, at the control step."""
        return self._planners.base.model

    @property
    def predictor(self) -> Predictor:
        """The predictor of `model`."""
        return self._planners.base.predictor

    @property
    def rules(self) -> tuple[FallbackPolicy, ...]:
        """The fallback policy of each actuator (A,)."""
        return self._fallbacks

    @property
    def planning_operator(self) -> BuildingOperator:
        """The operator of `model`, adjusted to the actuation, as `instance` goes with it."""
        return self._planners.base.operator

    def instance(self, context: PredictionContext, history: Record) -> MPCProblem:
        """The optimisation problem of a step for the model as identified, without offset and peak of a run.

        Raises:
            DataError: a bound or price of the boundary is missing.
        """
        nothing = np.zeros(len(self._layout.names.zones))
        return self._formulation.problem(self._planners.base.operator, context, history, 0.0, nothing)

    @property
    def actuation_in_words(self) -> str:
        """How each actuator is run, and what decided it."""
        return self._actuation_why

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """Plan for the next step.

        An exception of forecast, estimator or solver is not raised: the fallback policy decides, and `Plan.why` holds
        the reason. An actuator whose model is not competent or does not hold, or whose zone is not known any more, is
        left to native control or the rule alone; the others follow the plan.

        Raises:
            DataError: error of the caller: the observation is of another building, the boundary forecast does not begin
                now or is too short, its step or that of the history is not `step_s`, or `state` is not from an earlier
                plan of this controller.
        """
        return run(self.planning(observation, state), self._answer)

    def planning(self, observation: Observation, state: object = None) -> Computation[Plan]:
        """`plan` as a computation that asks for its forecasts and its solve, so that many plans are made together.

        It changes nothing but caches: one controller may make the plans of several buildings of the same model.
        """
        given, actuation = self._begun(observation, state, MPCState)
        actuators, zones = len(self._zones), len(self._layout.names.zones)
        before = given or MPCState(
            observation.time_s,
            adaptation=(None,) * actuators,
            watch=(WatchState(),) * actuators,
            offset_K=np.zeros(zones),
            missed=LearnedMargin.nothing(zones),
            kept=np.zeros(len(self._layout.names.machines)),
            sensors=(SensorState(),) * zones,
            meters=self._meters.begin,
        )
        before = replace(before, last_s=observation.time_s)
        try:
            before, rooms, news = self._in_rooms(before, observation)
            return with_news((yield from self._decided(rooms, before, actuation)), news)
        except Exception as error:  # whatever is wrong, the building is not left without control
            return self._released(before, actuation, f"no decision was made ({message_of(error)})")

    def _in_rooms(self, before: MPCState, observation: Observation) -> tuple[MPCState, Observation, str]:
        """The observation without the sun on sensors, which is looked for each night, and what was found."""
        history = self._sensing.believed(before.sensors, self._meters.believed(before.meters, observation.history))
        sun = self._sunlit.looked(before.sun, history)
        parts, news = self._sunlit.of_zones(sun), self._sunlit.news(before.sun, sun)
        if news and before.predictor:  # the forced state may follow the temperature
            before = replace(before, predictor=replace(before.predictor, forced=None))
        rooms = replace(observation, history=self.model.in_rooms(observation.history, parts))
        return replace(before, sun=sun), rooms, news

    def _decided(
        self, observation: Observation, before: MPCState, actuation: tuple[ActuationState, ...]
    ) -> Computation[Plan]:
        """The plan after `before`, with the actuators now at `actuation` (A,)."""
        actuators = len(self._zones)
        if before.failures >= self.config.fallback.cold_after:  # what it kept may be what fails
            before = replace(before, predictor=None)
        closed = [gate_reason(self.config.gate, zone.card.competence) for zone in self._zones]
        held = {a: Override(PlanStatus.GATE, why) for a, why in enumerate(closed) if why}
        history = self._meters.believed(before.meters, observation.history)
        boundary, filled = completed(observation.boundary, history, before.boundary)
        meters, metered = self._meters.judged(before.meters, history, boundary)
        observation = replace(observation, history=self._meters.believed(meters, history))
        if metered.found and before.predictor:  # the forced state was computed with them
            before = replace(before, predictor=replace(before.predictor, forced=None))
        filled = "; ".join(filter(None, (metered.why, filled)))
        history = self._sensing.believed(before.sensors, observation.history)
        forced = None if all(closed) else self._forced(before, history)
        forced_K = None if forced is None else forced.forced_K
        sensors, observation, zones_now = self._sensing.judged(before.sensors, observation, forced_K)
        as_planned = self._planners.of(before.adaptation) is self._planners.base and observation.history is history
        if forced and before.predictor and as_planned and gapless(history):
            before = replace(before, predictor=replace(before.predictor, forced=forced))  # not computed again
        now = replace(
            before,
            peak_W=self._peak_W(before, observation),
            offset_K=self._offset_K(before, observation),
            missed=self._missed(before, observation),
            kept=self._kept(before, observation),
            actuation=actuation,
            sensors=sensors,
            meters=meters,
            boundary=boundary if whole(observation.boundary) else before.boundary,
        )
        observation = replace(observation, boundary=boundary)
        if all(closed):
            return self._stood_back(observation, now, held, zones_now.T_C)
        now = self._watched.judged(now, observation.history, forced_K)
        held = zones_now.held(self._layout) | held
        for a, watch in enumerate(now.watch):
            if watch.alarm:
                held[a] = Override(PlanStatus.WATCH, self._watched.reason(watch, observation.time_s))
        if any(watch.alarm for watch in now.watch):
            shadowed = self._watched.shadowed(self._ahead(observation), now)
            now = yield from within(self.config.deadline.forecast_s, shadowed)
        if len(held) == actuators:
            plan = self._stood_back(observation, now, held, zones_now.T_C)
        else:
            plan = yield from self._planned(observation, now, held, zones_now, filled)
        return self._watched.asked(observation, with_news(plan, zones_now.news, metered.news))

    def _forced(self, now: MPCState, history: Record) -> ForcedState | None:
        """Forced states of the building until now; None at the start, or if unknown."""
        if now.predictor is None:
            return None
        try:
            return self._planners.base.predictor.followed(history, now.predictor)
        except Exception:  # as in planning: without it, nothing is judged in this step
            return None

    def _planned(
        self, observation: Observation, now: MPCState, held: Mapping[int, Override], zones: Zones, filled: str
    ) -> Computation[Plan]:
        """Predict, solve and check; the fallback policy acts where one of them fails."""
        history, limits = observation.history, self.config.deadline

        def fallen_back(reason: str, status: str, seconds: Mapping[str, float]) -> Plan:
            doubtful = [self._watched.doubtful(now, a) for a in range(len(self._zones))]
            reasons = "; ".join(filter(None, (reason, zones.bridged, filled)))
            return self._fall_back(observation, now, held, zones.T_C, doubtful, reasons, status, seconds)

        try:
            adaptation = self._adapted_now(now, history)
            planner = self._planners.of(adaptation)
            predictor = now.predictor
            if predictor and any(
                before is not None and after is not None and before.factors != after.factors
                for before, after in zip(now.adaptation, adaptation, strict=True)
            ):
                predictor = replace(predictor, forced=None)  # the forced state was computed with the previous operator
            contexting = planner.predictor.contexting(self._ahead(observation), predictor)
            context = yield from within(limits.forecast_s, contexting)
            learned = (now.peak_W, now.offset_K, now.missed, now.kept)
            problem = self._formulation.problem(planner.operator, context, history, *learned)
        except Exception as error:  # any exception of a forecaster leads to the fallback policy
            return fallen_back(f"no prediction ({message_of(error)})", "not started", {})
        now = replace(now, adaptation=adaptation, predictor=context.state)
        now = replace(now, sensors=self._sensing.anchored(now.sensors, history, context))
        now = self._watched.put_down(now, context, planner)
        try:
            solve = Solve(planner.solver, problem, self._guess(now.good, observation))
            solution, solve_s = yield from timed(perform(Request(planner.solver, solve, seconds=limits.solve_s)))
            refused = solution.problem if not solution.ok else problem.unfit(solution.u)
        except Exception as error:  # likewise for solvers
            if isinstance(error, Overdue):
                self._planners.renew_solver(planner)
            return fallen_back(f"the solver failed ({message_of(error)})", "raised", context.seconds)
        seconds = {**context.seconds, "solve": solve_s}
        if refused:
            return fallen_back(refused, solution.status, seconds)
        doubts = [zones.bridged, filled, context.free.doubt]
        now = replace(now, failures=0)
        plan = self._accept(
            observation, now, held, zones, planner.operator, problem, context, solution, seconds, doubts
        )
        return replace(plan, why=f"{plan.why}; {context.bridged}") if context.bridged else plan

    def _adapted_now(self, now: MPCState, history: Record) -> tuple[AdaptationState | None, ...]:
        """States of all adaptations after `history`; as they were where nothing is adapted."""
        if not self.config.adaptation.enabled:
            return now.adaptation
        forced_K = now.predictor.forced.forced_K if now.predictor and now.predictor.forced else None
        records = single_actuator_records(self._planners.base.model, history, forced_K)
        return tuple(
            adaptation.update(before, record)
            for adaptation, before, record in zip(self._adaptations, now.adaptation, records, strict=True)
        )

    def _with_substitutes(self, method: FreeResponse) -> FreeResponse:
        if self.config.free_response.substitutes:
            return WithSubstitutes(method)
        return WithSubstitutes(method, substitutes=())

    def _solver_of(self) -> Callable[[BuildingOperator], Solver]:
        """What builds the solver of an operator; overridden where something else than an optimisation decides."""
        return partial(build_solver, self.config, machinery=self._formulation.machinery)

    def _guess(self, good: GoodPlan | None, observation: Observation) -> Array | None:
        """Warm start (A, N): the plan of the previous step, shifted by one step; None without one."""
        if good is None or good.age(observation.time_s, self.step_s) != 1:
            return None
        return np.concatenate([good.u[:, 1:], good.u[:, -1:]], axis=1)

    def _offset_K(self, before: MPCState, observation: Observation) -> Array:
        """Mean errors of planned zone temperatures one step ahead (Z,), K, forgotten over `offset_h`.

        A machine that gives more or less heat at a level than its law misses every step to the same side; the mean of
        these errors is added to the prediction, so that the zone settles on the bound (offset-free control).
        """
        good, hours = before.good, self.config.offset_h
        if hours is None or good is None or good.age(observation.time_s, self.step_s) != 1:
            return before.offset_K
        error = observation.T_zone_C - good.T_zone_C[:, 0]
        weight = -np.expm1(-self.step_s / HOUR_S / hours)
        # The plan held the offset of its time: what it missed comes on top.
        found = before.offset_K + weight * np.where(np.isfinite(error), error, 0.0)
        return np.clip(found, -_OFFSET_K, _OFFSET_K)

    def _missed(self, before: MPCState, observation: Observation) -> LearnedMargin:
        """What was learned of the bounds after the last step, where a plan decided it."""
        good, now, allowed_K = before.good, observation.boundary, self.config.backoff_violation_K
        known = before.missed.meeting(now.lower_C, now.upper_C)
        # Plans of set-points have no back-off, since the plant's own loops keep them; this is for what these miss.
        by_loops = self.config.actuation.mode == "room_setpoints"
        learning = OF_LOOPS if by_loops else None if allowed_K is None else of_plans(allowed_K)
        if learning is None or good is None or good.age(observation.time_s, self.step_s) != 1:
            return known
        T_C = observation.T_zone_C
        lower_C, upper_C = now.lower_C[:, 0], now.upper_C[:, 0]
        beyond_K = np.stack([lower_C - T_C, T_C - upper_C])
        spare = self._formulation.spare(observation.history.u[:, -1])
        if by_loops:
            spare &= known.set_back(slice(None), lower_C, upper_C)
        return replace(known, reserve_K=learned_K(known.reserve_K, beyond_K, spare, self.step_s, learning))

    def _kept(self, before: MPCState, observation: Observation) -> Array:
        """Share of each machine's capacity to be left unused (M,), learned from the last step, which a plan decided."""
        good = before.good
        if good is None or good.age(observation.time_s, self.step_s) != 1:
            return before.kept
        return self._formulation.kept_capacity(before.kept, self._planners.base.operator, observation.history)

    def _peak_W(self, before: MPCState, observation: Observation) -> float:
        """Highest mean power of the building over a step since the first plan, W."""
        power = observation.history.power_W
        if power.shape[1] and observation.time_s > before.first_s and np.isfinite(power[:, -1]).all():
            return max(before.peak_W, float(power[:, -1].sum()))
        return before.peak_W

    def _accept(
        self,
        observation: Observation,
        now: MPCState,
        held: Mapping[int, Override],
        zones: Zones,
        operator: BuildingOperator,
        problem: MPCProblem,
        context: PredictionContext,
        solution: Solution,
        seconds: Mapping[str, float],
        doubts: Sequence[str],
    ) -> Plan:
        """The plan of a checked solution; `doubts`: what stands in for what, '' where nothing does."""
        u, forecast = solution.u, context.free
        forced_K = problem.forced_K(operator, u)
        T_zone_C = problem.T_free_C + forced_K
        slack_K = problem.slack_K(T_zone_C)
        band_K = 0.5 * (forecast.quantile_C(0.9) - forecast.quantile_C(0.1))
        good = GoodPlan(observation.time_s, u, T_zone_C.copy(), band_K)
        for kept in (good.T_zone_C, good.band_K):
            kept[list(context.unmeasured)] = np.nan
        demands = [
            self._room_blocks(observation, a, float(u[a, 0]), T_zone_C[:, 0], zones.T_C, now.missed)
            if actuation.by_rooms
            else float(u[a, 0])
            for a, actuation in enumerate(self._actuators.each)
        ]
        names = self._layout.names
        status = PlanStatus.BRIDGED if any(doubts) else PlanStatus.SOLVED
        if not solution.optimal:
            status = PlanStatus.ACCEPTABLE
        reasons = (reason_of(problem, names.zones, T_zone_C, slack_K, forecast), *doubts)
        plan = Plan(
            blocks=(),
            status=status,
            why="; ".join(filter(None, (solution.problem, *reasons))),
            u=u,
            T_free_now_C=problem.features[:, 0, ZONE],
            T_free_C=problem.T_free_C,
            T_forced_K=forced_K,
            T_free_low_C=forecast.quantile_C(0.1),
            T_free_high_C=forecast.quantile_C(0.9),
            slack_K=slack_K,
            power_W=problem.power_W(u),
            time_s=observation.boundary.time_s[: u.shape[1]],
            origin=observation.history.origin,
            solver_status=solution.status,
            iterations=solution.iterations,
            seconds=seconds,
            names=names,
            state=replace(now, good=good),
        )
        acted = self._acted(observation, plan, demands, held, zones.T_C)
        return self._with_guard(observation, acted, demands, held, now, zones.T_C)

    def _room_blocks(
        self, observation: Observation, a: int, u: float, T_end_C: Array, T_now_C: Array, missed: LearnedMargin
    ) -> tuple[Block, ...]:
        """Room set-points of the first step for actuator `a`, from the temperatures of all zones (Z,)."""
        z, bounds = self._layout.home[a], observation.boundary
        lower_C, upper_C = bounds.lower_C[z, :1], bounds.upper_C[z, :1]
        inside_K = self.config.comfort_margin_K + missed.inside_K(z, lower_C, upper_C, by_loops=True)[:, 0]
        last = observation.history.u[a, -1:]
        return room_blocks(
            u,
            float(T_end_C[z]),
            T_now_C=float(T_now_C[z]),
            u_last=float(last[0]) if last.size else float("nan"),
            bounds_C=within_C(float(lower_C[0]), float(upper_C[0]), inside_K),
            lowest=self._layout.lowest[a],
            step_s=self.step_s,
            block_s=self._actuators.each[a].config.block_s,
        )


def _build_free_response(config: FreeResponseConfig, free: RcParameters | None) -> FreeResponse:
    from thermoforce_mpc.model.free_response.registry import build_free_response  # may load torch

    return build_free_response(config.name, rc=free, **config.options)
