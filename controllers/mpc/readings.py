"""What is believed of the building at the begin of a step: zones, meters, sun, gaps, forecast and forced state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from controllers.monitoring.meters import Meters
from controllers.monitoring.sun_on_sensors import SunOnSensors
from controllers.monitoring.zone_sensors import Sensor, Zones, ZoneSensors
from controllers.mpc.config import MPCConfig
from controllers.mpc.state import MPCState
from thermoforce_mpc.data import Array, Boundary, Observation, Record
from thermoforce_mpc.data.series import gapless
from thermoforce_mpc.execution.cooperative import Computation
from thermoforce_mpc.model.forced_state import ForcedState
from thermoforce_mpc.model.forecast_gaps import completed, whole
from thermoforce_mpc.model.predictor import Predictor
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

    `sensors`, `meters`: the checks of zone sensors, and of weather sensors and meters.
    """

    def __init__(self, config: MPCConfig, model: ThermalModel, predictor: Predictor) -> None:
        zones = model.names.zones
        self.sensors = ZoneSensors([Sensor(config.sensor_of(zone), "" if len(zones) == 1 else zone) for zone in zones])
        self.meters = Meters(model.layout, config.meter, config.meters)
        self._sun = SunOnSensors(model, [config.sensor_of(zone).enabled for zone in zones])
        self._model, self._predictor, self._cold_after = model, predictor, config.fallback.cold_after
        self._look_s = config.deadline.look_s

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
        before = self.sensors.mask_rejected(state.sensors, history)
        forced = self._forced(before, state) if with_model else None
        forced_K = None if forced is None else forced.forced_K
        sensors, validated, zones = self.sensors.validate(state.sensors, history, forced_K)
        if forced and as_identified and validated is before and gapless(validated) and state.predictor:
            state = replace(state, predictor=replace(state.predictor, forced=forced))  # not estimated again
        state = replace(
            state, sensors=sensors, meters=meters, boundary=boundary if whole(observation.boundary) else state.boundary
        )
        seen = Observation(validated, boundary)
        doubts = tuple(filter(None, (zones.bridged, metered.why, filled)))
        news = tuple(filter(None, (sun_news, zones.news, metered.news)))
        return Readings(seen, observation.boundary, zones, forced_K, doubts, news), state

    def _without_sun(self, history: Record, state: MPCState) -> Computation[tuple[Record, MPCState, str]]:
        """The record without the sun on sensors, which is looked for each night, the state, and what was found."""
        believed = self.sensors.mask_rejected(state.sensors, self.meters.mask_rejected(state.meters, history))
        sun = yield from self._sun.updating(state.sun, believed, self._look_s)
        news = self._sun.news(state.sun, sun)
        if news:  # the forced state may follow the temperature
            state = state.without_forced()
        return off_sensors(history, self._sun.of_zones(sun)), replace(state, sun=sun), news

    def _forced(self, history: Record, state: MPCState) -> ForcedState | None:
        """Forced states of the building until now; None at the start, or if they cannot be estimated."""
        if state.predictor is None:
            return None
        try:
            return self._predictor.followed(history, state.predictor)
        except Exception:  # prediction meets the same error and says it; without the state nothing is validated by it
            return None


def joined(texts: Sequence[str]) -> str:
    """Parts of a sentence, without those that are empty."""
    return "; ".join(filter(None, texts))
