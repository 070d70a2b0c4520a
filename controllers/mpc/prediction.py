"""What will be: the free forecast with its band, by the model as it is adapted now, and what was learned on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from controllers.checks import message_of
from controllers.monitoring.zone_sensors import ZoneSensors
from controllers.mpc.model_watch import WatchedPredictions
from controllers.mpc.planner import Planner, Planners
from controllers.mpc.readings import Readings
from controllers.mpc.state import MPCState
from thermoforce_mpc.data import Observation
from thermoforce_mpc.execution.cooperative import Computation, within
from thermoforce_mpc.model.predictor import PredictionContext


@dataclass(frozen=True)
class Forecast:
    """A prediction before actions are chosen: its context, the planner of the model it was made with, and the state."""

    context: PredictionContext
    planner: Planner
    state: MPCState


@dataclass(frozen=True)
class Failure:
    """Why there is no plan in this step, as a value: the reason, the solver's status, seconds spent, and the state."""

    reason: str
    state: MPCState
    solver_status: str = "not started"
    seconds: Mapping[str, float] = field(default_factory=dict)


class Prediction:
    """Predicts for the steps of a plan; it holds no state.

    Args:
        planners: of the building's models.
        sensors: zone sensors, which are validated by what is forecast now.
        watched: records what is predicted, to be compared with what comes.
        n_steps: steps ahead.
        seconds: longest wall time, s.
    """

    def __init__(
        self,
        planners: Planners,
        sensors: ZoneSensors,
        watched: WatchedPredictions,
        n_steps: int,
        seconds: float,
    ) -> None:
        self._planners, self._sensors = planners, sensors
        self._watched, self._n_steps, self._seconds = watched, n_steps, seconds

    def ahead(self, observation: Observation) -> Observation:
        """The observation with the boundary forecast of the plan's steps only."""
        return Observation(observation.history, observation.boundary.head(self._n_steps))

    def predict(self, readings: Readings, state: MPCState) -> Computation[Forecast | Failure]:
        """The forecast, with the state after it; the state as it was where it fails."""
        try:
            planner = self._planners.of(state.adaptation)
            contexting = planner.predictor.contexting(self.ahead(readings.observation), state.predictor)
            context = yield from within(self._seconds, contexting)
        except Exception as error:  # whatever a forecaster raises, there is another way to act
            return Failure(f"no prediction ({message_of(error)})", state)
        return Forecast(context, planner, replace(state, predictor=context.state))

    def record(self, forecast: Forecast, readings: Readings) -> Forecast:
        """The forecast with a state that remembers what was predicted, for the sensors and the watch."""
        context, state = forecast.context, forecast.state
        sensors = self._sensors.anchored(state.sensors, readings.history, context)
        state = self._watched.record_prediction(replace(state, sensors=sensors), context, forecast.planner)
        return replace(forecast, state=state)
