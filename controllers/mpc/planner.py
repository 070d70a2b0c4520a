"""What a controller is built from: its model and actuation, and planners of the model as identified and as adapted."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache

from controllers.actuation.actuator import ActuationChoice, choose_actuation
from controllers.actuation.actuators import Actuators
from controllers.checks import ControllerConfigError
from controllers.monitoring.watch import ScaledModel
from controllers.mpc.config import FreeResponseConfig, MPCConfig
from controllers.optimisation.plan_model import Evaluator, PlanModel
from controllers.optimisation.problem import EquipmentLayout, ProblemShape, blocked_moves, every_step
from controllers.optimisation.solution import Solver
from controllers.optimisation.solvers.ipopt import IpoptSolver
from controllers.optimisation.solvers.milp import MilpSolver
from controllers.optimisation.solvers.qp import QPSolver
from controllers.optimisation.solvers.sqp import SQPSolver
from controllers.optimisation.statement.terms import Terms
from thermoforce_mpc.data import HOUR_S, Layout
from thermoforce_mpc.model.free_response.substitute import WithSubstitutes
from thermoforce_mpc.model.machine.power import level_costs
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import FreeResponse

_LOG = logging.getLogger(__name__)
SolverBuilder = Callable[[BuildingOperator, ProblemShape], Solver]
"""Builds the solver of an operator, which is adjusted to the actuation, and of what all its problems have in common."""
# Zones up to which Ipopt solves a step well within 50 ms (`tf-mpc bench controller`, 2026-11-25).
_ZONES_FOR_IPOPT = 2


def plan_shape(
    config: MPCConfig,
    operator: BuildingOperator,
    machinery: EquipmentLayout,
    *,
    curved: bool = False,
    terms: Terms = (),
) -> ProblemShape:
    """What all problems over the horizon of `config` have in common; `curved`: power has a part in u²."""
    step_s, blocking = operator.step_s, config.move_blocking
    moves = blocked_moves(config.n_steps(step_s), step_s, blocking.free_h, blocking.hold_h)
    return ProblemShape(
        # Terms of the user are written for steps of one length.
        every_step(moves.size) if terms else moves,
        machinery,
        peak=config.objective.prices_peaks,
        capped=config.objective.power_cap_kW is not None or config.objective.at_the_meter,
        exchange=config.objective.at_the_meter,
        chosen_steps=config.milp.chosen_steps(step_s),
        curved=curved,
        terms=terms,
    )


def build_solver(config: MPCConfig, operator: BuildingOperator, shape: ProblemShape) -> Solver:
    """The solver named in `config`, or for `auto` the one that fits the problem.

    Raises `ControllerConfigError` where the solver named does not fit the problem.
    """
    ipopt = cache(lambda: IpoptSolver(operator, shape, config.ipopt))
    build: dict[str, Callable[[], Solver]] = {
        "ipopt": ipopt,
        "qp": lambda: QPSolver(operator, shape, config.qp, ipopt),
        "sqp": lambda: SQPSolver(operator, shape, config.sqp, config.qp, ipopt),
        "milp": lambda: MilpSolver(operator, shape, config.milp, config.qp, fallback=ipopt),
    }
    name = chosen_solver(config, operator, shape)
    if config.solver == "auto":
        choices = "with" if shape.needs_choices else "without"
        _LOG.info("solver %s, by auto for %d zone(s) %s choices between levels", name, len(operator.zones), choices)
    return build[name]()


def chosen_solver(config: MPCConfig, operator: BuildingOperator, shape: ProblemShape) -> str:
    """The solver named in `config`; for `auto` by choices, size and convexity of the problem."""
    if config.solver != "auto":
        return config.solver
    if len(operator.zones) <= _ZONES_FOR_IPOPT and not shape.needs_choices:
        return "ipopt"
    convex = PlanModel(operator, shape).convex
    if shape.needs_choices:
        return "milp" if convex and not shape.terms else "ipopt"
    return "qp" if convex else "sqp"


def at_step(model: ThermalModel, config: MPCConfig) -> tuple[ThermalModel, int]:
    """The model at the control step, and the number of steps of the horizon.

    Raises `ControllerConfigError` where that is none, or the effect is implausible, or not certified at that step over
    it.
    """
    step_s = config.step_s or model.operator.step_s
    n_steps = config.n_steps(step_s)
    if n_steps < 1:
        raise ControllerConfigError(
            f"controller.options.horizon_h: {config.horizon_h:g} h is shorter than one control step"
            f" ({step_s:g} s); give at least {step_s / HOUR_S:g}"
        )
    for a, actuator in enumerate(model.names.actuators):
        if too_much := model.implausible(a):
            raise ControllerConfigError(f"the model of {actuator} cannot be right: {too_much}; identify it again")
    operator = model.operator.resampled(step_s)
    if operator.of_actuator(0).feedback_active:  # otherwise certified at any
        proof = certificate(operator.of_actuator(0), n_steps)
        if not proof.certified:
            raise ControllerConfigError(
                "the model's gain sees the predicted temperature, and its effect is not certified at "
                f"controller.options.step_s {step_s:g} over horizon_h {config.horizon_h:g}: {'; '.join(proof.reasons)}"
            )
    return replace(model, operator=operator), n_steps


def check_exclusive(layout: Layout, commands: Collection[str]) -> None:
    """Raise `ControllerConfigError` where an actuator that excludes others is one of those set by `commands`."""
    for a in {a for group in layout.exclusive for a in group}:
        if layout.names.actuators[a] in commands:
            raise ControllerConfigError(
                f"{layout.names.actuators[a]} excludes others, and is set by a command, which does not tell "
                "whether it runs: leave command out of the map, and set its level"
            )


def check_power(model: ThermalModel) -> None:
    """Raise `ControllerConfigError` where the power of a machine is not known."""
    for machine, power in zip(model.machines, model.power, strict=True):
        if power is None:
            of = "" if len(model.machines) == 1 else f" of {machine}"
            raise ControllerConfigError(
                f"the model was identified without measured power{of}: energy cost cannot be computed;"
                " identify it anew from measurements with power (without a meter: the level times full power)"
            )


def actuations_of(config: MPCConfig, model: ThermalModel, layout: Layout) -> list[ActuationChoice]:
    """How each actuator is run (A,)."""
    choices = []
    for a, (actuator, u_min) in enumerate(zip(layout.names.actuators, layout.u_min, strict=True)):
        zone = model.actuator(a)
        assert zone.power is not None  # `check_power`
        actuation = config.actuation_of(actuator)
        if actuation.mode == "auto" and u_min < 0.0:  # what heats and cools is asked for by a set-point
            actuation = actuation.model_copy(update={"mode": "room_setpoints"})
        choice = choose_actuation(
            actuation,
            zone.power,
            zone.operator.heat_input,
            level_costs(zone.card.uncertainty),
            shared=len(layout.fed_by(layout.machine_of[a])) > 1,
        )
        if choice.actuation.by_rooms != (u_min < 0.0):
            raise ControllerConfigError(
                f"controller.options.actuation.mode: {actuation.mode}: {actuator} "
                + (
                    "heats and cools, which is done by set-points of the room: leave mode out, or set room_setpoints "
                    "(tf-mpc plan --set actuation.mode=room_setpoints)"
                    if u_min < 0.0
                    else "does not both heat and cool: leave mode out, or set duty or modulating"
                )
            )
        choices.append(choice)
    return choices


def free_responses_of(
    config: FreeResponseConfig, model: ThermalModel, given: FreeResponse | Sequence[FreeResponse] | None
) -> list[FreeResponse]:
    """The free response of each zone (Z,): those given, or those that `config` names, each with its substitutes."""
    from thermoforce_mpc.model.free_response.registry import build_free_response  # may load torch

    methods = given or [build_free_response(config.name, rc=free, **config.options) for free in model.free]
    each = methods if isinstance(methods, Sequence) else [methods] * len(model.names.zones)
    if config.substitutes:
        return [WithSubstitutes(method) for method in each]
    return [WithSubstitutes(method, substitutes=()) for method in each]


# Number of cached planners for adapted models; others are rebuilt when needed. By judgement: a watch keeps two models
# of an actuator.
_KEPT = 4

# What each actuator's model differs in from the identified one; None where in nothing.
_Factors = tuple[tuple[float, float] | None, ...]


def known_part(model: ThermalModel, operator: BuildingOperator) -> BuildingOperator:
    """The operator with the part of effects between zones that plans count on (`ThermalModel.counted_on`)."""

    def known(z: int, a: int, pair: OperatorParameters) -> OperatorParameters:
        share = model.counted_on(z, a)
        return pair if share == 1.0 else replace(pair, gains=pair.gains * share)

    return operator.map_pairs(known)


class Planners:
    """Builds and keeps planners.

    `model`: as identified, at the control step; `free_responses` (Z,); `solver` and `shape` are those of an operator,
    which is adjusted to the actuation.
    """

    def __init__(
        self,
        model: ThermalModel,
        actuators: Actuators,
        free_responses: Sequence[FreeResponse],
        solver: SolverBuilder,
        shape: Callable[[BuildingOperator], ProblemShape],
    ) -> None:
        self._actuators, self._free_responses = actuators, tuple(free_responses)
        self._solver, self._shape = solver, shape
        self._zones = tuple(model.actuator(a) for a in range(len(model.names.actuators)))
        self.base = self._build(model)
        self._adapted: list[tuple[_Factors, Planner]] = []

    def of(self, adaptation: Sequence[ScaledModel | None]) -> Planner:
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
        renewed = replace(planner, solver=self._solver(planner.operator, self._shape(planner.operator)))
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
        operator = known_part(model, operator)
        predictor, shape = Predictor(model.operator, self._free_responses), self._shape(operator)
        stated = Evaluator(operator, shape)
        return Planner(model, predictor, operator, self._solver(operator, shape), stated.by_steps, stated)


@dataclass(frozen=True)
class Planner:
    """Predictor and solver of one thermal model.

    `operator`: the model's, adjusted to the actuation, with what is known of its effects between zones.

    `evaluator`: what levels bring, step by step, whatever solver they are from; `stated`: in the moves that are solved.
    """

    model: ThermalModel
    predictor: Predictor
    operator: BuildingOperator
    solver: Solver
    evaluator: Evaluator
    stated: Evaluator
