"""Actuators that an override holds, as a plan counts with them: at the levels that are expected of what acts instead.

That is a loop of its own: the plant's, or the on/off rule. It is taken to keep its zone at the comfort bound, with the
other actuators at the levels of the last plan. Levels expected so are numbers before the problem is formulated: their
response joins the free one, and what they take of capacity and power is no longer there for the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from controllers.optimisation.problem import MPCProblem
from controllers.safety.overrides import Override
from thermoforce_mpc.data import Array
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.model.operator.building import BuildingOperator


@dataclass(frozen=True, eq=False)
class Held:
    """Levels of held actuators (A, N), 0 for the others, and the forced response to them (Z, N), K."""

    u: Array
    forced_K: Array


def expected_levels(
    operator: BuildingOperator,
    problem: MPCProblem,
    overrides: Mapping[int, Override],
    others_u: Array | None,
) -> Array:
    """Levels (A, N) of the held actuators, 0 for the others.

    Args:
        operator: adjusted to the actuation.
        problem: with all actuators planned.
        overrides: what each held actuator does in this step, by number; its level, if it is not native control, is that
            of the first step.
        others_u: levels of the last plan (A, N); None: the others are taken to be off.
    """
    m, n = problem.machinery, problem.n_steps
    others = np.zeros((len(m.actuators), n)) if others_u is None else others_u.copy()
    others[list(overrides)] = 0.0
    T_C = compose(problem.T_free_C, problem.forced_K(operator, others))
    levels = np.zeros_like(others)
    full = operator.drive(np.repeat(m.u_max[:, None], n, axis=1), problem.features)
    for a, override in overrides.items():
        z, pair = operator.home[a], operator.of_actuator(a)
        bound_C = problem.lower_C[z] if operator.signs[a] > 0 else problem.upper_C[z]
        added_K = np.zeros(pair.gains.size)  # by this actuator, beyond the decay of what it gave before
        for k in range(n):
            rest_K, per_u_K = pair.poles * added_K, pair.gains * full[a, k] / m.u_max[a]
            lacking_K = bound_C[k] - T_C[z, k] - rest_K.sum()
            u = lacking_K / per_u_K.sum() if per_u_K.sum() else 0.0
            if k == 0 and override.level is not None:
                u = override.level
            levels[a, k] = min(max(u, m.u_min[a]), m.u_max[a])
            added_K = rest_K + per_u_K * levels[a, k]
    return levels


def with_held(
    operator: BuildingOperator, problem: MPCProblem, overrides: Mapping[int, Override], u: Array
) -> tuple[MPCProblem, Held]:
    """The problem of the other actuators, given the levels `u` (A, N) of the held ones.

    That a machine runs anyway while a held actuator is on is not counted.
    """
    p, m = problem, problem.machinery
    held = np.isin(np.arange(len(m.actuators)), list(overrides))
    forced_K = np.asarray(p.modes_K(operator, u)[:, held].sum(axis=(1, 3)))
    taken = m.fed_by @ (m.share[:, None] * np.maximum(u, 0.0))
    capacity = np.ones(taken.shape) if p.capacity is None else p.capacity
    held_W = p.power_W(u).sum(axis=0)
    cap = p.power_cap
    served = np.zeros(p.T_free_C.shape[0], dtype=bool)
    served[[z for a, z in enumerate(operator.home) if not held[a]]] = True
    away_K = np.where(served, 0.0, 100.0)[:, None]
    rest = replace(
        p,
        lower_C=p.lower_C - away_K,
        upper_C=p.upper_C + away_K,
        planned=~held,
        power_fixed_W=p.power_fixed_W * (1.0 - p.running(u)),
        forced_state_K=np.where(held[:, None], 0.0, p.forced_state_K),
        terminal_price_per_K=np.where(held[:, None], 0.0, p.terminal_price_per_K),
        T_free_C=compose(p.T_free_C, forced_K),
        capacity=np.maximum(capacity - taken, 0.0) if taken.any() else p.capacity,
        peak_so_far_W=max(p.peak_so_far_W - float(held_W.mean()), 0.0),
        power_cap=cap and replace(cap, limit_W=np.maximum(cap.limit_W - held_W, 0.0)),
    )
    return rest, Held(u, forced_K)
