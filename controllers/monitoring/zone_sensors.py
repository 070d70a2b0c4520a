"""The zone sensors inside an MPC: which readings are planned from, and which zones are not known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.monitoring.zone_sensor import Sensor
from controllers.monitoring.zone_sensor_state import Sensed, SensorState
from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.model.predictor import PredictionContext


@dataclass(frozen=True)
class Zones:
    """The zones now (Z,): what is known of each, with `T_C` °C to act on (NaN: unknown)."""

    each: tuple[Sensed, ...]

    @property
    def T_C(self) -> Array:
        """Temperatures (Z,), °C: readings, or what stands in for them."""
        return np.array([zone.T_C for zone in self.each])

    @property
    def bridged(self) -> str:
        """Which zones the model stands in for, in words; empty where none."""
        return "; ".join(f"{zone.why}; the model stands in" for zone in self.each if zone.why and not zone.lost)

    @property
    def news(self) -> str:
        """Which readings are accepted again, in words."""
        return "; ".join(zone.news for zone in self.each if zone.news)


class ZoneSensors:
    """Validates the readings of all zones; it holds no state.

    Args:
        sensors: of each zone (Z,).
    """

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        self._sensors = tuple(sensors)

    def mask_rejected(self, states: Sequence[SensorState], history: Record) -> Record:
        """The record with rejected readings taken as not measured."""
        if not any(state.refused_s for state in states):
            return history
        rows = [sensor.mask_rejected(state, history, z) for z, (sensor, state) in enumerate(self._each(states))]
        return replace(history, T_zone_C=np.stack(rows))

    def validate(
        self, states: Sequence[SensorState], history: Record, forced_K: Array | None
    ) -> tuple[tuple[SensorState, ...], Record, Zones]:
        """Validate the readings since the last call.

        Args:
            states: after the last call (Z,).
            history: as measured.
            forced_K: forced states until now (Z, A, n + 1, r), K; None where unknown.

        Returns:
            The states, the record with rejected readings taken as not measured, and the zones now.
        """
        after, zones = [], []
        for z, (sensor, state) in enumerate(self._each(states)):
            row = None if forced_K is None else forced_K[z].sum(axis=(0, 2))
            state, zone = sensor.validate(state, history, z, row)
            after.append(state)
            zones.append(zone)
        return tuple(after), self.mask_rejected(after, history), Zones(tuple(zones))

    def anchored(
        self, states: Sequence[SensorState], history: Record, context: PredictionContext
    ) -> tuple[SensorState, ...]:
        """The states with the free forecast of a plan, for zones whose reading is accepted and new."""
        return tuple(
            state if z in context.unmeasured else sensor.anchored(state, history, z, context)
            for z, (sensor, state) in enumerate(self._each(states))
        )

    def _each(self, states: Sequence[SensorState]) -> list[tuple[Sensor, SensorState]]:
        return list(zip(self._sensors, states, strict=True))
