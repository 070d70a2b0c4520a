"""Plans of buildings that share a limit or a price of their summed power, at one instant.

Buildings that share a limit on the sum of their powers, or a price of its peak, as one programme.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from controllers.checks import ControllerConfigError
from controllers.many.batch import BatchPlanner, Planned, buildings_of
from controllers.mpc.config import MPCConfig
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import POWER_UNIT_W, MPCProblem
from controllers.optimisation.programme import QPData
from controllers.optimisation.solution import OF_WORTH, Solution, Solve, SolverAnswer, checked, failed
from controllers.optimisation.solvers.qp import Piqp, QPConfig, QPSolver
from controllers.optimisation.statement.terms import PlanExpressions
from thermoforce_mpc.data import Array, Observation
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution.cooperative import (
    Computation,
    Handler,
    Request,
    RequestOutcome,
    Result,
    altered,
    gather,
    run,
)
from thermoforce_mpc.model.thermal_model import ThermalModel

if TYPE_CHECKING:
    from scipy import sparse


@dataclass(frozen=True, eq=False)
class SharedPower:
    """Limit and peak price of the summed power S over N steps.

    `limit_kW` (N,): highest mean power of each step, infinite without a limit. `peak_price_per_kW`: currency per kW by
    which the largest S exceeds `peak_so_far_kW`.

    Raises:
        DataError: a limit below 0 or not a number, or a price or peak that is not finite and nonnegative.
    """

    limit_kW: Array
    peak_price_per_kW: float = 0.0
    peak_so_far_kW: float = 0.0

    def __post_init__(self) -> None:
        limit = np.array(self.limit_kW, dtype=np.float64)
        if limit.ndim != 1 or not limit.size or not (limit >= 0.0).all():
            raise DataError(f"shared power: limit_kW needs one value of at least 0 per step; found {limit}")
        for name in ("peak_price_per_kW", "peak_so_far_kW"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise DataError(f"shared power: {name} is {value}, expected a number of at least 0")
        limit.setflags(write=False)
        object.__setattr__(self, "limit_kW", limit)

    def less(self, reserved_kW: float) -> SharedPower:
        """What is left beside a draw of `reserved_kW`: at least 0."""
        return SharedPower(
            np.maximum(self.limit_kW - reserved_kW, 0.0),
            self.peak_price_per_kW,
            max(self.peak_so_far_kW - reserved_kW, 0.0),
        )

    def why_over(self, reserved_kW: float, buildings: int) -> str:
        """'', or why the limit may be exceeded by a draw of `reserved_kW` of as many buildings."""
        if reserved_kW <= self.limit_kW.min():
            return ""
        return (
            f"the {buildings} buildings that take no part may draw {reserved_kW:.4g} kW, more than the limit of "
            f"{self.limit_kW.min():.4g} kW"
        )

    def cost(self, total_kW: Array) -> float:
        """Cost of the peak of `total_kW` (N,), currency; the limit is not part of it."""
        return self.peak_price_per_kW * max(float(total_kW.max()) - self.peak_so_far_kW, 0.0)


# Power above its part of the limit that a checked plan may have, kW: a solver's tolerance. The programme's limit is
# lower by as much for each building.
LIMIT_TOLERANCE_KW = 1e-5


def power_of_steps(plan: PlanExpressions) -> None:
    """The building's power over each step as variables, kW."""
    power = plan.variable("power", plan.power_W.shape[1], -np.inf, np.inf)
    plan.equal(power - ca.sum1(plan.power_W) / POWER_UNIT_W)


class Member:
    """A building whose problem is a convex quadratic programme; `largest_kW`: the most it may draw whatever happens.

    Raises:
        ControllerConfigError: it cannot be planned with others, and why.
    """

    def __init__(self, name: str, model: PlanModel, problem: MPCProblem, largest_kW: float) -> None:
        if not model.convex or model.structure.chosen:
            raise ControllerConfigError("its problem is not convex")
        if model.shape.terms:
            raise ControllerConfigError("it plans with terms of its own")
        if problem.power_per_u2_W is not None:  # rows of power are linear in u: its chord, too high at part load
            per_u_W = problem.power_per_u_W + problem.power_per_u2_W
            problem = replace(problem, power_per_u_W=per_u_W, power_per_u2_W=None)
        self.name, self.largest_kW, self._problem = name, largest_kW, problem
        self._model = PlanModel(model.operator, replace(model.shape.by_steps, terms=(power_of_steps,)))
        self._p = self._model.numbers(problem)
        if not np.isfinite(self._p).all():
            raise ControllerConfigError("its problem holds numbers that are not finite")
        self.programme, self.power_at = self._model.local(self._p), self._model.own_at

    def checked(self, x: Array) -> Solution:
        """Its plan, from its variables in the optimum of all."""
        answer = SolverAnswer(x, self.programme.objective(x), "jointly:solved", 0, shown=True)
        solution = checked(self._model, self._problem, self._p, answer)
        if solution.ok and (power_kW(solution) > x[self.power_at] + LIMIT_TOLERANCE_KW).any():
            return failed(solution.status, 0, "its levels draw more than its part of the limit")
        return replace(solution, own={})  # the power is ours, not the controller's


@dataclass(frozen=True)
class JointPlan:
    """Plans of buildings that share power over N steps.

    `solutions` by name; `silent`: why a building has none, by name: the most it may draw, `reserved_kW` for all such,
    is set aside. `total_kW` (N,): planned power; `cost`: of all plans and their peak, currency.
    """

    solutions: Mapping[str, Solution]
    silent: Mapping[str, str]
    reserved_kW: float
    total_kW: Array
    cost: float


def power_kW(solution: Solution) -> Array:
    """Mean power over each step (N,), kW."""
    assert solution.evaluation is not None
    return np.asarray(solution.evaluation.power_W.sum(axis=0) / POWER_UNIT_W)


def plan_jointly(members: Sequence[Member], shared: SharedPower, config: QPConfig) -> JointPlan:
    """The plans of least cost under what is shared. Who has no plan that passes its check is planned around."""
    silent, left, reserved_kW = dict[str, str](), list(members), 0.0
    solutions: dict[str, Solution] = {}
    while left:
        remaining = shared.less(reserved_kW)
        parts = _solved(left, remaining, config)
        if parts is None:
            why = _why_not(left, config)
        else:
            each, above = parts
            solutions = {member.name: member.checked(x) for member, x in zip(left, each, strict=True)}
            if above:
                solutions = {of: replace(s, optimal=False, problem=s.problem or above) for of, s in solutions.items()}
            why = {name: solution.problem for name, solution in solutions.items() if not solution.ok}
        if not why:
            break
        silent |= why
        reserved_kW += sum(member.largest_kW for member in left if member.name in why)
        left = [member for member in left if member.name not in why]
    kept = {member.name: solutions[member.name] for member in left}
    total_kW = sum(map(power_kW, kept.values()), np.zeros(shared.limit_kW.size))
    cost = sum(solution.cost for solution in kept.values()) + shared.less(reserved_kW).cost(total_kW)
    return JointPlan(kept, silent, reserved_kW, total_kW, cost)


def _why_not(members: Sequence[Member], config: QPConfig) -> dict[str, str]:
    """Whose own programme has no solution; where each has one, all members."""
    alone = [m.name for m in members if _solved([m], SharedPower(np.full(m.power_at.size, np.inf)), config) is None]
    if alone:
        return dict.fromkeys(alone, "no solver finds a plan for it")
    return dict.fromkeys((member.name for member in members), "no solver finds plans within what is shared")


def _solved(members: Sequence[Member], shared: SharedPower, config: QPConfig) -> tuple[list[Array], str] | None:
    """Variables of each member, and why they are not the optimum of all, ''; None where there is none."""
    programme = joint_programme(members, shared)
    found = Piqp(config)(programme)
    if not found.solved:
        return None
    above = programme.above_least(found.x, found.multipliers)
    terms = programme.unit * float(np.abs(programme.linear * found.x).sum())
    why = "" if above <= OF_WORTH * terms else f"all plans together may cost {above:.3g} more than others"
    return np.split(found.x, np.cumsum([member.programme.linear.size for member in members]))[:-1], why


def joint_programme(members: Sequence[Member], shared: SharedPower) -> QPData:
    """The members' variables one after another, and last the peak above the one so far, kW."""
    from scipy import sparse

    parts, n = [member.programme for member in members], shared.limit_kW.size
    unit, starts = max(part.unit for part in parts), np.cumsum([0, *(part.linear.size for part in parts)])
    scaled = [part.unit / unit for part in parts]
    at = np.concatenate([start + member.power_at for start, member in zip(starts, members, strict=False)])
    steps = np.tile(np.arange(n), len(members))
    sums = sparse.csc_matrix((np.ones(at.size), (steps, at)), shape=(n, starts[-1] + 1))
    limited, peaks = np.isfinite(shared.limit_kW), n if shared.peak_price_per_kW else 0
    limit_kW = np.maximum(shared.limit_kW[limited] - len(members) * LIMIT_TOLERANCE_KW, 0.0)
    above = sparse.csc_matrix(
        (-np.ones(peaks), (np.arange(peaks), np.full(peaks, starts[-1]))), shape=(peaks, starts[-1] + 1)
    )
    linear = [part.linear * scale for part, scale in zip(parts, scaled, strict=True)]
    quadratic = [part.quadratic * scale for part, scale in zip(parts, scaled, strict=True)]
    return QPData(
        sparse.block_diag([*quadratic, sparse.csc_matrix((1, 1))], format="csc"),
        np.concatenate([*linear, [shared.peak_price_per_kW / unit]]),
        _beside([part.A for part in parts]),
        np.concatenate([part.b for part in parts]),
        sparse.vstack([_beside([part.G for part in parts]), sums[limited], sums[:peaks] + above], format="csc"),
        np.concatenate([*(part.low for part in parts), np.full(limit_kW.size + peaks, -np.inf)]),
        np.concatenate([*(part.high for part in parts), limit_kW, np.full(peaks, shared.peak_so_far_kW)]),
        np.concatenate([*(part.x_low for part in parts), [0.0]]),
        np.concatenate([*(part.x_high for part in parts), [np.inf]]),
        unit,
        sum(part.constant for part in parts),
    )


def _beside(blocks: Sequence[sparse.csc_matrix]) -> sparse.csc_matrix:
    from scipy import sparse

    rows = sum(block.shape[0] for block in blocks)
    return sparse.hstack([sparse.block_diag(blocks), sparse.csc_matrix((rows, 1))], format="csc")


@dataclass(frozen=True)
class SharedPlans:
    """Plans by building.

    `joint`: those that share what is shared; None where no building could take part. `why_over`: '', or why the limit
    may be exceeded.
    """

    plans: Mapping[str, Planned]
    joint: JointPlan | None
    why_over: str


def plan_shared(
    models: Mapping[str, ThermalModel],
    observations: Mapping[str, Observation],
    shared: SharedPower,
    largest_kW: Mapping[str, float],
    states: Mapping[str, object] | None = None,
    *,
    config: MPCConfig | Mapping[str, MPCConfig] | None = None,
    grace_s: float = 300.0,
) -> SharedPlans:
    """Plan for buildings whose planned powers together keep what is shared, mean over each step.

    A building that takes no part, because its model is not competent, its data are bad, it has no convex problem or no
    plan, has `largest_kW` set aside for it. The guard of a building, which acts when its rooms leave their band, asks
    nobody. `states`, `config` and their errors are those of `plan_many`.

    Args:
        observations: record and forecast of each building to plan for, by name; with the same steps.
        shared: limit and peak price over the steps of the plans (N,).
        largest_kW: the most that each building may draw whatever happens, by name, such as its fuse; also of buildings
            behind the same limit that are not planned for.
        grace_s: how long a plan stays valid after its step while the next one is late, s.

    Raises:
        DataError: `largest_kW` lacks a building, or holds what is no power of at least 0.
    """
    for name in {**observations, **largest_kW}:
        if not (np.isfinite(largest_kW.get(name, np.nan)) and largest_kW[name] >= 0.0):
            raise DataError(f"largest_kW: needs a power of at least 0 kW for building '{name}'")
    planner = BatchPlanner(buildings_of(models, config), grace_s)
    solves = _SharedSolves(shared, largest_kW, planner.answer)
    wanted = [(name, observation, (states or {}).get(name)) for name, observation in observations.items()]
    computations = [_labelled(name, planner.planning(name, observation, state)) for name, observation, state in wanted]
    plans = run(gather(computations, last=lambda request: isinstance(request.call, _LabelledSolve)), solves)
    planned = {
        name: planner.to_planned(observation, plan, state, seconds)
        for (name, observation, _), ((plan, state), seconds) in zip(wanted, plans, strict=True)
    }
    return SharedPlans(planned, solves.joint, solves.why_over)


@dataclass(frozen=True)
class _LabelledSolve:
    name: str
    solve: Solve

    def __call__(self) -> object:
        return self.solve()


def _labelled(name: str, computation: Computation[Result]) -> Computation[Result]:
    return altered(
        computation,
        lambda request: (
            replace(request, call=_LabelledSolve(name, request.call)) if isinstance(request.call, Solve) else request
        ),
    )


@dataclass
class _SharedSolves:
    """Answers solves, which come all at once, by one programme, and everything else as `others` does."""

    shared: SharedPower
    largest_kW: Mapping[str, float]
    others: Handler
    joint: JointPlan | None = field(default=None)
    why_over: str = field(default="")

    def __call__(self, requests: list[Request]) -> Sequence[RequestOutcome]:
        of = {i: request.call for i, request in enumerate(requests) if isinstance(request.call, _LabelledSolve)}
        rest = [i for i in range(len(requests)) if i not in of]
        outcomes = dict(zip(rest, self.others([requests[i] for i in rest]), strict=True)) if rest else {}
        if of:
            outcomes |= self._planned(of)
        return [outcomes[i] for i in range(len(requests))]

    def _planned(self, of: Mapping[int, _LabelledSolve]) -> dict[int, RequestOutcome]:
        members, why = list[Member](), dict[str, str]()
        for labelled in of.values():
            try:
                members.append(self._member(labelled))
            except ControllerConfigError as error:
                why[labelled.name] = str(error)
        taking_part = {member.name for member in members}
        others = [power for name, power in self.largest_kW.items() if name not in taking_part]
        configs = [
            labelled.solve.solver.config for labelled in of.values() if isinstance(labelled.solve.solver, QPSolver)
        ]
        joint = plan_jointly(members, self.shared.less(sum(others)), configs[0] if configs else QPConfig())
        self.joint = joint if members else None
        self.why_over = self.shared.why_over(joint.reserved_kW + sum(others), len(joint.silent) + len(others))
        why |= joint.silent
        return {
            i: RequestOutcome(
                failed("no share", 0, f"no share of what is shared: {why[labelled.name]}")
                if labelled.name in why
                else joint.solutions[labelled.name]
            )
            for i, labelled in of.items()
        }

    def _member(self, labelled: _LabelledSolve) -> Member:
        problem, model = labelled.solve.problem, getattr(labelled.solve.solver, "model", None)
        if not isinstance(model, PlanModel):
            raise ControllerConfigError("its problem is not convex")
        if problem.n_steps != self.shared.limit_kW.size:
            raise ControllerConfigError(f"it plans {problem.n_steps} steps, and {self.shared.limit_kW.size} are shared")
        return Member(labelled.name, model, problem, self.largest_kW[labelled.name])
