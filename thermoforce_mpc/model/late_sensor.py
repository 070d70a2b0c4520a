"""A zone sensor that reads the room late: what it has yet to read of what actuators did.

With a time constant τ the reading T_r follows the room's temperature, τ dT_r/dt = T − T_r, and so each part of it by
itself: free response and forced one. The free one is slow, so that it is read at the end of a step almost as it is; of
the forced one F, a quarter of an hour of warm air is missed by half a kelvin. The record of a room has the readings and
F less what the sensor reads of F, so that plans, rules and checks mean the room's temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Record
from thermoforce_mpc.data.series import bridged, first_order
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.forced_state import heat_drive
from thermoforce_mpc.model.operator.building import BuildingOperator

LIKELY = 0.99
"""Probability of a late sensor from which records are corrected. Of 16 drawn houses with late sensors (seed 64001) nine
have log odds of 10 to 114, none between 4 and 10; of 39 with ideal sensors none is above .95, of four rooms of
`house:4rooms:8813`, which are ideal too, one at .96 (2026-11-30)."""
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

    def in_words(self) -> str:
        """One line."""
        return (
            f"the zone sensor reads the room {self.lag_s / 60.0:.1f} ± {self.sd_s / 60.0:.1f} min late "
            f"(probability {self.probability:.2g}): what it has yet to read of the heat is added to its readings"
        )


def in_time(record: Record, operator: BuildingOperator, late: Sequence[LateSensor | None]) -> Record:
    """`record` with the temperatures of the rooms whose sensors are `late` (Z,), as far as actuators move them.

    By the operator with m = 1 from the steady state of the first day: of what came hours before a late sensor misses
    nothing. Gaps of weather and levels are bridged; raises `DataError` as `forced_state.heat_drive`.
    """
    if not any(late) or not record.n_steps:
        return record
    filled, _ = bridged(record)
    operator = operator.resampled(record.step_s)
    heat = heat_drive(operator, filled, 0, record.n_steps)
    day = max(1, min(record.n_steps, round(DAY_S / record.step_s)))
    start = operator.steady_gains_K * heat[:, :day].mean(axis=1)[:, None]
    forced_K = np.concatenate([start[:, :, None], operator.driven(start, heat)], axis=2)
    T = np.array(record.T_zone_C)
    for z, sensor in enumerate(late):
        if sensor is not None:
            for of_one, poles in zip(forced_K[z], operator.poles[z], strict=True):
                T[z] += of_one.sum(axis=-1) - read_late(of_one, poles, record.step_s, sensor.lag_s)
    return replace(record, T_zone_C=T)


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
