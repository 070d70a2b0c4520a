"""The objective of the problem a second time, in numpy and mode by mode: what the statement is judged by."""

from __future__ import annotations

import numpy as np

from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.data import Array
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.model.machine.load import running_share
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import OUTDOOR


def _heating(p: MPCProblem, u: Array) -> Array:
    return np.maximum(u, 0.0) if p.machinery.signed.size else u


def on_share(p: MPCProblem, u: Array) -> Array:
    """Share of each step that each actuator is on with a level above 0: `u` (..., A, N) → (..., A, N)."""
    return np.minimum(_heating(p, u) / p.machinery.lowest_level[:, None], 1.0)


def running(p: MPCProblem, u: Array) -> Array:
    """Share of each step that each machine runs for levels `u` (..., A, N), shape (..., M, N)."""
    m, on, rows = p.machinery, on_share(p, u), []
    loads = m.share[:, None] * _heating(p, u)
    for number in range(len(m.machines)):
        fed = m.machine_of == number
        needed = running_share(on[..., fed, :], m.runs_for[fed]) if fed.sum() > 1 else on[..., fed, :][..., 0, :]
        rows.append(np.maximum(needed, loads[..., fed, :].sum(axis=-2)))
    return np.stack(rows, axis=-2)


def _bends(p: MPCProblem) -> Array:
    return np.zeros(p.power_per_u_W.shape) if p.power_per_u2_W is None else p.power_per_u2_W


def _fixed_W(p: MPCProblem) -> tuple[Array, Array]:
    """Fixed parts (M, N) that are drawn while on, and what counts in proportion to the level instead, per u (A, N).

    Of a stepped actuator no more is fixed than what bends at its lowest level: of a larger one power per heat would
    still fall above that level.
    """
    m = p.machinery
    fixed, per_u = p.power_fixed_W.copy(), np.zeros(p.power_per_u_W.shape)
    for a in np.flatnonzero(m.stepped):
        most = _bends(p)[a] * m.lowest_level[a] ** 2
        fixed[m.machine_of[a]] = np.minimum(p.power_fixed_W[m.machine_of[a]], most)
        per_u[a] = np.maximum(p.power_fixed_W[m.machine_of[a]] - most, 0.0) / m.lowest_level[a]
    return fixed, per_u


def _bent_W(p: MPCProblem, u: Array) -> tuple[Array, Array]:
    """Power over u² of each actuator (..., A, N), and what of it counts where energy earns.

    Below its lowest level a stepped actuator is at that level for a share of the step.
    """
    m, heating = p.machinery, _heating(p, u)
    lowest = m.lowest_level[:, None]
    level = np.where(m.stepped[:, None], np.maximum(heating, lowest), heating)
    share = np.where(m.stepped[:, None], on_share(p, u), 1.0)
    return share * _bends(p) * level**2, share * _bends(p) * level * np.where(m.stepped[:, None], lowest, 0.0)


def power_W(p: MPCProblem, u: Array) -> Array:
    """Mean electric power of each machine over each step for levels `u` (..., A, N), W, shape (..., M, N)."""
    fixed, more_per_u = _fixed_W(p)
    per_u = (p.power_per_u_W + more_per_u) * _heating(p, u) + _bent_W(p, u)[0]
    if p.cooling is not None:
        per_u = per_u + p.cooling.power_per_u_W * np.maximum(-u, 0.0)
    return fixed * running(p, u) + p.machinery.fed_by @ per_u


def energy_cost(p: MPCProblem, u: Array) -> Array:
    """Cost of energy of the building over each step for levels `u` (..., A, N), currency, shape (..., N)."""
    price = p.price_per_W[p.machinery.machine_of]
    (fixed, more_per_u), (bent, earning) = _fixed_W(p), _bent_W(p, u)
    per_u = price * (p.power_per_u_W + more_per_u) * _heating(p, u) + p.cooling_cost_per_u * np.maximum(-u, 0.0)
    per_u = per_u + price * np.where(price < 0.0, earning, bent)
    fixed_cost = p.price_per_W * fixed
    fixed_cost = np.where(p.machinery.shared[:, None], np.maximum(fixed_cost, 0.0), fixed_cost)
    cost = (fixed_cost * running(p, u)).sum(axis=-2) + per_u.sum(axis=-2)
    if p.exchange is None:
        return cost
    bought_W = np.maximum(power_W(p, u).sum(axis=-2) - np.maximum(-p.exchange.others_W, 0.0), 0.0)
    return cost + p.exchange.dearer_per_kWh * bought_W * p.step_s / 3.6e6


def modes_K(p: MPCProblem, operator: BuildingOperator, u: Array) -> Array:
    """Forced state of every pair at the end of each step for levels `u` (..., A, N), K, shape (..., Z, A, N, r)."""
    if not (p.machinery.stepped & (p.price_per_kWh < 0.0).any(axis=-1)[p.machinery.machine_of]).any():
        return operator.rollout(p.forced_state_K, u, p.features)
    heat = np.stack([_heat(p, operator, u, a) for a in range(u.shape[-2])])
    forced, states = p.forced_state_K, []
    for k in range(p.n_steps):
        forced = operator.advance(forced, operator.modulated(heat[:, k], p.features[:, k], forced))
        states.append(forced)
    return np.stack(states, axis=2)


def _heat(p: MPCProblem, operator: BuildingOperator, u: Array, a: int) -> Array:
    """v of one actuator (N,): a stepped one gives what it would by switching at its lowest level where energy earns."""
    m, heat_input, T_out_C = p.machinery, operator.of_actuator(a).heat_input, p.features[operator.home[a], :, OUTDOOR]
    held = heat_input(u[a], T_out_C)
    if not m.stepped[a]:
        return held
    lowest = m.lowest_level[a]
    switched = u[a] / lowest * heat_input(np.full(p.n_steps, lowest), T_out_C)
    return np.where(p.price_per_kWh[m.machine_of[a]] < 0.0, switched, held)


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
    others_W = 0.0 if p.exchange is None else p.exchange.others_W
    cost = cost + p.weights.peak * np.maximum((power + others_W).max(axis=-1) - p.peak_so_far_W, 0.0)
    if p.power_cap is not None:
        cost = cost + p.cap_price_per_W * np.maximum(power - p.power_cap.limit_W, 0.0).sum(axis=-1)
    return cost


def cost(p: MPCProblem, operator: BuildingOperator, u: Array) -> Array:
    """Objective for levels `u` (..., A, N), currency, shape (...,)."""
    return cost_under(p, u, modes_K(p, operator, u))
