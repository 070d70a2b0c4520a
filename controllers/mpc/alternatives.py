"""What else could have been done at an instant: the model of an MPC under other levels over its horizon.

Free response, weather, prices and bounds are those of the plan; only the levels differ (paper eq:effect), so that what
one course costs and brings more than another is the model's own answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from controllers.mpc.controller import ThermoForceMPC
from controllers.mpc.courses import Courses
from controllers.mpc.margins import Margins
from controllers.optimisation.plan_model import Evaluation
from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.data import HOUR_S, Array, FreeForecast, Observation, Plan, energy_kWh
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.model.operator.parameters import feature_matrix
from thermoforce_mpc.model.predictor import PredictionContext

# The saved model and the one that planned are the same where its forced response is within this, K. By judgement.
_SAME_K = 0.2
# Sums that differ by less are the same, currency: solvers stop there.
_CENT = 0.005
# What more or less of each part of the cost is, in words.
_PARTS = {
    "energy": "energy costs {}",
    "discomfort": "discomfort counts {}",
    "peak": "power beyond its peak costs {}",
    "cap": "power beyond its cap costs {}",
    "other": "other terms cost {}",
}


@dataclass(frozen=True)
class AlternativeCourse:
    """Levels `u` (A, N) over a horizon of N steps, and what the model predicts under them.

    `T_zone_C` (Z, N), at the end of each step; `parts`: what the controller minimises the sum of, by name
    (`problem_statement.PARTS`), currency; `energy_kWh`: of all machines; `discomfort_Kh`: distance from the comfort
    bounds, all zones together (the part `discomfort` counts from those with margins inside); `broken`: which limit it
    leaves, or ''.
    """

    name: str
    u: Array
    T_zone_C: Array
    parts: Mapping[str, float]
    energy_kWh: float
    discomfort_Kh: float
    broken: str = ""

    @property
    def total(self) -> float:
        """What is minimised, currency."""
        return sum(self.parts.values())


@dataclass(frozen=True)
class Alternatives:
    """The plan (if there was one) and other courses over the same horizon; `notes`: what they rest on."""

    courses: tuple[AlternativeCourse, ...]
    notes: tuple[str, ...] = ()

    @property
    def reason(self) -> str:
        """Why the plan was taken, or what totals less by this model; '' without a plan."""
        plan, *others = self.courses
        others = [course for course in others if not course.broken]
        if plan.name != "plan" or not others:
            return ""
        best = min(others, key=lambda course: course.total)
        parts = sorted(best.parts, key=lambda part: plan.parts[part] - best.parts[part])
        more, less = (
            [part for part in parts if sign * (best.parts[part] - plan.parts[part]) > _CENT] for sign in (1, -1)
        )
        told = "; ".join(_PARTS[part].format(_by(best.parts[part] - plan.parts[part])) for part in (*more, *less))
        if best.total >= plan.total - _CENT:
            ahead = f"the least total; next is {best.name}, {best.total - plan.total:.2f} more"
        else:
            ahead = f"not the least total: {best.name} has {plan.total - best.total:.2f} less"
        return f"{ahead} ({told})" if told else ahead


def _by(difference: float) -> str:
    return f"{abs(difference):.2f} {'more' if difference > 0 else 'less'}"


def alternatives(
    controller: ThermoForceMPC, observation: Observation, planned: Plan | None, peak_W: float = 0.0
) -> Alternatives:
    """The courses off, full, as in the step before, thermostat rule and loops at the bounds, beside the plan.

    `controller`: as it was built for the run; `observation`: what the plan was made on, the boundary without gaps;
    `planned`: None where nothing was planned, then the free response is that of the controller's own predictor;
    `peak_W`: highest mean power of the building over a step of the run until then, W.

    Raises:
        DataError: a bound or price is missing, or the record cannot be split into free and forced response.
    """
    history, notes = observation.history, []
    n = round(controller.horizon_s / controller.step_s) if planned is None else planned.u.shape[1]
    observation = Observation(history, observation.boundary.head(n))
    if planned is None:
        context = controller.predictor.context(observation)
        notes.append(f"nothing was planned: {context.free.note or 'a forecast'} stands for the free response")
    else:
        context = _context(controller, observation, planned)
    model = _Model(controller, context, observation, planned, peak_W)
    courses = []
    if planned is not None:
        if (off_K := model.correct(planned)) > _SAME_K:
            notes.append(
                f"the saved model is up to {off_K:.1f} K from the one that planned, which had adapted or judged the "
                "record otherwise: only the differences to the plan are the saved one's"
            )
        courses.append(model.course("plan", planned.u))
    ruled = model.courses
    for name, u in model.constant().items():
        courses.append(model.course(name, u))
    last = history.u[:, -1] if history.n_steps else np.full(len(controller.rules), np.nan)
    if np.isfinite(last).all():
        courses.append(model.course("levels of the step before", ruled.limited(np.repeat(last[:, None], n, axis=1))))
    else:
        notes.append("the levels of the step before are not known: the building's own control acted")
    courses.append(model.course("thermostat rule", ruled.follow(ruled.rule)))
    courses.append(model.course("loops at the bounds", ruled.follow(ruled.loop)))
    notes += [f"{course.name}: {course.broken}" for course in courses if course.broken]
    if planned is not None and model.own:
        notes.append(
            f"values of your own variables are not in the journal: {', '.join(model.own)} are 0 in other terms"
        )
    return Alternatives(tuple(courses), tuple(notes))


def _context(controller: ThermoForceMPC, observation: Observation, planned: Plan) -> PredictionContext:
    boundary, operator = observation.boundary, controller.model.operator
    free = np.stack([planned.T_free_low_C, planned.T_free_C, planned.T_free_high_C])
    starts = np.concatenate([planned.T_free_now_C[:, None], planned.T_free_C[:, :-1]], axis=1)
    return PredictionContext(
        operator=operator,
        forced_K=controller.predictor.forced_state(observation.history),
        free=FreeForecast(np.array([0.1, 0.5, 0.9]), free),
        features=feature_matrix(starts, boundary.T_out_C[:-1], boundary.solar_W_m2[:-1], boundary.time_s[:-1]),
        boundary=boundary,
        names=observation.names,
    )


class _Model:
    def __init__(
        self,
        controller: ThermoForceMPC,
        context: PredictionContext,
        observation: Observation,
        planned: Plan | None,
        peak_W: float,
    ) -> None:
        self._controller, self._context, self._boundary = controller, context, context.boundary
        margins = Margins.nothing(len(context.names.zones), len(context.names.machines))
        if planned is not None:  # its free response has the offset, its bounds have the other margins
            margins = replace(margins, unused=planned.margins["unused_capacity"])
        self._problem: MPCProblem = controller.instance(context, observation.history, margins, peak_W)
        if planned is not None:
            self._problem = replace(self._problem, lower_C=planned.lower_C, upper_C=planned.upper_C)
        self._layout, self._machinery = controller.model.layout, self._problem.machinery
        self._T_zone_C = observation.T_zone_C
        self.own = controller.evaluator.own_names

    @cached_property
    def courses(self) -> Courses:
        """Rules in this instance."""
        return self._controller.courses(
            self._controller.planning_operator, self._problem, self._boundary, self._T_zone_C
        )

    def correct(self, planned: Plan) -> float:
        """Move the free response by what the plan's forced response was beyond that of this model; K at most."""
        moved_K = planned.T_forced_K - self.evaluate(planned.u).forced_K
        self._problem = replace(self._problem, T_free_C=self._problem.T_free_C + moved_K)
        return float(np.abs(moved_K).max())

    def evaluate(self, u: Array) -> Evaluation:
        """What levels (A, N) bring, by the statement of the plan."""
        return self._controller.evaluator.brings(self._problem, u)

    def course(self, name: str, u: Array) -> AlternativeCourse:
        """What the model predicts under levels (A, N)."""
        brought = self.evaluate(u)
        T_zone_C = compose(self._problem.T_free_C, brought.forced_K)
        hours = self._boundary.step_s / HOUR_S
        return AlternativeCourse(
            name,
            u,
            T_zone_C,
            parts=brought.parts,
            energy_kWh=energy_kWh(float(brought.power_W.sum()), self._boundary.step_s),
            discomfort_Kh=float(self._boundary.outside_K(T_zone_C).sum()) * hours,
            broken=brought.broken,
        )

    def constant(self) -> dict[str, Array]:
        """All off, and all that heats or cools at full level, (A, N) by name."""
        u_max, u_min = self._machinery.u_max, self._machinery.u_min
        heating = np.array([self._layout.mode(a) != "cooling" for a in range(u_max.size)])
        cooling = np.array([self._layout.mode(a) == "cooling" for a in range(u_max.size)])
        courses = {"off": np.zeros(u_max.size)}
        if heating.any():
            courses["full"] = np.where(heating, u_max, 0.0)
        if cooling.any() or (u_min < 0.0).any():
            courses["full cooling" if heating.any() else "full"] = np.where(cooling, u_max, u_min)
        n = self._boundary.n_steps
        return {name: self.courses.limited(np.repeat(levels[:, None], n, axis=1)) for name, levels in courses.items()}
