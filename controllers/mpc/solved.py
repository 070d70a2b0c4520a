"""From a checked solution to a plan for people and for the next step, and what it asks of each actuator now."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.actuation.actuators import Actuators, Demand, PowerLimit
from controllers.actuation.room_setpoints import room_blocks, within_C
from controllers.mpc.commands.commanding import Commanded
from controllers.mpc.config import MPCConfig
from controllers.mpc.formulation import Instance
from controllers.mpc.readings import Forecast, Readings, joined
from controllers.mpc.state import MPCState
from controllers.optimisation.plan_model import Evaluation, Evaluator
from controllers.optimisation.problem import MPCProblem
from controllers.optimisation.solution import Solution
from controllers.safety.fallback_policy import GoodPlan
from thermoforce_mpc.commands.command import SAME
from thermoforce_mpc.data import HOUR_S, Array, FreeForecast, HotWaterPlan, Plan, PlanStatus
from thermoforce_mpc.data.limits import ZONE_C
from thermoforce_mpc.data.plan import NOT_ECONOMICAL
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.model.machine.load import LEVEL_EDGE
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import ZONE

# Share of full level from which a plan makes loops work. By judgement.
_WORKS_FROM = 0.5
# A bound nearer than this is reported as binding, K. Of words only; by judgement.
_BINDING_K = 0.02
# Share of what is missing that more heat must have brought, for money to be the reason that it is missing. By
# judgement.
_BOUGHT = 0.5


class Solved(NamedTuple):
    """A plan without blocks, its problem, the limit of power that blocks are to keep, its commands, and values of the
    user's own variables; None where there is none.
    """

    plan: Plan
    problem: MPCProblem
    limit: PowerLimit | None
    commanded: Commanded | None = None
    own_values: Array | None = None

    def with_tank(self, hot_water: HotWaterPlan | None, why: str) -> Solved:
        """The same with what is set at a tank of hot water; `why` nothing is, where it is None."""
        plan, state = self.plan, self.plan.state
        assert isinstance(state, MPCState)
        told = None if hot_water is None else hot_water.command[0]
        if told is None:
            tank = None
        else:
            same = state.tank is not None and abs(state.tank[0] - told) <= SAME
            tank = (told, state.tank[1] if same and state.tank is not None else float(plan.time_s[0]))
        plan = replace(plan, hot_water=hot_water, why=joined([why, plan.why]), state=replace(state, tank=tank))
        return self._replace(plan=plan)


def power_limit(instance: Instance, solution: Solution, brought: Evaluation, evaluator: Evaluator) -> PowerLimit | None:
    """The limit of power in the first step; None without a cap and a price of peaks.

    `brought`: what the levels of `solution` bring; `evaluator` says what others would take.
    """
    problem = instance.problem
    if math.isinf(instance.cap_W) and not problem.weights.peak:
        return None
    numbers, highest_W = evaluator.numbers(problem), float(brought.power_W.sum(axis=0).max())

    def power_W(levels: Array) -> float:
        u = np.concatenate([levels[:, None], solution.u[:, 1:]], axis=1)
        return float(evaluator.evaluate(numbers, u, solution.own_values).power_W[:, 0].sum())

    return PowerLimit(
        cap_W=instance.cap_W,
        peak_W=max(problem.peak_so_far_W, highest_W) if problem.weights.peak else math.inf,
        planned=solution.u[:, 0].copy(),
        power_W=power_W,
    )


def beyond_rooms(problem: MPCProblem, brought: Evaluation, zones: Sequence[str]) -> str:
    """Why what a plan predicts is not what a room can be (`data.limits`), so that it is none; or ''."""
    T_zone_C, (low_C, high_C) = compose(problem.T_free_C, brought.forced_K), ZONE_C
    off_K = np.maximum(low_C - T_zone_C, T_zone_C - high_C)
    z, k = (int(i) for i in np.unravel_index(np.argmax(np.where(np.isnan(off_K), np.inf, off_K)), off_K.shape))
    if off_K[z, k] <= 0.0:
        return ""
    free_C, ahead_h = problem.T_free_C[z, k], (k + 1) * problem.step_s / HOUR_S
    return (
        f"no plan can be right that predicts {T_zone_C[z, k]:.4g} °C in {zones[z]} {ahead_h:g} h ahead "
        f"({free_C:.4g} °C without action), beyond {low_C:g} to {high_C:g} °C"
    )


def solved_plan(
    instance: Instance,
    solution: Solution,
    brought: Evaluation,
    seconds: Mapping[str, float],
    forecast: Forecast,
    readings: Readings,
    free_steps: int,
) -> Plan:
    """The plan of a checked solution, without blocks; its state remembers it as the last good one.

    `brought`: what its levels bring; `seconds`: what its parts cost, s; `free_steps`: see `reason_of`.
    """
    problem, context, free = instance.problem, forecast.context, forecast.context.free
    u, names = solution.u, readings.observation.names
    T_zone_C, slack_K = compose(problem.T_free_C, brought.forced_K), brought.slack_K
    doubts, learned = (*readings.doubts, free.doubt), forecast.state.margins
    status = PlanStatus.BRIDGED if any(doubts) else PlanStatus.SOLVED
    comfort_C = np.array([context.boundary.lower_C[:, 1:], context.boundary.upper_C[:, 1:]])
    reason = reason_of(problem, context.operator, u, T_zone_C, slack_K, free, comfort_C, free_steps)
    first = forecast.state.good is None
    plan = Plan(
        blocks=(),
        status=status if solution.optimal else PlanStatus.ACCEPTABLE,
        why=joined([solution.problem, reason, *doubts, context.bridged]),
        u=u,
        T_free_now_C=problem.features[:, 0, ZONE],
        T_free_C=problem.T_free_C,
        T_forced_K=brought.forced_K,
        T_free_low_C=free.quantile_C(0.1),
        T_free_high_C=free.quantile_C(0.9),
        lower_C=problem.lower_C,
        upper_C=problem.upper_C,
        slack_K=slack_K,
        power_W=brought.power_W,
        time_s=context.boundary.time_s[: u.shape[1]],
        origin=readings.history.origin,
        solver_status=solution.status,
        iterations=solution.iterations,
        variables=solution.variables,
        parameters=solution.parameters,
        own=solution.own,
        seconds={name: round(s, 6) for name, s in seconds.items()},
        margins={**instance.bounds.first_step, "offset": learned.moved_K, "unused_capacity": learned.unused},
        names=names,
        state=replace(
            forecast.state, good=_good_plan(readings.time_s, u, T_zone_C, forecast, instance.bounds.whole_K), failures=0
        ),
    )
    return plan.with_news(instance.news) if first else plan


def _good_plan(time_s: float, u: Array, T_zone_C: Array, forecast: Forecast, margin_K: Array) -> GoodPlan:
    """What is remembered of a plan: a zone that was never measured has no prediction to compare with."""
    free = forecast.context.free
    good = GoodPlan(time_s, u, T_zone_C.copy(), 0.5 * (free.quantile_C(0.9) - free.quantile_C(0.1)), margin_K)
    for kept in (good.T_zone_C, good.band_K):
        kept[list(forecast.context.unmeasured)] = np.nan
    return good


def first_demands(
    config: MPCConfig,
    actuators: Actuators,
    step_s: float,
    plan: Plan,
    readings: Readings,
    commanded: Commanded | None = None,
    most_u: Array | None = None,
) -> list[Demand]:
    """What a plan asks of each actuator (A,) in its first step of `step_s` seconds: a level, or commands.

    `most_u` (A, N): the highest levels that it counts with; None: all that there are.
    """
    assert isinstance(plan.state, MPCState)
    learned, demands = plan.state.margins.learned, list[Demand]()
    for a, (actuation, z) in enumerate(zip(actuators.each, actuators.layout.home, strict=True)):
        u, boundary = float(plan.u[a, 0]), readings.observation.boundary
        if commanded is not None and commanded.values[a] is not None:
            demands.append(commanded.blocks(a))
            continue
        if commanded is not None and a in commanded.left_alone:
            demands.append(None)
            continue
        if not actuation.by_rooms:
            # A plan that takes all that it counts with wants all that there is.
            most = 1.0 if most_u is None else float(most_u[a, 0])
            all_of_it = (1.0 - LEVEL_EDGE) * most <= u < most + LEVEL_EDGE < actuation.highest
            demands.append(actuation.highest if all_of_it else u)
            continue
        lower_C, upper_C = boundary.lower_C[z, :1], boundary.upper_C[z, :1]
        inside_K = config.comfort_margin_K + learned.inside_K(z, lower_C, upper_C, by_loops=True)[:, 0]
        last = readings.history.u[a, -1:]
        demands.append(
            room_blocks(
                u,
                end_of_move_C(plan.u[a], plan.T_zone_C[z], actuators.layout.u_min[a]),
                T_now_C=float(readings.zones.T_C[z]),
                u_last=float(last[0]) if last.size else float("nan"),
                bounds_C=within_C(float(lower_C[0]), float(upper_C[0]), inside_K),
                u_min=actuators.layout.u_min[a],
                step_s=step_s,
                block_s=actuation.config.block_s,
            )
        )
    return demands


def end_of_move_C(u: Array, T_zone_C: Array, u_min: float) -> float:
    """Temperature to which loops are to bring a zone, °C, with levels `u` (N,) and temperatures (N,) of a plan.

    That at the end of the first step; where this heats or cools at half of full level or more, at the end of the steps
    from now on that do. A loop gives its most only if its set-point is well away, and a fan that stands at night starts
    only then.
    """
    full = 1.0 if u[0] > 0 else -u_min
    works = u * np.sign(u[0]) >= _WORKS_FROM * full
    steps = int(np.argmin(works)) if not works.all() else works.size
    return float(T_zone_C[max(steps, 1) - 1])


def reason_of(
    problem: MPCProblem,
    operator: BuildingOperator,
    u: Array,
    T_zone_C: Array,
    slack_K: Array,
    forecast: FreeForecast,
    comfort_C: Array,
    free_steps: int,
) -> str:
    """Which bound is missed or binding, where and when, and the width of the forecast's 80 % band there.

    Of an instance of Z zones over N steps: levels `u` (A, N), temperatures (Z, N), °C, and violations (Z, N), K, of the
    bounds with their margins; `comfort_C` (2, Z, N): the bounds without, °C. Discomfort counts within the first
    `free_steps`, which are moves of their own: later ones are planned again before they come.
    """
    band = forecast.quantile_C(0.9) - forecast.quantile_C(0.1)
    lower_C, upper_C, zones = problem.lower_C, problem.upper_C, operator.zones
    beyond_K = np.maximum(comfort_C[0] - T_zone_C, T_zone_C - comfort_C[1])[:, :free_steps]
    beyond_K = np.where(np.isnan(beyond_K), 0.0, beyond_K)
    z, when = (int(i) for i in np.unravel_index(int(np.argmax(beyond_K)), beyond_K.shape))
    if beyond_K[z, when] > _BINDING_K:
        cold = bool(T_zone_C[z, when] < comfort_C[0, z, when])
        side, sign = ("below", 1) if cold else ("above", -1)
        why = _cannot_be_avoided(problem, operator, z, sign, u[:, : when + 1], float(beyond_K[z, when]))
        what = f"{beyond_K[z, when]:.2f} K {side} the comfort band {why}"
    elif slack_K.max() > _BINDING_K:
        z, when = (int(i) for i in np.unravel_index(int(np.argmax(slack_K)), slack_K.shape))
        low = bool(T_zone_C[z, when] < lower_C[z, when])
        bound_C = (lower_C if low else upper_C)[z, when]
        side = "lower" if low else "upper"
        what = f"{side} bound with its margin, {bound_C:.2f} °C, is missed by {slack_K[z, when]:.2f} K"
    else:
        gap = np.minimum(T_zone_C - lower_C, upper_C - T_zone_C)
        # The first binding bound, not the tightest: it determines the plan of the next hours.
        near = gap <= max(_BINDING_K, float(gap.min()))
        when = int(np.argmax(near.any(axis=0)))
        z = int(np.argmax(near[:, when]))
        if gap[z, when] > _BINDING_K:
            nearest = f"comfort is not binding within the horizon (nearest {gap[z, when]:.2f} K{_of(zones, z)})"
            return f"{nearest}; free forecast: {forecast.note}"
        low = T_zone_C[z, when] - lower_C[z, when] <= upper_C[z, when] - T_zone_C[z, when]
        bound_C = (lower_C if low else upper_C)[z, when]
        what = f"{'lower' if low else 'upper'} bound with its margin, {bound_C:.2f} °C, binds"
    hours = (when + 1) * problem.step_s / HOUR_S
    where = _of(zones, z)
    return f"{what}{where} in {hours:.4g} h (80 % band of the free forecast there: {band[z, when]:.2f} K)"


def _of(zones: Sequence[str], z: int) -> str:
    return "" if len(zones) == 1 else f" in {zones[z]}"


def _cannot_be_avoided(
    problem: MPCProblem, operator: BuildingOperator, z: int, sign: int, u: Array, missing_K: float
) -> str:
    """Why zone `z` is not moved further in the direction `sign` by levels `u` (A, n) up to the discomfort, K.

    Nothing more can be done where its actuators of that sign, or their machines, are at their limit from now on, and
    the others do nothing; too little where what is left to do would not bring half of it by then.
    """
    own, limits = [a for a, home in enumerate(operator.home) if home == z], problem.machinery
    with_it = np.array(operator.signs, dtype=np.float64)[own] == sign
    most = np.where(with_it, limits.u_max[own], limits.u_min[own])
    left = np.abs(u[own] - most[:, None])
    spent = (left <= LEVEL_EDGE * limits.u_max[own, None]) | with_it[:, None] & _at_capacity(problem, u)[own]
    if spent.all():
        return "cannot be avoided at full power" if most.any() else "cannot be avoided with nothing on"
    # What is left of each step, until its effect comes due at the end of the last.
    effects_K = np.stack([np.abs(operator.of_actuator(a).impulse(u.shape[1]))[::-1] for a in own])
    if (effects_K * np.where(spent, 0.0, left)).sum() < _BOUGHT * missing_K:
        return "cannot be avoided in time any more"
    return NOT_ECONOMICAL


def _at_capacity(problem: MPCProblem, u: Array) -> NDArray[np.bool_]:
    """Where the machine that actuators share is at its capacity (A, n)."""
    machinery = problem.machinery
    capacity = np.ones(problem.power_fixed_W.shape) if problem.capacity is None else problem.capacity
    load = machinery.fed_by @ (machinery.share[:, None] * u)
    full = load >= (1.0 - LEVEL_EDGE) * capacity[:, : u.shape[1]]
    return np.asarray(machinery.shared[machinery.machine_of, None] & full[machinery.machine_of])
