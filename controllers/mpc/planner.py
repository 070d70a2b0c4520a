"""Planners of the models of a building, as identified and as adapted to how its actuators behave, and their solvers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from controllers.actuation.actuators import Actuators
from controllers.checks import ControllerConfigError
from controllers.mpc.config import MPCConfig
from controllers.optimisation.candidate_search import CandidateSearch
from controllers.optimisation.ipopt import IpoptSolver
from controllers.optimisation.machines import EquipmentLayout
from controllers.optimisation.milp import MilpSolver
from controllers.optimisation.problem import ProblemShape, blocked_moves
from controllers.optimisation.qp import QPSolver
from controllers.optimisation.solution import Solver
from thermoforce_mpc.identification.estimation.adaptation import AdaptationState
from thermoforce_mpc.model.forced_state import EstimatorConfig, ForcedStateEstimator
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import FreeResponse


def build_solver(config: MPCConfig, operator: BuildingOperator, machinery: EquipmentLayout) -> Solver:
    """The solver named in `config`, or for `auto` the fastest one that fits the problem, over the horizon of `config`.

    Raises:
        ControllerConfigError: the solver named does not fit the problem.
    """
    n_steps, step_s = config.n_steps(operator.step_s), operator.step_s
    if config.solver == "search":
        if machinery.signed.size:
            raise ControllerConfigError(
                "controller.options.solver: search does not plan heating and cooling together; use auto or qp"
            )
        return CandidateSearch(operator, n_steps, config.search)
    shape = ProblemShape(
        blocked_moves(n_steps, step_s, config.move_blocking.free_h, config.move_blocking.hold_h),
        machinery,
        peak=config.objective.peak_price_per_kW > 0,
        capped=config.objective.power_cap_kW is not None,
        held_steps=config.milp.held_steps(step_s),
    )
    solver = config.solver
    if solver == "auto":
        solver = "ipopt" if operator.of_actuator(0).feedback_active else "milp"
        solver = "qp" if shape.convex(operator) else solver
    if solver == "qp":
        return QPSolver(operator, shape, config.qp)
    if solver == "milp":
        return MilpSolver(operator, shape, config.milp, config.qp)
    return IpoptSolver(operator, shape, config.ipopt)


# Number of cached planners for adapted models; others are rebuilt when needed.
_KEPT = 4

# What each actuator's model differs in from the identified one; None where in nothing.
_Factors = tuple[tuple[float, float, float] | None, ...]


class Planners:
    """Builds and keeps planners.

    Args:
        model: the building as identified, at the control step.
        actuators: how its actuators are run.
        free_responses: the free response of each zone (Z,).
        estimator: options of the estimator of forced states.
        solver: builds the solver of an operator, which is adjusted to the actuation.
    """

    def __init__(
        self,
        model: ThermalModel,
        actuators: Actuators,
        free_responses: Sequence[FreeResponse],
        estimator: EstimatorConfig,
        solver: Callable[[BuildingOperator], Solver],
    ) -> None:
        self._actuators, self._free_responses = actuators, tuple(free_responses)
        self._estimator, self._solver = estimator, solver
        self._zones = tuple(model.actuator(a) for a in range(len(model.names.actuators)))
        self.base = self._build(model)
        self._adapted: list[tuple[_Factors, Planner]] = []

    def of(self, adaptation: Sequence[AdaptationState | None]) -> Planner:
        """The planner of the building with adapted models of its actuators (A,), from the cache if present."""
        factors = tuple(None if state is None or not state.adapted else state.factors for state in adaptation)
        if not any(factors):
            return self.base
        for cached_factors, planner in self._adapted:
            if cached_factors == factors:
                return planner
        zones = [zone if state is None else state.model for zone, state in zip(self._zones, adaptation, strict=True)]
        planner = self._build(self.base.model.with_actuators(zones))
        self._adapted = [*self._adapted, (factors, planner)][-_KEPT:]
        return planner

    def renew_solver(self, planner: Planner) -> None:
        """Give a planner whose solver has not returned another one; the old one must not be called meanwhile."""
        renewed = replace(planner, solver=self._solver(planner.operator))
        if planner is self.base:
            self.base = renewed
        self._adapted = [(factors, renewed if cached is planner else cached) for factors, cached in self._adapted]

    def _build(self, model: ThermalModel) -> Planner:
        # The operator must match the actuation: below the lowest level the machine switches.
        operator = model.operator.map_actuators(
            lambda a, pair: replace(
                pair, heat_input=pair.heat_input.at_lowest_level(self._actuators.each[a].lowest_level)
            )
        )
        estimator = ForcedStateEstimator(model.operator, config=self._estimator)
        predictor = Predictor(model.operator, self._free_responses, estimator=estimator)
        return Planner(model, predictor, operator, self._solver(operator))


@dataclass(frozen=True)
class Planner:
    """Predictor and solver of one thermal model; `operator` is the model's, adjusted to the actuation."""

    model: ThermalModel
    predictor: Predictor
    operator: BuildingOperator
    solver: Solver
