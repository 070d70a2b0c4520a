"""Sun on zone sensors, looked for again each night while the building is controlled.

Identification finds it where the sun shone in its record. After dull days it does not, and plans would then heat too
little from the first sunny day on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from controllers.checks import message_of
from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.couplings import other_actuators, others_of
from thermoforce_mpc.identification.effects.sun_on_sensor import sun_on_sensor
from thermoforce_mpc.identification.estimation.records import prepared_runs, resolution_K
from thermoforce_mpc.model.screening import Limits
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor
from thermoforce_mpc.model.thermal_model import ThermalModel

# Days that are looked at: dull and sunny ones, in two parts of which a regression takes every row at 15 min.
_LATEST_S = 14 * DAY_S
# A look is for the dark, when what it finds changes no reading; from one night to the next it is less than a day in
# autumn.
_EVERY_S, _DARK_W_M2 = 20 * HOUR_S, 1.0
# Probabilities from which a look finds sun, more than identification asks of its one record, since looks are many, and
# below which sun that was found before is dropped.
_FOUND, _UNLIKELY = 0.99, 0.1
# Share of the standard deviation of what is taken off that a new find must undercut.
_CLEARLY_SURER = 0.7


@dataclass(frozen=True)
class SunState:
    """What looks have found.

    `looked_s`: time of the last one, s (None: none yet); `found` (Z,): sun on the sensor of each zone; `failed`: the
    error that the last look ended in.
    """

    looked_s: float | None = None
    found: tuple[SunOnSensor | None, ...] = ()
    failed: str = ""


class SunOnSensors:
    """Looks for sun on the sensors of the zones of `model`; it holds no state.

    Args:
        model: the building, at the control step.
        validated: of each zone (Z,) whether the readings of its sensor are validated.
    """

    def __init__(self, model: ThermalModel, validated: Sequence[bool]) -> None:
        self._model, self._config = model, IdentificationConfig()
        self._validated = tuple(validated)

    def update(self, state: SunState, history: Record) -> SunState:
        """The state after a look, where it is dark and the last one was in the night before."""
        now_s = float(history.time_s[-1])
        if state.looked_s is None:
            return SunState(now_s, (None,) * len(self._validated))
        if now_s - state.looked_s < _EVERY_S or not history.solar_W_m2[-1] <= _DARK_W_M2:
            return state
        try:
            return SunState(now_s, tuple(self._update_zone(z, before, history) for z, before in enumerate(state.found)))
        except Exception as error:  # what is learned for later must not cost the plan of now
            return SunState(now_s, state.found, f"sun on the sensors could not be looked for ({message_of(error)})")

    def of_zones(self, state: SunState) -> tuple[SunOnSensor | None, ...]:
        """Sun on the sensor of each zone (Z,), by the model or by a look."""
        identified = self._model.sun_on_sensors
        return tuple(latest or before for latest, before in zip(state.found or identified, identified, strict=True))

    def news(self, before: SunState, after: SunState) -> str:
        """What a look changed in what is taken off readings, in words; empty where nothing."""
        zones = self._model.names.zones
        changes = [after.failed] if after.failed and after != before else []
        for zone, sun_before, sun_after in zip(zones, self.of_zones(before), self.of_zones(after), strict=True):
            if sun_before != sun_after:
                text = (
                    "the latest days show no sun on the zone sensor any more"
                    if sun_after is None
                    else sun_after.in_words()
                )
                changes.append(text if len(zones) == 1 else f"{zone}: {text}")
        return "; ".join(changes)

    def _update_zone(self, z: int, before: SunOnSensor | None, history: Record) -> SunOnSensor | None:
        """What looks have found for zone `z` after one more: another find replaces one that is clearly less certain."""
        latest = self._estimate(z, history)
        if latest is None:
            return before
        if latest.probability < _FOUND:
            return None if latest.probability < _UNLIKELY else before
        current = before or self._model.sun_on_sensors[z]
        return latest if current is None or latest.sd_K < _CLEARLY_SURER * current.sd_K else before

    def _estimate(self, z: int, history: Record) -> SunOnSensor | None:
        """The likeliest sun on the sensor of zone `z` in the latest days; None where they do not show it."""
        layout = self._model.layout
        actuators = layout.actuators_of(z)
        if not self._validated[z] or not actuators:
            return None
        own = actuators[0]
        order = [own, *others_of(layout, own, self._config)]
        latest = history.last(round(_LATEST_S / history.step_s))
        try:
            runs, _ = prepared_runs(
                [latest.part(z, order, [layout.machine_of[own]])], Limits.of(None, None, min(layout.lowest))
            )
        except DataError:  # too little was measured, or nothing acted
            return None
        heat_inputs = [self._model.operator.of_actuator(a).heat_input for a in range(len(layout.home))]
        others = other_actuators(layout, heat_inputs, own, self._config)
        return sun_on_sensor(runs, heat_inputs[own], self._config, resolution_K(runs), others)
