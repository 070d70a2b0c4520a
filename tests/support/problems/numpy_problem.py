"""The objective of the problem a second time, in numpy and mode by mode: what the statement is judged by.

Levels are held in all steps; of an instance as it is solved (`SolvedAs`), later ones are shares of the highest.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.data import Array
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.model.machine.running import running_share
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.features import OUTDOOR


@dataclass(frozen=True, eq=False)
class SolvedAs(MPCProblem):
    """An instance whose levels are held in the first `held_steps` steps; None: in all."""

    held_steps: int | None = None


def solved_as(problem: MPCProblem, held_steps: int | None) -> SolvedAs:
    """The instance with levels that are held in the first steps only."""
    return SolvedAs(**{item.name: getattr(problem, item.name) for item in fields(MPCProblem)}, held_steps=held_steps)


def _held_steps(p: MPCProblem) -> int | None:
    return p.held_steps if isinstance(p, SolvedAs) else None


def _heating(p: MPCProblem, u: Array) -> Array:
    return np.maximum(u, 0.0) if p.machinery.signed.size else u


def on_share(p: MPCProblem, u: Array) -> Array:
    """Share of each step that each actuator is on with a level above 0: `u` (..., A, N) → (..., A, N)."""
    return np.minimum(_heating(p, u) / p.machinery.switched_at(p.n_steps, _held_steps(p)), 1.0)


def running(p: MPCProblem, u: Array) -> Array:
    """Share of each step that each machine runs for levels `u` (..., A, N), shape (..., M, N)."""
    m, on, rows = p.machinery, on_share(p, u), []
    loads = m.share[:, None] * _heating(p, u)
    for number in range(len(m.machines)):
        fed = m.machine_of == number
        needed = running_share(on[..., fed, :], m.runs_for[fed]) if fed.sum() > 1 else on[..., fed, :][..., 0, :]
        rows.append(np.maximum(needed, loads[..., fed, :].sum(axis=-2)))
    return np.stack(rows, axis=-2)


def power_W(p: MPCProblem, u: Array) -> Array:
    """Mean electric power of each machine over each step for levels `u` (..., A, N), W, shape (..., M, N)."""
    heating = _heating(p, u)
    per_u = p.power_per_u_W * heating
    if p.cooling is not None:
        per_u = per_u + p.cooling.power_per_u_W * np.maximum(-u, 0.0)
    if p.power_per_u2_W is not None:
        per_u = per_u + p.power_per_u2_W * heating**2
    return p.power_fixed_W * running(p, u) + p.machinery.fed_by @ per_u


def energy_cost(p: MPCProblem, u: Array) -> Array:
    """Cost of energy of the building over each step for levels `u` (..., A, N), currency, shape (..., N)."""
    heating, price = _heating(p, u), p.price_per_W[p.machinery.machine_of]
    per_u = price * p.power_per_u_W * heating + p.cooling_cost_per_u * np.maximum(-u, 0.0)
    if p.power_per_u2_W is not None:
        per_u = per_u + np.maximum(price, 0.0) * p.power_per_u2_W * heating**2
    return (p.fixed_cost * running(p, u)).sum(axis=-2) + per_u.sum(axis=-2)


def modes_K(p: MPCProblem, operator: BuildingOperator, u: Array) -> Array:
    """Forced state of every pair at the end of each step for levels `u` (..., A, N), K, shape (..., Z, A, N, r)."""
    if _held_steps(p) is None or not p.machinery.held.any():
        return operator.rollout(p.forced_state_K, u, p.features)
    return _stepped(p, operator, np.stack([_heat(p, operator, u, a) for a in range(u.shape[-2])]))


def _heat(p: MPCProblem, operator: BuildingOperator, u: Array, a: int) -> Array:
    """v of one actuator (..., N): of its level where it is held, and later of its highest level for a share."""
    heat_input, T_out_C = operator.of_actuator(a).heat_input, p.features[operator.home[a], :, OUTDOOR]
    highest, held = p.machinery.u_max[a], heat_input(u[..., a, :], T_out_C)
    switched = u[..., a, :] / highest * heat_input(np.full(p.n_steps, highest), T_out_C)
    return np.where((np.arange(p.n_steps) < _held_steps(p)) | ~p.machinery.held[a], held, switched)


def _stepped(p: MPCProblem, operator: BuildingOperator, heat: Array) -> Array:
    """Forced states (Z, A, N, r) of v (A, N), step by step."""
    forced, states = p.forced_state_K, []
    for k in range(p.n_steps):
        forced = operator.advance(forced, operator.modulated(heat[:, k], p.features[:, k], forced))
        states.append(forced)
    return np.stack(states, axis=2)


def forced_K(p: MPCProblem, operator: BuildingOperator, u: Array) -> Array:
    """Forced response of each zone at the end of each step for levels `u` (..., A, N), K, shape (..., Z, N)."""
    return modes_K(p, operator, u).sum(axis=(-3, -1))


def slack_K(p: MPCProblem, T_zone_C: Array) -> Array:
    """Violation of the comfort bounds at the end of each step, K, shape as `T_zone_C` (..., Z, N)."""
    return np.maximum(np.maximum(p.lower_C - T_zone_C, T_zone_C - p.upper_C), 0.0)


def cost_under(p: MPCProblem, u: Array, modes: Array) -> Array:
    """Objective for levels `u` (..., A, N) with forced states `modes` (..., Z, A, N, r), K; currency, (...,)."""
    slack = slack_K(p, compose(p.T_free_C, modes.sum(axis=(-3, -1))))
    cost = energy_cost(p, u).sum(axis=-1) + slack.sum(axis=-1) @ p.comfort_price
    cost = cost + p.weights.curvature * (u**2).sum(axis=(-2, -1))
    power = power_W(p, u).sum(axis=-2)
    cost = cost + p.weights.peak * np.maximum(power.max(axis=-1) - p.peak_so_far_W, 0.0)
    if p.power_cap is not None:
        cost = cost + p.cap_price_per_W * np.maximum(power - p.power_cap.limit_W, 0.0).sum(axis=-1)
    return cost - (modes[..., -1, :] * p.terminal_price_per_K).sum(axis=(-3, -2, -1))


def cost(p: MPCProblem, operator: BuildingOperator, u: Array) -> Array:
    """Objective for levels `u` (..., A, N), currency, shape (...,)."""
    return cost_under(p, u, modes_K(p, operator, u))
