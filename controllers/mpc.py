"""ThermoForce MPC: predict free and forced response, solve, check the solution, convert it to blocks, or fall back."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from controllers.acting import Acting
from controllers.actuation_choice import choose_actuation
from controllers.assembly import Assembly
from controllers.errors import ControllerConfigError, said
from controllers.fallback import GoodPlan
from controllers.gate import shut
from controllers.guard import guard_level
from controllers.mpc_config import FreeResponseConfig, MPCConfig
from controllers.planner import MPCState, Planner
from controllers.problem import MPCProblem, Solution
from controllers.room import room_blocks, within_C
from controllers.solvers import build_solver
from controllers.watch import Watch
from controllers.watched import WatchedPredictions
from thermoforce_mpc.data import HOUR_S, Array, Block, FreeForecast, Observation, Plan, PlanStatus, Record
from thermoforce_mpc.identification.adaptation import OnlineAdaptation
from thermoforce_mpc.model.forced_state import ForcedStateEstimator
from thermoforce_mpc.model.operator.building import BuildingOperator, single
from thermoforce_mpc.model.operator.features import ZONE
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import FreeResponse

# A bound nearer than this is reported as binding, K.
_BINDING_K = 0.02

# Largest offset added to a prediction, K: beyond, the model is wrong rather than off.
_OFFSET_K = 0.3

# Number of cached planners for adapted models; others are rebuilt when needed.
_PLANNERS_KEPT = 4


class ThermoForceMPC(Acting):
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
        free_response: FreeResponse | None = None,
        name: str = "thermoforce_mpc",
    ) -> None:
        """Build predictor and solver.

        Args:
            model: identified thermal model, at any step.
            config: options.
            free_response: replaces the free response named in `config`.
            name: name in reports.

        Raises:
            ControllerConfigError: the horizon is shorter than a step, or the actuation does not fit the step.
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
        if model.power is None:
            raise ControllerConfigError(
                "the model was identified without measured power: energy cost cannot be computed"
            )
        choice = choose_actuation(c.actuation, model.power, model.operator.heat_input)
        self._actuation_why = choice.why
        super().__init__(name, step_s, n_steps, choice.actuation, c.fallback, model.operator.mode)
        self._power = model.power.at_lowest_level(self._actuation.lowest_level)
        if self._actuation.by_rooms != (model.operator.heat_input.lowest < 0.0):
            raise ControllerConfigError(
                "controller.options.actuation.mode: room_setpoints and a model of heating and cooling belong together"
            )
        self._assembly = Assembly(c, self._actuation, self._power, model.card, step_s)
        self._adaptation = OnlineAdaptation(model, c.adaptation)
        self._watch = WatchedPredictions(Watch(c.watch, model, n_steps, self._expected_power_W), self._planner)
        self._free_response = free_response or _build_free_response(c.free_response, model)
        self._base = self._build_planner(model)
        self._adapted: list[Planner] = []

    @property
    def model(self) -> ThermalModel:
        """The model as identified, at the control step."""
        return self._base.model

    @property
    def predictor(self) -> Predictor:
        """The predictor of `model`."""
        return self._base.predictor

    @property
    def actuation_in_words(self) -> str:
        """How the machine is run, and what decided it."""
        return self._actuation_why

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """Plan for the next step.

        An exception of forecast, estimator or solver is not raised: the fallback policy decides, and `Plan.why` holds
        the reason.

        Raises:
            DataError: error of the caller: the boundary forecast is too short, its step or that of the history is not
                `step_s`, or `state` is not from a plan of this controller.
        """
        given, actuation = self._begun(observation, state, MPCState)
        before = given or MPCState(first_s=observation.time_s)
        now = replace(
            before,
            peak_W=self._peak_W(before, observation),
            offset_K=self._offset_K(before, observation),
            actuation=actuation,
        )
        closed = shut(self.config.gate, self.model.card.competence)
        if closed is not None:
            return self._stand_back(observation, now, PlanStatus.GATE, closed)
        now = self._watch.judged(now, observation.history)
        if now.watch.alarm:
            now = self._watch.shadowed(self._ahead(observation), now)
            reason = self._watch.reason(now.watch, observation.time_s)
            return self._watch.asked(observation, self._stand_back(observation, now, PlanStatus.WATCH, reason))
        return self._watch.asked(observation, self._guarded(observation, now, self._planned(observation, now)))

    def _expected_power_W(self, record: Record) -> Array:
        """Electric power (n,), W, for the levels of a record."""
        return self._power(
            np.clip(record.u, self.model.operator.heat_input.lowest, 1.0), record.T_out_C[:-1], record.T_return_C
        )

    def _planned(self, observation: Observation, now: MPCState) -> Plan:
        """Predict, solve and check; the fallback policy acts where one of them fails."""
        history = observation.history
        try:
            adaptation = self._adaptation.update(now.adaptation, history)
            planner = self._planner(adaptation.model)
            predictor = now.predictor
            if predictor and now.adaptation and adaptation.model is not now.adaptation.model:
                predictor = replace(predictor, forced=None)  # the forced state was computed with the previous operator
            context = planner.predictor.context(self._ahead(observation), predictor)
            problem = self._assembly.problem(planner.operator, context, history, now.peak_W, now.offset_K)
        except Exception as error:  # any exception of a forecaster leads to the fallback policy
            return self._fall_back(observation, now, f"no prediction ({said(error)})", "not started", {})
        now = replace(now, adaptation=adaptation, predictor=context.state)
        now = self._watch.put_down(now, context, planner.operator)
        began = time.perf_counter()
        try:
            solution = planner.solver.solve(problem, self._guess(now.good, observation))
        except Exception as error:  # likewise for solvers
            return self._fall_back(observation, now, f"the solver failed ({said(error)})", "raised", context.seconds)
        seconds = {**context.seconds, "solve": time.perf_counter() - began}
        if not solution.ok:
            return self._fall_back(observation, now, solution.problem, solution.status, seconds)
        plan = self._accept(observation, now, planner.building, problem, context.free, solution, seconds)
        return replace(plan, why=f"{plan.why}; {context.bridged}") if context.bridged else plan

    def _guarded(self, observation: Observation, now: MPCState, plan: Plan) -> Plan:
        """The plan, or the guard's level in its place while the zone is far outside the comfort band."""
        if self._actuation.by_rooms or any(block.u is None for block in plan.blocks):
            return plan  # the plant's own control acts on the bounds
        planned = sum((block.u or 0.0) * block.duration_s for block in plan.blocks) / self.step_s
        sign, highest = self.model.operator.sign, self._actuation.highest
        found = guard_level(self.config.guard, observation, u=planned, highest=highest, sign=sign)
        if found is None:
            return plan
        level, why = found
        blocks, actuation = self._actuation.realise(level, self.step_s, now.actuation)
        if blocks == plan.blocks:  # minimum on or off time: the machine cannot do more
            return plan
        assert isinstance(plan.state, MPCState)
        # The plan is not followed, so it must not be shifted later.
        state = replace(plan.state, actuation=actuation, good=now.good)
        return replace(plan, blocks=blocks, status=PlanStatus.GUARD, why=f"{why}; {plan.why}", state=state)

    def _planner(self, model: ThermalModel) -> Planner:
        """The planner of `model`, from the cache if present."""
        for planner in (self._base, *self._adapted):
            if planner.model is model:
                return planner
        planner = self._build_planner(model)
        self._adapted = [*self._adapted, planner][-_PLANNERS_KEPT:]
        return planner

    def _build_planner(self, model: ThermalModel) -> Planner:
        # The operator must match the actuation: below the lowest level the machine switches.
        lowest = self._actuation.lowest_level
        operator = replace(model.operator, heat_input=model.operator.heat_input.at_lowest_level(lowest))
        estimator = ForcedStateEstimator(model.operator, config=self.config.estimator)
        predictor = Predictor(model.operator, self._free_response, estimator=estimator)
        building = single(operator)
        solver = build_solver(self.config, building, self._assembly.machinery(operator))
        return Planner(model, predictor, operator, building, solver)

    def _guess(self, good: GoodPlan | None, observation: Observation) -> Array | None:
        """Warm start (1, N): the plan of the previous step, shifted by one step; None without one."""
        if good is None or good.age(observation.time_s, self.step_s) != 1:
            return None
        return np.append(good.u[1:], good.u[-1])[None]

    def _offset_K(self, before: MPCState, observation: Observation) -> float:
        """Mean error of planned zone temperatures one step ahead, K, forgotten over `offset_h`.

        A machine that gives more or less heat at a level than its law misses every step to the same side; the mean of
        these errors is added to the prediction, so that the zone settles on the bound (offset-free control).
        """
        good, hours = before.good, self.config.offset_h
        if hours is None or good is None or good.age(observation.time_s, self.step_s) != 1:
            return before.offset_K
        error = observation.T_zone_C - float(good.T_zone_C[0])
        if not np.isfinite(error):
            return before.offset_K
        weight = -np.expm1(-self.step_s / HOUR_S / hours)
        # The plan held the offset of its time: what it missed comes on top.
        found = before.offset_K + weight * error
        return float(np.clip(found, -_OFFSET_K, _OFFSET_K))

    def _peak_W(self, before: MPCState, observation: Observation) -> float:
        """Highest mean power of a step since the first plan, W."""
        power = observation.history.power_W[-1:]
        if power.size and observation.time_s > before.first_s and np.isfinite(power[0]):
            return max(before.peak_W, float(power[0]))
        return before.peak_W

    def _accept(
        self,
        observation: Observation,
        now: MPCState,
        operator: BuildingOperator,
        problem: MPCProblem,
        forecast: FreeForecast,
        solution: Solution,
        seconds: Mapping[str, float],
    ) -> Plan:
        u = solution.u[0]
        forced_K = problem.forced_K(operator, solution.u)[0]
        T_zone_C = problem.T_free_C[0] + forced_K
        slack_K = problem.slack_K(T_zone_C[None])[0]
        band_K = 0.5 * (forecast.quantile_C(0.9) - forecast.quantile_C(0.1))
        if self._actuation.by_rooms:
            blocks, actuation = self._room_blocks(observation, float(u[0]), float(T_zone_C[0])), now.actuation
        else:
            blocks, actuation = self._actuation.realise(float(u[0]), self.step_s, now.actuation)
        return Plan(
            blocks=blocks,
            status=PlanStatus.SOLVED,
            why=_reason(problem, T_zone_C, slack_K, forecast),
            u=u,
            T_free_now_C=float(problem.features[0, 0, ZONE]),
            T_free_C=problem.T_free_C[0],
            T_forced_K=forced_K,
            T_free_low_C=forecast.quantile_C(0.1),
            T_free_high_C=forecast.quantile_C(0.9),
            slack_K=slack_K,
            power_W=problem.power_W(solution.u).sum(axis=0),
            time_s=observation.boundary.time_s[: u.size],
            origin=observation.history.origin,
            solver_status=solution.status,
            iterations=solution.iterations,
            seconds=seconds,
            state=replace(now, actuation=actuation, good=GoodPlan(observation.time_s, u, T_zone_C, band_K)),
        )

    def _room_blocks(self, observation: Observation, u: float, T_end_C: float) -> tuple[Block, ...]:
        """Room set-points of the first step."""
        lower_C, upper_C = (float(bound[0]) for bound in (observation.boundary.lower_C, observation.boundary.upper_C))
        bounds = within_C(lower_C, upper_C, self.config.comfort_margin_K)
        last = observation.history.u[-1:]
        return room_blocks(
            u,
            T_end_C,
            T_now_C=observation.T_zone_C,
            u_last=float(last[0]) if last.size else float("nan"),
            bounds_C=bounds,
            lowest=self.model.operator.heat_input.lowest,
            step_s=self.step_s,
            block_s=self.config.actuation.block_s,
        )

    def _stand_back(self, observation: Observation, now: MPCState, status: PlanStatus, reason: str) -> Plan:
        """A step of native control or of the on/off rule (`fallback.stand_back`); nothing is planned."""
        blocks, actuation, who = self._standing_back(observation, now.actuation)
        # The plan before was not followed, so it must not be shifted later.
        return Plan(blocks, status, f"{reason}: {who}", state=replace(now, actuation=actuation, good=None))

    def _fall_back(
        self, observation: Observation, now: MPCState, reason: str, solver_status: str, seconds: Mapping[str, float]
    ) -> Plan:
        good = None if self._watch.doubtful(now.watch) else now.good
        u = self._fallback.level_to_follow(good, observation)
        if u is not None:
            status, why = PlanStatus.SHIFTED, f"following the previous plan (u = {u:.2f})"
        else:
            status = PlanStatus.THERMOSTAT
            u, why = self._fallback.rule(observation)
        blocks, actuation = self._actuation.realise(u, self.step_s, now.actuation)
        return Plan(
            blocks,
            status,
            f"{reason}; {why}",
            solver_status=solver_status,
            seconds=seconds,
            state=replace(now, actuation=actuation),
        )


def _build_free_response(config: FreeResponseConfig, model: ThermalModel) -> FreeResponse:
    from thermoforce_mpc.model.free_response.registry import build_free_response  # may load torch

    return build_free_response(config.name, rc=model.free, **config.options)


def _reason(problem: MPCProblem, T_zone_C: Array, slack_K: Array, forecast: FreeForecast) -> str:
    """One sentence: which bound is binding and when, and the width of the forecast's 80 % band there."""
    band = forecast.quantile_C(0.9) - forecast.quantile_C(0.1)
    lower_C, upper_C = problem.lower_C[0], problem.upper_C[0]
    violated = int(np.argmax(slack_K))
    if slack_K[violated] > 1e-3:
        side = "below" if T_zone_C[violated] < lower_C[violated] else "above"
        what = f"{slack_K[violated]:.2f} K {side} the comfort band cannot be avoided economically"
        when = violated
    else:
        gap = np.minimum(T_zone_C - lower_C, upper_C - T_zone_C)
        # The first binding bound, not the tightest: it determines the plan of the next hours.
        when = int(np.argmax(gap <= max(_BINDING_K, float(gap.min()))))
        if gap[when] > _BINDING_K:
            return (
                f"comfort is not binding within the horizon (nearest {gap[when]:.2f} K); free forecast: {forecast.note}"
            )
        side = "lower" if T_zone_C[when] - lower_C[when] <= upper_C[when] - T_zone_C[when] else "upper"
        what = f"{side} bound binds"
    hours = (when + 1) * problem.step_s / HOUR_S
    return f"{what} in {hours:g} h (80 % band of the free forecast there: {band[when]:.2f} K)"
