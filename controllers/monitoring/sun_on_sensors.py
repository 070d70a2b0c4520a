"""Sun on zone sensors, looked for again at night while the building is controlled, when more sun has shone.

Identification finds it where the sun shone in its record. After dull days it does not, and plans would then heat too
little in the sun.

A look takes a second or more, so it runs beside the steps (`execution.beside`). Its answer is taken at the next step:
where that comes at once, as in a simulation, it waits for it, so that what is found does not depend on how fast the
machine is; where it comes minutes later, the answer is there. No step waits longer than `DeadlineConfig.look_s`; an
answer that is later than that counts from the step on at which it is there.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from controllers.checks import message_of
from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution.beside import beside
from thermoforce_mpc.execution.cooperative import Computation, Request, perform
from thermoforce_mpc.execution.keys import canonical, digest
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import prepared_runs
from thermoforce_mpc.identification.network.sensor import sun_on_sensor
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.screening import ReadingLimits
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor
from thermoforce_mpc.model.thermal_model import ThermalModel

_LOG = logging.getLogger(__name__)

# Days that are looked at. By judgement: after five, none of 56 ideal sensors was claimed and 12 of 13 in the sun were
# found (2026-11-25).
_LATEST_S = 10 * DAY_S
# A look takes a second or more. So it is made where these days have this many times the sun of those of the last look;
# in the dark, when what it finds changes no reading; and where one failed, not before so long after it.
_MORE_SUN, _DARK_W_M2, _AGAIN_S = 1.4, 1.0, 0.5 * DAY_S
_LOOKED_AT = ("time_s", "T_zone_C", "T_out_C", "solar_W_m2", "u", "power_W", "heat_W")
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
    error that the last look ended in; `sun_Wh_m2`: irradiation of the days looked at. Of a look that runs: `asked`, its
    key ('': none does), `asked_s` and `asked_Wh_m2`, the same of it, and whether it is `late`.
    """

    looked_s: float | None = None
    found: tuple[SunOnSensor | None, ...] = ()
    failed: str = ""
    sun_Wh_m2: float = 0.0
    asked: str = ""
    asked_s: float = 0.0
    asked_Wh_m2: float = 0.0
    late: bool = False


class SunOnSensors:
    """Looks for sun on the sensors of the zones of `model`, at the control step; it holds no state.

    `validated` (Z,): whether the readings of each zone's sensor are validated.
    """

    def __init__(self, model: ThermalModel, validated: Sequence[bool]) -> None:
        self._model, self._config = model, IdentificationConfig()
        # One that was not to be looked for in identification is not in control either.
        served = model.layout.actuators_of_zones
        asked = [not home or model.cards[home[0]].config.get("sun_on_sensor", True) for home in served]
        self._looked_for = tuple(a and b for a, b in zip(asked, validated, strict=True))

    def updating(self, state: SunState, history: Record, seconds: float) -> Computation[SunState]:
        """The state with the answer of the look that ran, waited for at most so long, s, or with one that begins.

        A look begins where it is dark and more sun has shone than at the last one. The first is in the first night,
        when the latest days may be others than those of the model. One that was lost with its process begins anew.
        """
        if history.n_steps < 1:
            return state
        now_s, latest = float(history.time_s[-1]), history.last(round(_LATEST_S / history.step_s))
        sun_Wh_m2 = float(np.nansum(latest.solar_W_m2)) * history.step_s / HOUR_S
        if state.looked_s is None:
            return SunState(now_s, (None,) * len(self._looked_for))
        if state.asked and beside().began(state.asked):
            return (yield from self._answered(state, now_s, seconds))
        dark = history.solar_W_m2[-1] <= _DARK_W_M2
        if not state.asked:
            if not dark or sun_Wh_m2 < _MORE_SUN * state.sun_Wh_m2 or not any(self._looked_for):
                return state
            if state.failed and now_s - state.looked_s < _AGAIN_S:
                return state
        key = self._key(state, latest)
        beside().begin(key, partial(self._look, state, latest))
        _LOG.info("a look for sun on zone sensors runs beside the steps")
        return replace(state, asked=key, asked_s=now_s, asked_Wh_m2=sun_Wh_m2, late=False)

    def _answered(self, state: SunState, now_s: float, seconds: float) -> Computation[SunState]:
        """The state with what the look that ran found, if it is over within so long, s."""
        if not (yield from perform(Request(self, partial(beside().answered, state.asked, seconds)))):
            return replace(state, late=True)
        try:
            found = beside().answer(state.asked)
        except Exception as error:  # what is learned for later must not cost the plan of now
            failed = f"sun on the sensors could not be looked for ({message_of(error)})"
            return SunState(now_s, state.found, failed, state.sun_Wh_m2)
        return SunState(state.asked_s, found, sun_Wh_m2=state.asked_Wh_m2)

    def of_zones(self, state: SunState) -> tuple[SunOnSensor | None, ...]:
        """Sun on the sensor of each zone (Z,), by the model or by a look."""
        identified = self._model.sun_on_sensors
        return tuple(latest or before for latest, before in zip(state.found or identified, identified, strict=True))

    def news(self, before: SunState, after: SunState) -> str:
        """What a look changed in what is taken off readings, in words; empty where nothing.

        One that is late or was lost is told too; that one begins goes to the log.
        """
        zones = self._model.names.zones
        changes = [after.failed] if after.failed and after.failed != before.failed else []
        if after.asked and before.asked and after.asked != before.asked:
            changes.append("a look for sun on zone sensors is made again, since its answer was lost")
        if after.late and not before.late:
            changes.append("the look for sun on zone sensors is not over: its answer counts when it is there")
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

    def _key(self, state: SunState, latest: Record) -> str:
        """All that the answer of a look depends on."""
        record = [getattr(latest, name) for name in _LOOKED_AT]
        model = [self._model.sun_on_sensors, self._model.layout, self._heat_inputs(), self._looked_for]
        return digest({"found": canonical(state.found), "record": canonical(record), "model": canonical(model)})

    def _heat_inputs(self) -> list[HeatInput]:
        return [own.heat_input for own in self._model.operator.of_actuators]

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
        return sun_on_sensor(runs, z, self._model.layout, self._heat_inputs(), self._config)

    def _prepared(self, latest: Record) -> list[Record]:
        """The latest days; nothing where too little was measured, or nothing acted."""
        try:
            return list(prepared_runs([latest], ReadingLimits.of(None, None, min(self._model.layout.u_min)))[0])
        except DataError:
            return []
