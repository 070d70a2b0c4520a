"""ThermoForce MPC: predict free and forced response, solve, check, act, and fall back with a reason when that fails."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from controllers.actuation import Actuation
from controllers.backoff import backoff_K
from controllers.errors import ControllerConfigError
from controllers.fallback import FallbackPolicy
from controllers.mpc_config import FreeResponseConfig, MPCConfig
from controllers.problem import MPCProblem, Solution, Weights
from controllers.solvers import build_solver
from thermoforce_mpc.data import HOUR_S, Array, FreeForecast, Observation, Plan, PlanStatus, Record
from thermoforce_mpc.errors import DataError, ThermoForceError
from thermoforce_mpc.identification.adaptation import OnlineAdaptation
from thermoforce_mpc.model.forced_state import ForcedStateEstimator
from thermoforce_mpc.model.operator.features import ZONE
from thermoforce_mpc.model.predictor import PredictionContext, Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import FreeResponse

# A bound nearer than this shapes the plan, K.
_BINDING_K = 0.02

# What a forecast or a solve may raise on data nobody foresaw; anything else is a bug and must surface.
_SURVIVABLE = (ThermoForceError, ValueError, ArithmeticError, RuntimeError)


class ThermoForceMPC:
    """Receding-horizon control over the superposition of a free and a forced response (paper eq:compose).

    ```python
    from controllers import ThermoForceMPC
    from thermoforce_mpc.model.thermal_model import load_model

    controller = ThermoForceMPC(load_model("my_model"))
    plan = controller.plan(observation)
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
        """Build the problem once.

        Args:
            model: identified thermal model, at any step.
            config: options.
            free_response: use this one instead of the one named in `config`.
            name: name in reports.

        Raises:
            ControllerConfigError: the horizon is shorter than a step, or the actuation does not fit the step.
            BackboneError, ConfigError: the free response cannot be built.
        """
        self.config, self._name = config or MPCConfig(), name
        c = self.config
        step_s = c.step_s or model.operator.step_s
        model = replace(model, operator=model.operator.resampled(step_s))
        self._n_steps = c.n_steps(step_s)
        if self._n_steps < 1:
            raise ControllerConfigError(
                f"controller.options.horizon_h: {c.horizon_h:g} h is shorter than one control step"
                f" ({step_s:g} s); give at least {step_s / HOUR_S:g}"
            )
        if c.actuation.mode == "duty" and step_s < 2 * c.actuation.block_s:
            raise ControllerConfigError(
                f"controller.options.actuation.block_s: blocks of {c.actuation.block_s:g} s cannot share a step of"
                f" {step_s:g} s; use shorter blocks or mode: modulating"
            )
        if model.power is None:
            raise ControllerConfigError("the model was identified without measured power: energy cannot be planned")
        self._actuation = Actuation(c.actuation)
        self._power = model.power.at_lowest_level(self._actuation.lowest_level)
        self._adaptation = OnlineAdaptation(model, c.adaptation)
        self._use(model, free_response or _build_free_response(c.free_response, model))
        self._peak_W = 0.0
        self._first_s: float | None = None
        mode = "heating" if model.operator.sign > 0 else "cooling"
        self._fallback = FallbackPolicy(c.fallback, self.step_s, self._actuation.highest, mode)

    @property
    def name(self) -> str:
        """Name in reports."""
        return self._name

    @property
    def step_s(self) -> float:
        """How long a plan is followed, s."""
        return self.model.operator.step_s

    @property
    def horizon_s(self) -> float:
        """How far ahead the boundary forecast is needed, s."""
        return self._n_steps * self.step_s

    def plan(self, observation: Observation) -> Plan:
        """Decide for the next step. A failed forecast or solve does not raise: the fallback policy acts."""
        self._observe_peak(observation)
        try:
            adapted = self._adaptation.update(observation.history)
            if adapted is not self.model:
                self._use(adapted, self.predictor.free_response)
            context = self._context(observation)
            problem = self._problem(context, observation.history)
        except _SURVIVABLE as error:
            return self._fall_back(observation, f"no prediction ({error})", "not started", {})
        began = time.perf_counter()
        solution = self._solver.solve(problem)
        seconds = {**context.seconds, "solve": time.perf_counter() - began}
        if not solution.ok:
            return self._fall_back(observation, solution.problem, solution.status, seconds)
        return self._accept(observation, problem, context.free, solution, seconds)

    @property
    def adaptation(self) -> OnlineAdaptation:
        """What online adaptation has done so far; nothing where it is off."""
        return self._adaptation

    def _use(self, model: ThermalModel, free_response: FreeResponse) -> None:
        """Predict and plan with `model` from now on."""
        self.model = model
        # The plan's model has to match the actuation: in both, the machine switches below its lowest level.
        lowest = self._actuation.lowest_level
        self._operator = replace(model.operator, heat_input=model.operator.heat_input.at_lowest_level(lowest))
        estimator = ForcedStateEstimator(model.operator, config=self.config.estimator)
        self.predictor = Predictor(model, free_response, estimator=estimator)
        self._solver = build_solver(self.config, self._operator, self._actuation)

    def _context(self, observation: Observation) -> PredictionContext:
        """Forecast the free response over the horizon."""
        boundary = observation.boundary
        if boundary.n_steps < self._n_steps:
            raise DataError(f"boundary forecast has {boundary.n_steps} steps, the horizon needs {self._n_steps}")
        context = self.predictor.context(Observation(observation.history, boundary.head(self._n_steps)))
        T_free = context.free.median_C
        if T_free.shape != (self._n_steps,) or not np.isfinite(T_free).all():
            raise DataError(f"free response '{self.predictor.free_response.name}' is not {self._n_steps} finite values")
        return context

    def _problem(self, context: PredictionContext, history: Record) -> MPCProblem:
        """Put all numbers of this instance together."""
        c, boundary, T_free = self.config, context.boundary, context.free.median_C
        aims = c.objective
        price = boundary.price_per_kWh[:-1] + aims.carbon_price_per_kg * boundary.emission_kg_per_kWh[:-1]
        fixed_W, per_u_W = self._power.parts(boundary.T_out_C[:-1], self._return_water_C(context, history))
        low, high = c.backoff_level, c.backoff_level_other
        if self._operator.sign < 0:
            low, high = high, low
        below, above = (
            np.minimum(
                backoff_K(context.free, self.step_s, level, c.backoff_violation_K, below=is_lower), c.backoff_max_K
            )
            for level, is_lower in ((low, True), (high, False))
        )
        # Margins wider than half the band would turn the bounds around.
        half = 0.5 * (boundary.upper_C[1:] - boundary.lower_C[1:])
        return MPCProblem(
            forced_state_K=context.forced_K,
            features=context.features,
            T_free_C=T_free,
            lower_C=boundary.lower_C[1:] + np.minimum(c.comfort_margin_K + below, half),
            upper_C=boundary.upper_C[1:] - np.minimum(c.comfort_margin_K + above, half),
            price_per_kWh=price,
            power_fixed_W=fixed_W,
            power_per_u_W=per_u_W,
            step_s=self.step_s,
            u_max=self._actuation.highest,
            lowest_level=self._actuation.lowest_level,
            weights=Weights(aims.comfort_weight, aims.curvature, aims.peak_price_per_kW / 1000.0),
            terminal_price_per_K=self._terminal_price(context.features[-1], price[-1] * (fixed_W + per_u_W)[-1]),
            peak_so_far_W=self._peak_W,
        )

    def _return_water_C(self, context: PredictionContext, history: Record) -> Array | float:
        """Return water of a running machine over the steps, (N,), °C; NaN where the power does not know it.

        The zone is taken to be where comfort ends or the free response carries it: to let the water follow
        the planned temperature would make the problem bilinear for less than a percent of the power.
        """
        if self._power.water is None:
            return float("nan")
        boundary, T_free_C = context.boundary, context.free.median_C
        held_C = np.clip(T_free_C, boundary.lower_C[1:], boundary.upper_C[1:])
        return self._power.water.expected_C(history, held_C)

    def _terminal_price(self, features: Array, cost_per_kW_h: float) -> Array:
        """What a kelvin of each mode is worth at the end, (r,): only the slowest keeps its heat beyond the horizon.

        At a terminal value of 1 a kelvin there is worth what it costs to make it in the last step.
        """
        operator = self._operator
        price = np.zeros(operator.order)
        drive = float(operator.drive(np.array([self._actuation.highest]), features[None])[0])
        per_step = cost_per_kW_h / 1000.0 * self.step_s / HOUR_S
        price[-1] = self.config.objective.terminal_value * per_step / (operator.gains[-1] * drive)
        return price

    def _observe_peak(self, observation: Observation) -> None:
        """Keep the highest mean power of a step since this controller took over."""
        if self._first_s is None:
            self._first_s = observation.time_s
        power = observation.history.power_W[-1:]
        if power.size and observation.time_s > self._first_s and np.isfinite(power[0]):
            self._peak_W = max(self._peak_W, float(power[0]))

    def _accept(
        self,
        observation: Observation,
        problem: MPCProblem,
        forecast: FreeForecast,
        solution: Solution,
        seconds: dict[str, float],
    ) -> Plan:
        u = solution.u
        forced_K = problem.forced_K(self._operator, u)
        slack_K = problem.slack_K(problem.T_free_C + forced_K)
        plan = Plan(
            blocks=self._actuation.realise(float(u[0]), self.step_s),
            status=PlanStatus.SOLVED,
            why=_reason(problem, problem.T_free_C + forced_K, slack_K, forecast),
            u=u,
            T_free_now_C=float(problem.features[0, ZONE]),
            T_free_C=problem.T_free_C,
            T_forced_K=forced_K,
            T_free_low_C=forecast.quantile_C(0.1),
            T_free_high_C=forecast.quantile_C(0.9),
            slack_K=slack_K,
            power_W=problem.power_W(u),
            solver_status=solution.status,
            iterations=solution.iterations,
            seconds=seconds,
        )
        self._fallback.remember(plan, observation.time_s)
        return plan

    def _fall_back(self, observation: Observation, reason: str, solver_status: str, seconds: dict[str, float]) -> Plan:
        u = self._fallback.level_to_follow(observation)
        if u is None:
            plan = self._fallback.rule(observation, reason)
        else:
            blocks = self._actuation.realise(min(max(u, 0.0), self._actuation.highest), self.step_s)
            plan = Plan(blocks, PlanStatus.SHIFTED, f"{reason}; following the previous plan (u = {u:.2f})")
        return replace(plan, solver_status=solver_status, seconds=seconds)


def _build_free_response(config: FreeResponseConfig, model: ThermalModel) -> FreeResponse:
    from thermoforce_mpc.model.free_response.registry import build_free_response  # may load torch

    return build_free_response(config.name, rc=model.free, **config.options)


def _reason(problem: MPCProblem, T_zone_C: Array, slack_K: Array, forecast: FreeForecast) -> str:
    """One sentence: which bound shapes the plan and when, and how wide the forecast is there."""
    band = forecast.quantile_C(0.9) - forecast.quantile_C(0.1)
    violated = int(np.argmax(slack_K))
    if slack_K[violated] > 1e-3:
        side = "below" if T_zone_C[violated] < problem.lower_C[violated] else "above"
        what = f"{slack_K[violated]:.2f} K {side} the comfort band cannot be avoided economically"
        when = violated
    else:
        gap = np.minimum(T_zone_C - problem.lower_C, problem.upper_C - T_zone_C)
        # The first of the bounds that bind, not the tightest: the next hours are spent on that one.
        when = int(np.argmax(gap <= max(_BINDING_K, float(gap.min()))))
        if gap[when] > _BINDING_K:
            return (
                f"comfort is not binding within the horizon (nearest {gap[when]:.2f} K); free forecast: {forecast.note}"
            )
        side = "lower" if T_zone_C[when] - problem.lower_C[when] <= problem.upper_C[when] - T_zone_C[when] else "upper"
        what = f"{side} bound binds"
    hours = (when + 1) * problem.step_s / HOUR_S
    return f"{what} in {hours:g} h (80 % band of the free forecast there: {band[when]:.2f} K)"
