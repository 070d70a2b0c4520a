"""Coordination of seeded houses under a shared limit: distance to the joint optimum, messages, and silent houses."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.fleet.joint_optimum import solve_jointly
from benchmarks.zones.scaling import building_operator, building_problem
from controllers.coordination import Answer, Member, QPMember, Settled, SharedPower, coordinate
from controllers.optimisation.problem import ProblemShape, blocked_moves
from controllers.optimisation.solvers.qp_backends import QPConfig
from thermoforce_mpc.data import Array

_STEP_S, _FREE_H, _HOLD_H = 900.0, 12.0, 1.0
# Limit relative to the highest power that the houses would draw without it.
LIMIT = 0.85
SILENT = 0.05
# Houses up to which the joint optimum is computed.
_JOINT = 10
_JOINT_TOLERANCE = 1e-6
_TOLD_EVERY = 20


@dataclass(frozen=True)
class Coordinated:
    """Agreement of `houses` under a limit of `LIMIT` of what they would draw.

    `above`: cost above the joint optimum, relative; NaN where that is not computed. `gap`: above the bound that the
    agreement comes with. `over`: power above the limit, relative to it, with the most that silent houses may draw.
    `messages`: vectors to and from a house. `silent`: houses that do not answer. `seconds`: all houses in one process.
    """

    houses: int
    silent: int
    above: float
    gap: float
    over: float
    iterations: int
    messages: float
    seconds: float


def coordinated(
    houses: int, *, silent: int = 0, seed: int = 1, progress: Callable[[str], None] = lambda line: None
) -> Coordinated:
    """Let `houses` agree, of which the last `silent` never answer.

    Raises:
        ControllerConfigError: the joint problem is not solved.
    """
    members = [_member(seed, i) for i in range(houses)]
    nothing = np.zeros_like(members[0].largest_kW)
    answers = [member.answer(nothing, nothing, 0.0) for member in members]
    free_kW = np.sum([answer.power_kW for answer in answers if answer], axis=0)
    shared = SharedPower(np.full(nothing.size, LIMIT * free_kW.max()))
    some: list[Member] = [*members[: houses - silent], *(_Silent(member) for member in members[houses - silent :])]
    began = time.perf_counter()

    def told(iteration: int, over: float) -> None:
        if iteration % _TOLD_EVERY == 0:
            progress(f"{houses} houses, iteration {iteration}, {100 * over:.2g} % over the limit")

    found = coordinate(some, shared, on_iteration=told)
    seconds = time.perf_counter() - began
    above = float("nan")
    if houses <= _JOINT and not silent:
        best, _ = solve_jointly(members, shared, QPConfig(tolerance=_JOINT_TOLERANCE))
        above = found.cost / best - 1.0
    over = float(((found.total_kW + found.reserved_kW) / shared.limit_kW - 1.0).max())
    return Coordinated(houses, silent, above, found.gap, over, found.iterations, found.messages / houses, seconds)


class _Silent:
    """A house that does not answer."""

    def __init__(self, inner: QPMember) -> None:
        self.name, self.largest_kW = inner.name, inner.largest_kW

    def answer(self, price: Array, wish_kW: Array, weight: float) -> Answer | None:
        return None

    def settle(self, limit_kW: Array) -> Settled | None:
        return None


def _member(seed: int, number: int) -> QPMember:
    rng = np.random.default_rng([seed, number])
    operator = building_operator(1, 0, rng)
    problem = replace(building_problem(operator, rng), power_cap=None)
    moves = blocked_moves(problem.n_steps, _STEP_S, _FREE_H, _HOLD_H)
    return QPMember(f"house {number}", operator, ProblemShape(moves, problem.machinery), problem, QPConfig())
