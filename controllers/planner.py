"""State that an MPC passes from step to step, and the planner of one thermal model."""

from __future__ import annotations

from dataclasses import dataclass, field

from controllers.actuation import ActuationState
from controllers.fallback import GoodPlan
from controllers.solvers import Solver
from controllers.watch import WatchState
from thermoforce_mpc.identification.adaptation import AdaptationState
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import Predictor, PredictorState
from thermoforce_mpc.model.thermal_model import ThermalModel


@dataclass(frozen=True)
class MPCState:
    """Controller state passed from one plan to the next.

    `first_s`: time of the first plan, s; `peak_W`: highest mean power of a step since, W; `actuation`: state of the
    machine; `good`: last solved plan; `predictor`, `adaptation`: states of predictor and online adaptation; `watch`:
    what the watch knows of the predictions; `offset_K`: recent mean error of the zone temperature planned for the end
    of a step.
    """

    first_s: float
    peak_W: float = 0.0
    actuation: ActuationState = field(default_factory=ActuationState)
    good: GoodPlan | None = None
    predictor: PredictorState | None = None
    adaptation: AdaptationState | None = None
    watch: WatchState = field(default_factory=WatchState)
    offset_K: float = 0.0


@dataclass(frozen=True)
class Planner:
    """Predictor and solver of one thermal model; `operator` is the model's, adjusted to the actuation mode."""

    model: ThermalModel
    predictor: Predictor
    operator: OperatorParameters
    solver: Solver
