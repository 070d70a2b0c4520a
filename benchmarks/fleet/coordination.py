"""Joint plans of seeded houses under a shared limit: what it costs, and houses without a plan."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.zones.scaling import building_operator, building_problem
from controllers.coordination import Member, SharedPower, plan_jointly
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import POWER_UNIT_W, ProblemShape, blocked_moves
from controllers.optimisation.solution import Solution, failed
from controllers.optimisation.solvers.qp import QPConfig
from thermoforce_mpc.data import Array

_STEP_S, _FREE_H, _HOLD_H = 900.0, 12.0, 1.0
# Limit relative to the highest power that the houses would draw without it.
LIMIT = 0.85
SILENT = 0.05


@dataclass(frozen=True)
class Coordinated:
    """Joint plan of `houses` under a limit of `LIMIT` of what they would draw.

    `above`: cost above that without a limit, relative; NaN with silent houses. `over`: power above the limit, relative
    to it, with the most that houses without a plan may draw. `silent`: how many those are. `seconds`: of the solves.
    """

    houses: int
    silent: int
    above: float
    over: float
    seconds: float


def coordinated(houses: int, *, silent: int = 0, seed: int = 1) -> Coordinated:
    """Plan for `houses`, of which the last `silent` have no plan that passes its check."""
    members = [house(seed, i) for i in range(houses)]
    steps = members[0].power_at.size
    alone = [plan_jointly([member], SharedPower(np.full(steps, np.inf)), QPConfig()) for member in members]
    free_kW = np.sum([plan.total_kW for plan in alone], axis=0)
    shared = SharedPower(np.full(steps, LIMIT * free_kW.max()))
    some = [*members[: houses - silent], *(house(seed, i, _Silent) for i in range(houses - silent, houses))]
    began = time.perf_counter()
    found = plan_jointly(some, shared, QPConfig())
    seconds = time.perf_counter() - began
    above = float("nan") if silent else found.cost / sum(plan.cost for plan in alone) - 1.0
    over = float(((found.total_kW + found.reserved_kW) / shared.limit_kW - 1.0).max())
    return Coordinated(houses, len(found.silent), above, over, seconds)


class _Silent(Member):
    """A house without a plan."""

    def checked(self, x: Array) -> Solution:
        return failed("silent", 0, "silent")


def house(seed: int, number: int, kind: type[Member] = Member) -> Member:
    """A seeded house of one heated zone."""
    rng = np.random.default_rng([seed, number])
    operator = building_operator(1, 0, rng)
    problem = replace(building_problem(operator, rng), power_cap=None)
    moves = blocked_moves(problem.n_steps, _STEP_S, _FREE_H, _HOLD_H)
    model = PlanModel(operator, ProblemShape(moves, problem.machinery))
    largest_W = float((problem.power_fixed_W + problem.power_per_u_W).sum(axis=0).max())
    return kind(f"house {number}", model, problem, largest_W / POWER_UNIT_W)
