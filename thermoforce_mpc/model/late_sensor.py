"""A zone sensor that reads the room late: what it has yet to read of what actuators did.

With a time constant τ the reading T_r follows the room's temperature, τ dT_r/dt = T − T_r, and so each part of it by
itself: free response and forced one. The free one is slow, so that it is read at the end of a step almost as it is; of
the forced one F, a quarter of an hour of warm air is missed by half a kelvin. The record of a room has the readings and
F less what the sensor reads of F, so that plans, rules and checks mean the room's temperature.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import DAY_S, NORMAL_95, Array, Record
from thermoforce_mpc.data.series import bridged, first_order
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.forced_state import heat_drive
from thermoforce_mpc.model.operator.building import BuildingOperator

LIKELY = 0.999
"""Probability of a late sensor from which records are corrected. Of 16 drawn houses with late sensors (seed 64001) nine
have log odds of 10 to 114, none between 4 and 10; of 39 with ideal sensors none is above .95, of four rooms of
`house:4rooms:8813`, which are ideal too, one at .96, of 28 days of own control one at .997 (620001:6, 2026-11-30)."""
# Time by which a late sensor is judged again in a run, s, and log odds from which it reads in time. By judgement: a day
# of one that is late in a house with air heating has −20 to −60 while it is heated, of an ideal one in its place 17 to
# 50, and mild days of either −4 to 8; two days flipped ten times in a mild one (`bench detectors`, houses 1 and 5 of
# 140930, 2026-11-30).
_JUDGED_S, _SURE = 5.0 * DAY_S, 10.0
# Least pole of a mode: one that is over within a step has a logarithm all the same.
_FASTEST = 1e-12


@dataclass(frozen=True)
class LateSensor:
    """Time constant of a zone sensor `lag_s`, s, its standard deviation `sd_s`, and the `probability` that it is late
    at all.
    """

    lag_s: float
    sd_s: float
    probability: float

    def __post_init__(self) -> None:
        """Raise `DataError` for times that are none."""
        if not (0.0 < self.lag_s < DAY_S and self.sd_s >= 0.0 and 0.0 <= self.probability <= 1.0):
            raise DataError(
                f"late sensor: lag_s {self.lag_s:g}, sd_s {self.sd_s:g}, probability {self.probability:g}: expected a "
                "lag above 0 and below a day, a standard deviation of at least 0 and a probability"
            )

    @property
    def band_s(self) -> tuple[float, float]:
        """Between what times its time constant lies in 90 %, s: what is known of it is a factor (log-normal)."""
        factor = math.exp(NORMAL_95 * self.sd_s / self.lag_s)
        return self.lag_s / factor, self.lag_s * factor

    def in_words(self) -> str:
        """One line."""
        low, high = (f"{time_s / 60.0:.0f}" for time_s in self.band_s)
        return (
            f"the zone sensor reads the room {self.lag_s / 60.0:.0f} min late ({low} to {high} in 90 %; probability "
            f"{self.probability:.3g}): what it has yet to read of the heat is added to its readings"
        )


@dataclass(frozen=True, eq=False)
class LateReadings:
    """A `record` as read, and of each zone whose sensor is late, by its number in `responses`, the forced response of
    the room and what the sensor reads of it (n + 1,), K.
    """

    record: Record
    responses: Mapping[int, tuple[Array, Array]]

    @classmethod
    def of(cls, record: Record, operator: BuildingOperator, late: Sequence[LateSensor | None]) -> LateReadings:
        """What the sensors `late` (Z,) read of a record, by the operator with m = 1 from the steady state of the first
        day: of what came hours before a late sensor misses nothing.

        Gaps of weather and levels are bridged; raises `DataError` as `forced_state.heat_drive`.
        """
        if not any(late) or not record.n_steps:
            return cls(record, {})
        filled, _ = bridged(record)
        operator = operator.resampled(record.step_s)
        heat = heat_drive(operator, filled, 0, record.n_steps)
        day = max(1, min(record.n_steps, round(DAY_S / record.step_s)))
        start = operator.steady_gains_K * heat[:, :day].mean(axis=1)[:, None]
        forced_K = np.concatenate([start[:, :, None], operator.driven(start, heat)], axis=2)
        responses = {}
        for z, sensor in enumerate(late):
            if sensor is not None:
                each = zip(forced_K[z], operator.poles[z], strict=True)
                read = [read_late(of_one, poles, record.step_s, sensor.lag_s) for of_one, poles in each]
                responses[z] = (forced_K[z].sum(axis=(0, -1)), np.asarray(np.sum(read, axis=0)))
        return cls(record, responses)

    def in_time(self) -> Record:
        """The record with the rooms' temperatures, as far as actuators move them, where sensors are still late."""
        if not self.responses:
            return self.record
        T = np.array(self.record.T_zone_C)
        for z, (forced_K, read_K) in self.responses.items():
            if self._still_late(z, self.record.n_steps):
                T[z] += forced_K - read_K
        return replace(self.record, T_zone_C=T)

    def news(self, *, first: bool) -> str:
        """What the last step told of late sensors, in words; `first`: all of the record is new."""
        told, n, zones = [], self.record.n_steps, self.record.names.zones
        for z in self.responses if n > 1 else ():
            was, late = first or self._still_late(z, n - 1), self._still_late(z, n)
            if was != late:
                words = "late again" if late else "in time: nothing is added to its readings"
                told.append(f"the zone sensor reads the room {words}" if len(zones) == 1 else f"{zones[z]}: {words}")
        return "; ".join(told)

    def _still_late(self, z: int, n_steps: int) -> bool:
        """Whether the sensor of zone `z` may be late by the latest days of the first `n_steps`.

        What is left of readings without what they hold of forced responses is slow, and so smoother where they are read
        as they should be. Late unless they surely hold all of the response.
        """
        judged = slice(max(n_steps - round(_JUDGED_S / self.record.step_s), 0), n_steps + 1)
        T_C = self.record.T_zone_C[z, judged]
        prompt, late = (np.diff(T_C - of_K[judged], 2) for of_K in self.responses[z])
        known = np.isfinite(prompt)
        left = [float(np.sum(rest[known] ** 2)) for rest in (late, prompt)]
        if not min(left) > 0.0:
            return True
        return 0.5 * float(known.sum()) * math.log(left[0] / left[1]) <= _SURE


def read_late(forced_K: Array, poles: Array, step_s: float, lag_s: float) -> Array:
    """What a sensor with the time constant `lag_s` reads (n + 1,), K, of the sum of modes (n + 1, r) with `poles` (r,),
    driven by what is constant in each step; exact, from a sensor that stood still before.
    """
    kept = float(np.exp(-step_s / lag_s))
    apart = np.log(np.maximum(poles, _FASTEST)) + step_s / lag_s
    quotient = np.divide(np.expm1(apart), apart, out=np.ones_like(apart), where=apart != 0.0)
    # Of a mode that fades with its pole from 1, and of one that rises to 1.
    fading = kept * step_s / lag_s * quotient
    rising = (1.0 - kept - fading) / (1.0 - poles)
    before, after = forced_K[:-1], forced_K[1:]
    drive = (fading * before + rising * (after - poles * before)).sum(axis=1)
    first = forced_K[0].sum(keepdims=True)
    return np.concatenate([first, first_order(np.array([kept]), drive[:, None], first)[:, 0]])
