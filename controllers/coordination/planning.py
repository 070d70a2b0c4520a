"""Plans of buildings that share a limit or a price of their summed power, at one instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from controllers.checks import ControllerConfigError
from controllers.coordination.joint import JointPlan, Member, SharedPower, plan_jointly
from controllers.many.batch import BatchPlanner, Planned, buildings_of
from controllers.mpc.config import MPCConfig
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.solution import Solve, failed
from controllers.optimisation.solvers.qp import QPSolver
from controllers.optimisation.solvers.qp_backends import QPConfig
from thermoforce_mpc.data import Observation
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
