"""How a run was planned: plans by solver, calls of the exported operator, and how many of its parameters were used."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.data.plan import NOT_ECONOMICAL, UNDECIDED
from thermoforce_mpc.errors import counted
from thermoforce_mpc.simulation.closed_loop import RunResult, StepRecord

if TYPE_CHECKING:
    from thermoforce_mpc.model.thermal_model import ThermalModel

# Share of the steps from which accepted discomfort is told, and how far beyond a bound a zone is planned then, K: what
# only takes from a margin is none.
_WORTH_TELLING, _NOTICED_K = 0.01, 0.05
# Steps without a decision from which they are told.
_A_FEW = 3
# Hours ahead in which accepted discomfort counts.
_SOON_H = 6.0
# Solvers by the first word of their status.
_SOLVERS = {
    "ipopt": "Ipopt",
    "piqp": "PIQP",
    "sqp": "SQP",
    "highs": "HiGHS",
    "policy": "a trained policy",
}


@dataclass(frozen=True)
class Planning:
    """Counts of a closed loop.

    Attributes:
        steps: control steps.
        plans: steps with a plan of a solver, by solver, most first; what an override did with it is not counted here.
        failed: steps in which a solver was started and gave no plan.
        undecided: steps in which the controller met an error that it has no answer to; native control acted.
        why_undecided: the most frequent of these errors.
        uncomfortable: plans that accept discomfort in the next hours (0.05 K beyond a bound), since heat costs more.
        export_calls: calls of the exported operator for those plans, one for each horizon and actuator.
        trained, used: parameters of the operator, and those of them that affect a prediction; 0 without a model.
    """

    steps: int
    plans: Mapping[str, int]
    failed: int
    undecided: int
    why_undecided: str
    uncomfortable: int
    export_calls: int
    trained: int
    used: int

    def to_json(self) -> dict[str, Any]:
        """The counts, and what they say in words."""
        return {**asdict(self), "in_words": self.in_words()}

    def in_words(self) -> str:
        """One line for people."""
        words = "nothing was planned"
        if self.plans:
            by = [f"{n} times by {_SOLVERS.get(solver, solver)}" for solver, n in self.plans.items()]
            words = f"planned {' and '.join(filter(None, (', '.join(by[:-1]), by[-1])))}"
            words += " over the exported operator" if self.export_calls else ""
            words += f": {counted(self.trained, 'trained parameter')}, {self.used} used" if self.trained else ""
        if self.undecided >= _A_FEW:
            alarm = f"NO DECISION WAS MADE IN {self.undecided} OF {self.steps} STEPS, NATIVE CONTROL ACTED INSTEAD"
            words = f"{alarm} ({self.why_undecided}); {words}"
        words += f"; {counted(self.failed, 'solve')} without a plan" if self.failed else ""
        if self.uncomfortable > _WORTH_TELLING * self.steps:
            words += f"; in {self.uncomfortable / self.steps:.0%} of the steps discomfort in the next {_SOON_H:g} h "
            words += f"{NOT_ECONOMICAL} (controller.options.objective.comfort_weight_per_m2)"
        return words


def _beyond_K(step: StepRecord) -> float:
    """How far a plan lets a zone leave its comfort bounds in the next hours, K; later plans see to what comes after."""
    plan, boundary = step.plan, step.boundary
    n = min(plan.u.shape[1], max(1, round(_SOON_H * HOUR_S / boundary.step_s)))
    lower_C, upper_C = boundary.lower_C[:, 1 : n + 1], boundary.upper_C[:, 1 : n + 1]
    T_C = plan.T_zone_C[:, : lower_C.shape[1]]
    return float(np.nanmax(np.maximum(lower_C - T_C, T_C - upper_C), initial=0.0))


def planning_of(result: RunResult, model: ThermalModel | None) -> Planning:
    """The counts of a closed loop; `model`: what its controller planned with, if anything."""
    plans, undecided = Counter[str](), Counter[str]()
    failed = uncomfortable = calls = 0
    for step in result.steps:
        solver, _, how = step.plan.solver_status.partition(":")
        if step.plan.u.size:
            plans[solver or "another solver"] += 1
            calls += step.plan.export_calls
            uncomfortable += NOT_ECONOMICAL in step.plan.why and _beyond_K(step) > _NOTICED_K
        elif solver == UNDECIDED:
            undecided[how.strip()] += 1
        else:
            failed += bool(how) or solver == "raised"
    operator = None if model is None else model.operator
    return Planning(
        steps=len(result.steps),
        plans=dict(plans.most_common()),
        failed=failed,
        undecided=undecided.total(),
        why_undecided=next((why for why, _ in undecided.most_common(1)), ""),
        uncomfortable=uncomfortable,
        export_calls=calls,
        trained=operator.n_trained if operator else 0,
        used=operator.n_used if operator else 0,
    )
