"""Cost of a step over the number of zones: seeded buildings of Z zones with one actuator each, solved as by default."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.zones.do_mpc_building import DoMpcBuilding
from controllers.optimisation.problem import (
    EquipmentLayout,
    MPCProblem,
    PowerCap,
    ProblemShape,
    Weights,
    blocked_moves,
    every_step,
)
from controllers.optimisation.solvers.qp import QPConfig, QPSolver
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import linear_operator

_STEP_S, _HORIZON_H, _FREE_H, _HOLD_H = 900.0, 48.0, 12.0, 1.0
_TIME_CONSTANTS_H = (0.5, 3.0, 48.0)
# Steady effect of a zone's own actuator, K, and what of it reaches a neighbour.
_OWN_K, _NEIGHBOUR_SHARE = 18.0, 0.1


def building_operator(n_zones: int, neighbours: int, rng: np.random.Generator) -> BuildingOperator:
    """Zones on a ring, each with one heating actuator that reaches `neighbours` zones on either side.

    Time constants are shared by all pairs of a zone.
    """
    names = [f"zone {z}" for z in range(n_zones)], [f"radiator {z}" for z in range(n_zones)]
    rows = []
    for z in range(n_zones):
        poles = np.exp(-_STEP_S / HOUR_S / (np.array(_TIME_CONSTANTS_H) * rng.uniform(0.7, 1.4)))
        row = []
        for a in range(n_zones):
            away = min((z - a) % n_zones, (a - z) % n_zones)
            steady_K = _OWN_K * rng.dirichlet(np.ones(poles.size)) * (1.0 if away == 0 else _NEIGHBOUR_SHARE)
            pair = linear_operator(poles, steady_K * (1.0 - poles), step_s=_STEP_S)
            row.append(pair if away <= neighbours else None)
        rows.append(tuple(row))
    return BuildingOperator(tuple(names[0]), tuple(names[1]), tuple(rows), tuple(range(n_zones)))


def building_problem(operator: BuildingOperator, rng: np.random.Generator) -> MPCProblem:
    """A winter's two days: one heat pump for all actuators, dimensioned for three quarters of their full heat."""
    Z, A, r = operator.shape
    n = round(_HORIZON_H * HOUR_S / _STEP_S)
    hour = (np.arange(n) * _STEP_S / HOUR_S + rng.uniform(0.0, 24.0)) % 24.0
    one = np.ones(A)
    machinery = EquipmentLayout(
        operator.actuators, ("heat pump",), one, one, 0.0 * one, np.zeros(A, np.intp), one / (0.75 * A)
    )
    occupied = (hour > 7.0) & (hour < 20.0)
    day = 2.0 * np.cos(2.0 * np.pi * (hour - 15.0) / 24.0)
    return MPCProblem(
        forced_state_K=rng.uniform(0.0, 2.0, (Z, A, r)) * (operator.gains != 0.0) / A,
        features=np.tile(np.stack([15.0 + day, day, np.maximum(100.0 * day, 0.0), 0.5 * day], axis=1), (Z, 1, 1)),
        T_free_C=13.0 + day + rng.normal(0.0, 1.0, (Z, 1)) + rng.normal(0.0, 0.1, (Z, n)),
        lower_C=np.where(occupied, 21.0, 15.0) * np.ones((Z, 1)),
        upper_C=np.full((Z, n), 24.0),
        price_per_kWh=np.full((1, n), 0.25) + 0.05 * np.sin(hour / 3.0),
        power_fixed_W=np.full((1, n), 200.0 * A),
        power_per_u_W=np.full((A, n), 800.0),
        step_s=_STEP_S,
        machinery=machinery,
        weights=Weights(5.0, 1e-6),
        power_cap=PowerCap(np.full(n, 700.0 * A), 0.5),
    )


def solve_times(
    sizes: Sequence[int] = (1, 2, 5, 10, 20), *, neighbours: int = 2, instances: int = 10, seed: int = 1
) -> dict[int, float]:
    """Median CPU time of a solve by number of zones, s, with move blocking and solvers as by default.

    The solver has one thread: its CPU time is what a step takes on an idle core, whatever else the machine does.

    Raises:
        RuntimeError: an instance is not solved.
    """
    found = {}
    for n_zones in sizes:
        rng = np.random.default_rng([seed, n_zones])
        operator = building_operator(n_zones, neighbours, rng)
        problems = [building_problem(operator, rng) for _ in range(instances)]
        moves = blocked_moves(problems[0].n_steps, _STEP_S, _FREE_H, _HOLD_H)
        solver = QPSolver(operator, ProblemShape(moves, problems[0].machinery, capped=True), QPConfig())
        seconds = []
        for problem in problems:
            began = time.process_time()
            solution = solver.solve(problem)
            seconds.append(time.process_time() - began)
            if not solution.ok:
                raise RuntimeError(f"{n_zones} zones: {solution.problem}")
        found[n_zones] = float(np.median(seconds))
    return found


@dataclass(frozen=True)
class BesideDoMpc:
    """Median CPU time of a solve, s, and the largest relative difference of the optimum to do-mpc's on one instance.

    `ours_s`: what do-mpc solves, a move in every step; `helped_s`: do-mpc told that a zone's actuators share its modes.
    """

    ours_s: float
    do_mpc_s: float
    helped_s: float
    worst_difference: float


def beside_do_mpc(
    n_zones: int = 5, *, neighbours: int = 2, instances: int = 10, repeats: int = 5, seed: int = 1
) -> BesideDoMpc:
    """Solve the instances of `solve_times` of `n_zones` zones, with a move in every step, and in do-mpc, in turn.

    Ours is the median of `repeats` solves of each instance.

    Raises:
        ConfigError: do-mpc is not installed.
        RuntimeError: an instance is not solved.
    """
    rng = np.random.default_rng([seed, n_zones])
    operator = building_operator(n_zones, neighbours, rng)
    problems = [building_problem(operator, rng) for _ in range(instances)]
    machinery = problems[0].machinery
    peers = [DoMpcBuilding(operator, problems[0], modes_shared=shared) for shared in (False, True)]
    solver = QPSolver(operator, ProblemShape(every_step(problems[0].n_steps), machinery, capped=True), QPConfig())
    ours, differences = list[float](), list[float]()
    theirs: tuple[list[float], list[float]] = ([], [])
    for problem in problems:
        for _ in range(repeats):
            began = time.process_time()
            solution = solver.solve(problem)
            ours.append(time.process_time() - began)
            if not solution.ok:
                raise RuntimeError(f"{n_zones} zones: {solution.problem}")
        best = solution.cost
        for peer, seconds in zip(peers, theirs, strict=True):
            began = time.process_time()
            u = peer.solve(problem)
            seconds.append(time.process_time() - began)
            found = solver.model.brings(problem, np.clip(u, 0.0, machinery.u_max[:, None])).cost
            differences.append(abs(found - best) / abs(best))
    do_mpc_s, helped_s = (float(np.median(seconds)) for seconds in theirs)
    return BesideDoMpc(float(np.median(ours)), do_mpc_s, helped_s, max(differences))


def exponent(seconds: Mapping[int, float]) -> float:
    """Slope of log time over log number of zones, least squares: 1 is linear growth."""
    return float(np.polyfit(np.log(list(seconds)), np.log(list(seconds.values())), 1)[0])
