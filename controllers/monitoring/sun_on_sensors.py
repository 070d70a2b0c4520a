"""Sun on zone sensors, looked for again at night while the building is controlled, when more sun has shone.

Identification finds it where the sun shone in its record. After dull days it does not, and plans would then heat too
little in the sun.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from controllers.checks import message_of
from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution.cooperative import Computation, Request, perform
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import prepared_runs
from thermoforce_mpc.identification.network.sensor import sun_on_sensor
from thermoforce_mpc.model.screening import ReadingLimits
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor
from thermoforce_mpc.model.thermal_model import ThermalModel

# Days that are looked at. By judgement: after five, none of 56 ideal sensors was claimed and 12 of 13 in the sun were
# found (2026-11-25).
_LATEST_S = 10 * DAY_S
# A look takes a second or more. So it is made where these days have this many times the sun of those of the last look;
# in the dark, when what it finds changes no reading; and where one failed, not before so long after it.
_MORE_SUN, _DARK_W_M2, _AGAIN_S = 1.4, 1.0, 0.5 * DAY_S
# Probabilities from which a look finds sun, more than identification asks of its one record, since looks are several,
# and below which sun that was found before is dropped. On ideal sensors of the heat pump's day 44 two looks had found
# sun at 0.97 and 0.98 (2026-11-24).
_FOUND, _UNLIKELY = 0.99, 0.1
# Share of the standard deviation of what is taken off that a new find must undercut. By judgement, with the numbers
# above.
_CLEARLY_SURER = 0.7


@dataclass(frozen=True)
class SunState:
    """What looks have found.

    `looked_s`: time of the last one, s (None: none yet); `found` (Z,): sun on the sensor of each zone; `failed`: the
    error that the last look ended in; `sun_Wh_m2`: irradiation of the days looked at.
    """

    looked_s: float | None = None
    found: tuple[SunOnSensor | None, ...] = ()
    failed: str = ""
    sun_Wh_m2: float = 0.0


class SunOnSensors:
    """Looks for sun on the sensors of the zones of `model`, at the control step; it holds no state.

    `validated` (Z,): whether the readings of each zone's sensor are validated.
    """

    def __init__(self, model: ThermalModel, validated: Sequence[bool]) -> None:
        self._model, self._config = model, IdentificationConfig()
        homes = [model.layout.actuators_of(zone) for zone in range(len(model.names.zones))]
        # One that was not to be looked for in identification is not in control either.
        asked = [not home or model.cards[home[0]].config.get("sun_on_sensor", True) for home in homes]
        self._looked_for = tuple(a and b for a, b in zip(asked, validated, strict=True))

    def updating(self, state: SunState, history: Record, seconds: float) -> Computation[SunState]:
        """The state after a look, where it is dark and more sun has shone than at the last one.

        The first is in the first night, when the latest days may be others than those of the model. A look that is not
        over within `seconds` of wall time is left behind, so that no step waits for it.
        """
        if history.n_steps < 1:
            return state
        now_s, latest = float(history.time_s[-1]), history.last(round(_LATEST_S / history.step_s))
        sun_Wh_m2 = float(np.nansum(latest.solar_W_m2)) * history.step_s / HOUR_S
        if state.looked_s is None:
            return SunState(now_s, (None,) * len(self._looked_for))
        dark = history.solar_W_m2[-1] <= _DARK_W_M2
        if not dark or sun_Wh_m2 < _MORE_SUN * state.sun_Wh_m2 or not any(self._looked_for):
            return state
        if state.failed and now_s - state.looked_s < _AGAIN_S:
            return state
        try:
            found = yield from perform(Request(self, partial(self._look, state, latest), seconds=seconds))
        except Exception as error:  # what is learned for later must not cost the plan of now
            failed = f"sun on the sensors could not be looked for ({message_of(error)})"
            return replace(state, looked_s=now_s, failed=failed)
        return SunState(now_s, found, sun_Wh_m2=sun_Wh_m2)

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

    def _look(self, state: SunState, latest: Record) -> tuple[SunOnSensor | None, ...]:
        """What looks have found after one more at the latest days, by zone."""
        runs = self._prepared(latest)
        return tuple(self._update_zone(z, before, runs) for z, before in enumerate(state.found))

    def _update_zone(self, z: int, before: SunOnSensor | None, runs: Sequence[Record]) -> SunOnSensor | None:
        """What looks have found for zone `z` after one more: another find replaces one that is clearly less certain."""
        latest = self._estimate(z, runs)
        if latest is None:
            return before
        if latest.probability < _FOUND:
            return None if latest.probability < _UNLIKELY else before
        current = before or self._model.sun_on_sensors[z]
        return latest if current is None or latest.sd_K < _CLEARLY_SURER * current.sd_K else before

    def _estimate(self, z: int, runs: Sequence[Record]) -> SunOnSensor | None:
        """The likeliest sun on the sensor of zone `z` in the latest days; None where they do not show it."""
        if not runs or not self._looked_for[z]:
            return None
        layout = self._model.layout
        heat_inputs = [self._model.operator.of_actuator(a).heat_input for a in range(len(layout.home))]
        return sun_on_sensor(runs, z, layout, heat_inputs, self._config)

    def _prepared(self, latest: Record) -> list[Record]:
        """The latest days; nothing where too little was measured, or nothing acted."""
        try:
            return list(prepared_runs([latest], ReadingLimits.of(None, None, min(self._model.layout.u_min)))[0])
        except DataError:
            return []
