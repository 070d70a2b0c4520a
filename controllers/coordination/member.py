"""One building of several that share power: its programme with a price, a wish or a limit of its own power."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import casadi as ca
import numpy as np
from scipy import sparse

from controllers.checks import ControllerConfigError
from controllers.optimisation.evaluation import Evaluation
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import POWER_UNIT_W, MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, checked_solution
from controllers.optimisation.solvers.qp_backends import Clarabel, Piqp, QPConfig, QPData
from controllers.optimisation.statement.terms import PlanExpressions
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator

# Power above its limit that a checked plan may have, kW: a solver's tolerance.
LIMIT_TOLERANCE_KW = 1e-5


def power_of_steps(plan: PlanExpressions) -> None:
    """The building's power over each step as variables, kW."""
    power = plan.variable("power", plan.power_W.shape[1], -np.inf, np.inf)
    plan.equal(power - ca.sum1(plan.power_W) / POWER_UNIT_W)


def diagonal(values: Array) -> sparse.csc_matrix:
    """A diagonal matrix that keeps its zeros, so that they can become other numbers."""
    places = np.arange(values.size + 1)
    return sparse.csc_matrix((values, places[:-1], places), shape=(values.size, values.size))


@dataclass(frozen=True, eq=False)
class Answer:
    """Power over each step, kW (N,), and what it costs the building without any price or wish on top, currency."""

    power_kW: Array
    cost: float


@dataclass(frozen=True)
class Settled:
    """A plan within a limit: the solution, its cost (currency) and mean power over each step, kW (N,)."""

    solution: Solution
    cost: float
    power_kW: Array


class Member(Protocol):
    """What a coordinator asks of a building; None, an exception, or numbers that make no sense are no answer.

    Such are powers below 0 or a hundred times above `largest_kW` and 1 kW, costs beyond ±10⁹, and what is not real.

    `largest_kW` (N,): the most it may draw over each step whatever happens.
    """

    name: str
    largest_kW: Array

    def answer(self, price: Array, wish_kW: Array, weight: float) -> Answer | None:
        """What minimises its cost + price · power + weight/2 · |power − wish_kW|².

        `price` (N,), currency per kW of each step; `wish_kW` (N,); `weight` currency/kW².
        """
        ...

    def settle(self, limit_kW: Array) -> Settled | None:
        """Its plan whose power stays within `limit_kW` (N,)."""
        ...


class QPMember:
    """A building whose problem is a convex quadratic programme, in this process.

    `largest_kW` (N,): the most it may draw; by default with every actuator at its end.

    Raises:
        ControllerConfigError: the problem is not convex.
    """

    def __init__(
        self,
        name: str,
        operator: BuildingOperator,
        shape: ProblemShape,
        problem: MPCProblem,
        config: QPConfig,
        largest_kW: Array | None = None,
    ) -> None:
        if shape.terms:
            raise ControllerConfigError(f"{name}: buildings that share power are planned without terms of your own")
        self._model = PlanModel(operator, replace(shape.by_steps, terms=(power_of_steps,)))
        if not self._model.convex or self._model.structure.chosen:
            raise ControllerConfigError(
                f"{name}: buildings that share power need a convex problem; use a model without feedback, and "
                "actuators that do not exclude one another"
            )
        self.name, self._config = name, config
        if problem.power_per_u2_W is not None:  # rows of power are linear in u: its chord, too high at part load
            problem = replace(
                problem, power_per_u_W=problem.power_per_u_W + problem.power_per_u2_W, power_per_u2_W=None
            )
        self._problem, self._p = problem, self._model.numbers(problem)
        data = self._model.local(self._p)
        self.data = replace(data, quadratic=diagonal(data.quadratic.diagonal()))
        self.of_power = self._model.own_at
        self._piqp = Piqp(config)
        self.largest_kW = self._largest_kW() if largest_kW is None else largest_kW

    def answer(self, price: Array, wish_kW: Array, weight: float) -> Answer | None:
        """What minimises its cost + price · power + weight/2 · |power − wish_kW|²; None where no solver finds it."""
        linear, quadratic = self.data.linear.copy(), self.data.quadratic.copy()
        linear[self.of_power] += (price - weight * wish_kW) / self.data.unit
        quadratic.data[self.of_power] += weight / self.data.unit
        data = replace(self.data, linear=linear, quadratic=quadratic)
        for solve in (self._piqp, Clarabel(self._config)):
            result = solve(data)
            if result.solved and np.isfinite(result.x).all():
                return Answer(np.maximum(result.x[self.of_power], 0.0), self.data.objective(result.x))
        return None

    def settle(self, limit_kW: Array) -> Settled | None:
        """Its plan whose power stays within `limit_kW` (N,); None where no solver finds one."""
        x_high = self.data.x_high.copy()
        x_high[self.of_power] = limit_kW
        data = replace(self.data, x_high=x_high)
        for solve in (Piqp(self._config), Clarabel(self._config)):
            answer = solve(data)
            solution = self._checked(answer.x, data) if answer.solved else None
            if solution is None or not solution.ok:
                continue
            found = self._brought(solution.u)
            power_kW = found.power_W.sum(axis=0) / POWER_UNIT_W
            if (power_kW <= limit_kW + LIMIT_TOLERANCE_KW).all():
                return Settled(solution, found.cost, power_kW)
        return None

    def _brought(self, u: Array) -> Evaluation:
        return self._model.evaluate(self._problem, self._p, u)

    def _checked(self, x: Array, data: QPData) -> Solution:
        model, u = self._model, self._model.levels(x)
        power_kW = self._brought(u).power_W.sum(axis=0) / POWER_UNIT_W
        solution = checked_solution(model, self._problem, self._p, u, data.objective(x), "settled", 0, power_kW)
        return replace(solution, own={})  # the power is ours, not the controller's

    def _largest_kW(self) -> Array:
        """Power with every actuator at its end that takes most; where capacity allows less, more than that."""
        p = self._problem
        highest, lowest = p.machinery.u_max[:, None], p.machinery.u_min[:, None]
        power = self._brought(np.repeat(highest, p.n_steps, axis=1)).power_W.sum(axis=0)
        if p.cooling is not None:
            power += np.maximum(-lowest * p.cooling.power_per_u_W - highest * p.power_per_u_W, 0.0).sum(axis=0)
        return np.asarray(power / POWER_UNIT_W)
