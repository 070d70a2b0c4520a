"""What is believed of the building at the begin of a step: zones, meters, sun, gaps, forecast and forced state.

What will be: the free forecast with its band, by the model as it is adapted now, and whether predictions come true.

Each actuator is watched on its home zone (`single_actuator_records`), so that control of one may be handed back alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from controllers.checks import message_of
from controllers.monitoring.meters import Meters
from controllers.monitoring.single_actuator import single_actuator_context, single_actuator_records
from controllers.monitoring.sun_on_sensors import SunOnSensors
from controllers.monitoring.watch import ScaledModel, Track, Watch, WatchState
from controllers.monitoring.zone_sensors import Sensor, Zones, ZoneSensors
from controllers.mpc.config import MPCConfig
from controllers.mpc.planner import Planner, Planners
from controllers.mpc.state import MPCState
from thermoforce_mpc.data import Array, Boundary, Observation, Plan, Record
from thermoforce_mpc.data.series import bridged, gapless
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution.cooperative import Computation, gather, within
from thermoforce_mpc.model.forced_state import ForcedState
from thermoforce_mpc.model.forecast_gaps import completed, whole
from thermoforce_mpc.model.predictor import PredictionContext, Predictor, PredictorState
from thermoforce_mpc.model.sun_on_sensor import off_sensors
from thermoforce_mpc.model.thermal_model import ThermalModel


@dataclass(frozen=True)
class Readings:
    """What is believed now.

    `observation`: the record with rejected readings as not measured, and the boundary forecast with its gaps filled;
    `forecast`: that forecast as given. `forced_K` (Z, A, n + 1, r): forced state of the model as identified at each
    boundary of the record; None where not known. `doubts`: what stands in for what; `news`: what is believed again or
    not.
    """

    observation: Observation
    forecast: Boundary
    zones: Zones
    forced_K: Array | None
    doubts: tuple[str, ...] = ()
    news: tuple[str, ...] = ()

    @property
    def history(self) -> Record:
        """The record that is believed."""
        return self.observation.history

    @property
    def time_s(self) -> float:
        """Now, s since 1 January."""
        return self.observation.time_s


class ReadingsFilter:
    """Takes an observation and what a run knows, and gives what is believed; it holds no state.

    `sensors`, `meters`: the checks of zone sensors, and of weather sensors and meters; `n_steps`: of a plan.
    """

    def __init__(self, config: MPCConfig, model: ThermalModel, predictor: Predictor, n_steps: int) -> None:
        zones = model.names.zones
        self.sensors = ZoneSensors([Sensor(config.sensor_of(zone), "" if len(zones) == 1 else zone) for zone in zones])
        self.meters = Meters(model.layout, config.meter, config.meters)
        self._sun = SunOnSensors(model, [config.sensor_of(zone).enabled for zone in zones])
        self._model, self._predictor, self._cold_after = model, predictor, config.fallback.cold_after
        self._look_s = config.deadline.look_s
        self._n_steps = n_steps

    def clean(
        self, observation: Observation, state: MPCState, *, with_model: bool, as_identified: bool
    ) -> Computation[tuple[Readings, MPCState]]:
        """What is believed of `observation`, and the state with what was learned of sensors, meters, sun and forecast.

        `with_model`: whether the model may say anything of the readings; without, they are validated by range only.
        `as_identified`: whether the model in use is the one as identified, so that its forced state can be kept.
        """
        if state.failures >= self._cold_after:  # what it kept may be what fails
            state = replace(state, predictor=None)
        history, state, sun_news = yield from self._without_sun(self._model.own_heat(observation.history), state)
        history = self.meters.mask_rejected(state.meters, history)
        boundary, filled = completed(observation.boundary, history, state.boundary)
        meters, metered = self.meters.validate(state.meters, history, boundary)
        history = self.meters.mask_rejected(meters, history)
        if metered.found:  # the forced state was computed with them
            state = state.without_forced()
        late_news = ""
        if with_model:
            history, late_news = self._in_time(history, first=state.predictor is None)
        before = self.sensors.mask_rejected(state.sensors, history)
        state, began = (yield from self._anchored(before, state)) if with_model else (state, None)
        forced = (self._forced(before, state) if began is None else began) if with_model else None
        forced_K = None if forced is None else forced.forced_K
        sensors, validated, zones = self.sensors.validate(state.sensors, history, forced_K)
        if forced and as_identified and validated is before and gapless(validated) and state.predictor:
            state = replace(state, predictor=replace(state.predictor, forced=forced))  # not estimated again
        state = replace(
            state, sensors=sensors, meters=meters, boundary=boundary if whole(observation.boundary) else state.boundary
        )
        seen = Observation(validated, boundary)
        doubts = tuple(filter(None, (zones.bridged, metered.why, filled)))
        news = tuple(filter(None, (sun_news, late_news, zones.news, metered.news)))
        return Readings(seen, observation.boundary, zones, forced_K, doubts, news), state

    def _anchored(self, history: Record, state: MPCState) -> Computation[tuple[MPCState, ForcedState | None]]:
        """The state of a run that begins with what predicts readings that repeat themselves, and forced states until
        now; None where nothing does.
        """
        since = self.sensors.repeat_since(state.sensors, history)
        if not since:
            return state, None
        whole, _ = bridged(history)
        sensors = list(state.sensors)
        try:
            for z, i in since.items():
                begin, since_then = whole.slice(0, i), Boundary.measured(whole.slice(i, whole.n_steps))
                measured = since_then.head(self._n_steps)
                context = yield from self._predictor.contexting(Observation(begin, measured))
                sensors[z] = self.sensors.anchored(state.sensors, begin, context)[z]
            return replace(state, sensors=tuple(sensors)), self._predictor.followed(history)
        except DataError:  # the record until then tells too little to predict from
            return state, None

    def _without_sun(self, history: Record, state: MPCState) -> Computation[tuple[Record, MPCState, str]]:
        """The record without the sun on sensors, which is looked for at night, the state, and what was found."""
        believed = self.sensors.mask_rejected(state.sensors, self.meters.mask_rejected(state.meters, history))
        sun = yield from self._sun.updating(state.sun, believed, self._look_s)
        news, of_zones = self._sun.news(state.sun, sun), self._sun.of_zones(sun)
        if of_zones != self._sun.of_zones(state.sun):  # the forced state may follow the temperature
            state = state.without_forced()
        return off_sensors(history, of_zones), replace(state, sun=sun), news

    def _in_time(self, history: Record, *, first: bool) -> tuple[Record, str]:
        """The record with the temperatures of rooms whose sensors are late, and news; as it is without levels."""
        try:
            late = self._model.late_readings(history)
        except DataError:  # prediction meets the same error and says it
            return history, ""
        return late.in_time(), late.news(first=first)

    def _forced(self, history: Record, state: MPCState) -> ForcedState | None:
        """Forced states of the building until now; None at the start, or if they cannot be estimated."""
        if state.predictor is None:
            return None
        try:
            return self._predictor.followed(history, state.predictor)
        except DataError:  # prediction meets the same error and says it; without the state nothing is validated by it
            return None


def joined(texts: Sequence[str]) -> str:
    """Parts of a sentence, without those that are empty."""
    return "; ".join(filter(None, texts))


Item = TypeVar("Item")


class WatchedPredictions:
    """Moves what the watches (A,) need in and out of the state of an MPC; it holds no state.

    `planner` gives that of a model with the adaptations of all actuators; `model`: as identified; `enabled`: whether
    predictions are compared.
    """

    def __init__(
        self,
        watches: Sequence[Watch],
        planner: Callable[[Sequence[ScaledModel | None]], Planner],
        model: ThermalModel,
        *,
        enabled: bool,
    ) -> None:
        self._watches, self._planner, self._model = tuple(watches), planner, model
        self.enabled = enabled

    def begin(self, time_s: float, origin: Any) -> tuple[WatchState, ...]:
        """The state of each watch at the begin of a run (A,); `origin`: see `Watch.begin`."""
        return tuple(watch.begin(time_s, origin) for watch in self._watches)

    def validate(self, now: MPCState, history: Record, forced_K: Array | None) -> MPCState:
        """The state with the predictions that came due compared; where control returns, with the model that held.

        `forced_K` (Z, A, n + 1, r): forced states until now, see `single_actuator_records`.
        """
        records = single_actuator_records(self._model, history, forced_K)
        for a, (watch, record) in enumerate(zip(self._watches, records, strict=True)):
            before = now.watch[a]
            try:
                after = watch.validate(before, record, now.adaptation[a], now.predictor)
            except DataError as error:  # a record that cannot be judged stops no plan
                news = f"predictions could not be judged ({message_of(error)})"
                now = replace(now, watch=_with(now.watch, a, replace(before, news=news)))
                continue
            if before.alarm and not after.alarm:
                used = after.tracks[0]
                predictor = later_state(now.predictor, used.predictor)
                now = replace(now, adaptation=_with(now.adaptation, a, used.adaptation), predictor=predictor)
            now = replace(now, watch=_with(now.watch, a, after))
        return now

    def record_prediction(self, now: MPCState, context: PredictionContext, planner: Planner) -> MPCState:
        """The state with the predictions of a plan recorded for all actuators in use, where one is due."""
        states = list(now.watch)
        for a, watch in enumerate(self._watches):
            if not watch.due(float(context.boundary.time_s[0])) or states[a].alarm:
                continue
            if context.operator.home[a] in context.unmeasured:
                continue  # what stands in for a temperature is no prediction
            issued = watch.issued(
                states[a].tracks[0], single_actuator_context(context, a), planner.operator.of_actuator(a)
            )
            states[a] = replace(states[a], tracks=(issued,))
        return replace(now, watch=tuple(states))

    def predict_in_background(self, observation: Observation, now: MPCState) -> Computation[MPCState]:
        """The state with new predictions of the models that are watched while another controller acts."""
        states = list(now.watch)
        for a, watch in enumerate(self._watches):
            if not states[a].alarm or not watch.due(observation.time_s):
                continue
            tracks = yield from gather([self._predicted(observation, now, a, track) for track in states[a].tracks])
            states[a] = replace(states[a], tracks=tuple(tracks))
        return replace(now, watch=tuple(states))

    def _predicted(self, observation: Observation, now: MPCState, a: int, track: Track) -> Computation[Track]:
        planner = self._planner(_with(now.adaptation, a, track.adaptation))
        try:
            context = yield from planner.predictor.contexting(observation, track.predictor)
        except Exception:  # as in planning, by any forecaster; without predictions a model does not get control back
            return track
        if context.operator.home[a] in context.unmeasured:
            return track
        issued = self._watches[a].issued(track, single_actuator_context(context, a), planner.operator.of_actuator(a))
        return replace(issued, predictor=context.state)

    def record_request(self, observation: Observation, plan: Plan) -> Plan:
        """The plan, its state with the levels asked for."""
        assert isinstance(plan.state, MPCState)
        if not self.enabled:
            return plan
        states, news = list(plan.state.watch), []
        for a, watch in enumerate(self._watches):
            # What a command asks for is a loop's; its level is expected, not asked.
            levels = [
                float("nan") if (u := block.u[a]) is None or block.command[a] is not None else u * block.duration_s
                for block in plan.blocks
            ]
            states[a] = watch.record_request(states[a], observation.time_s, sum(levels) / watch.step_s)
            if states[a].news:
                news.append(self._model.names.of_actuator(a, f"watch: {states[a].news}"))
        return replace(plan.with_news(*news), state=replace(plan.state, watch=tuple(states)))

    def level_to_try(self, now: MPCState, a: int, time_s: float, *, heats: bool) -> float:
        """See `Watch.level_to_try`."""
        return self._watches[a].level_to_try(now.watch[a], time_s, heats=heats) if self.enabled else 0.0

    def doubtful(self, now: MPCState, a: int) -> bool:
        """See `Watch.doubtful`."""
        return self._watches[a].doubtful(now.watch[a])


def later_state(kept: PredictorState | None, used: PredictorState | None) -> PredictorState | None:
    """The state of a predictor that returns to use, or the one `kept` meanwhile where others went on planning."""
    if not (kept and kept.forced and used and used.forced) or used.forced.time_s[-1] >= kept.forced.time_s[-1]:
        return used
    return replace(kept, forced=None)  # it was computed with the operator of another model


def _with(values: tuple[Item, ...], at: int, value: Item) -> tuple[Item, ...]:
    return (*values[:at], value, *values[at + 1 :])


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


class PlanPredictor:
    """Predicts for the steps of a plan, within `seconds` of wall time; it holds no state.

    What is forecast now will validate the zone sensors, and is compared with what comes by `watched`.
    """

    def __init__(
        self, planners: Planners, sensors: ZoneSensors, watched: WatchedPredictions, n_steps: int, seconds: float
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
        except Exception as error:  # a forecaster may be anybody's and raise anything; there is another way to act
            return Failure(f"no prediction ({message_of(error)})", state)
        return Forecast(context, planner, replace(state, predictor=context.state))

    def record(self, forecast: Forecast, readings: Readings) -> Forecast:
        """The forecast with a state that remembers what was predicted, for the sensors and the watch."""
        context, state = forecast.context, forecast.state
        sensors = self._sensors.anchored(state.sensors, readings.history, context)
        state = self._watched.record_prediction(replace(state, sensors=sensors), context, forecast.planner)
        return replace(forecast, state=state)
