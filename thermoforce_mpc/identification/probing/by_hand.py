"""A probing schedule to run by hand: the fewest days of levels after which a record can tell the effect of acting.

Only the actuators whose effect the record cannot tell are probed: those of which a model is not competent or, where
none was fitted, is not expected to be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Layout, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.probing.hand_planner import HOLDS_H, HandPlanner
from thermoforce_mpc.identification.probing.operation import Telling, tellings
from thermoforce_mpc.model.gaps import bridged

# Longest schedule, days.
_MOST_DAYS = 7
# Half width of a comfort band that nobody named, around the usual temperature, K.
_BAND_K = 1.5


@dataclass(frozen=True)
class ProbeSchedule:
    """Levels to hold by hand.

    `time_s` (n + 1,) s: boundaries of the hours. `u` (A, n): levels, NaN where the building's own control acts.
    `probed`: actuators that are. `lower_C`, `upper_C` (Z,): comfort band assumed. `before`, `after`: what the record
    is expected to tell without and with it. `discomfort_Kh` (Z,): expected K·h outside the band, `excursion_K` (Z,):
    expected largest distance from the usual temperature. `enough`: whether the aim is reached within a week.
    """

    record: Record
    time_s: Array
    u: Array
    probed: tuple[str, ...]
    lower_C: Array
    upper_C: Array
    before: tuple[Telling, ...]
    after: tuple[Telling, ...]
    discomfort_Kh: Array
    excursion_K: Array

    @property
    def hours(self) -> int:
        """Length, h; 0 where nothing needs to be probed."""
        return int(self.u.shape[1])

    @property
    def by_hand_h(self) -> int:
        """Hours in which some level is set by hand."""
        return int(np.isfinite(self.u).any(axis=0).sum())

    @property
    def enough(self) -> bool:
        """Whether the effects of the probed actuators are expected to be known well enough afterwards."""
        return all(telling.tells for telling in self.after if telling.actuator in self.probed)


def probe_schedule(
    record: Record,
    layout: Layout,
    *,
    lower_C: Array | None = None,
    upper_C: Array | None = None,
    levels: Sequence[float] = (0.0, 1.0),
    awake: tuple[int, int] = (7, 22),
    start_s: float | None = None,
    competent: Sequence[bool] | None = None,
    seed: int = 1,
) -> ProbeSchedule:
    """The shortest schedule of whole days after which the record is expected to tell the effect of every actuator.

    Args:
        record: the last month or so of operation.
        layout: what acts where.
        lower_C, upper_C: comfort band of each zone (Z,), °C; NaN or None: 1.5 K around the zone's median.
        levels: levels to draw from, off first.
        awake: hours of the day between which levels change and are held, local standard time.
        start_s: where it starts; default: the first morning after the end of the record.
        competent: of each actuator, whether a model of the record is (`operating.findings`); those of which it is are
            not probed, others for a day at least. Default: what the record is expected to tell decides.
        seed: seed of the draws.

    Raises:
        DataError: levels or hours make no sense, a level is signed (mode both), or weather or a temperature was never
            measured.
    """
    _check(layout, levels, awake)
    filled, _ = bridged(record)
    silent = ~np.isfinite(record.T_zone_C).any(axis=1)
    if silent.any():
        raise DataError(f"{record.names.zones[int(np.argmax(silent))]}: its temperature was not measured of late")
    usual = np.nanmedian(record.T_zone_C, axis=1)
    lower, upper = _band(lower_C, usual - _BAND_K), _band(upper_C, usual + _BAND_K)
    before = tellings(record, layout)
    sufficient = [telling.tells for telling in before] if competent is None else list(competent)
    probed = [a for a, enough in enumerate(sufficient) if not enough]
    morning = np.ceil((float(record.time_s[-1]) - awake[0] * HOUR_S) / DAY_S) * DAY_S + awake[0] * HOUR_S
    begin = morning if start_s is None else start_s
    planner = HandPlanner(_hourly(filled), layout, begin, tuple(levels), awake, usual, lower, upper, seed)
    after = before
    while probed and planner.days < _MOST_DAYS and not (planner.days and all(after[a].tells for a in probed)):
        planner.add_day(probed)
        after = tellings(planner.record(), layout)
    names = tuple(layout.names.actuators[a] for a in probed)
    time_s = np.asarray(begin + np.arange(planner.u.shape[1] + 1) * HOUR_S)
    return ProbeSchedule(
        record, time_s, planner.u, names, lower, upper, tuple(before), tuple(after),
        planner.discomfort_Kh(), planner.excursion_K(),
    )  # fmt: skip


def _hourly(record: Record) -> Record:
    """The record in hours: the design looks at hourly rows anyway, and people act on the hour."""
    every = max(1, round(HOUR_S / record.step_s))
    if abs(every * record.step_s - HOUR_S) > 1.0:
        raise DataError(
            f"the record has steps of {record.step_s:g} s: a schedule needs a step that divides an hour, such as "
            "step: 15min"
        )
    return record.resample(every)


def _band(band: Array | None, default: Array) -> Array:
    if band is None:
        return default
    return np.where(np.isfinite(band), band, default)


def _check(layout: Layout, levels: Sequence[float], awake: tuple[int, int]) -> None:
    if levels[0] != 0.0 or len(set(levels)) < 2 or not all(0.0 <= level <= 1.0 for level in levels):
        raise DataError(f"levels to probe are {list(levels)}: start with 0, and give another one in (0, 1]")
    if not 0 <= awake[0] < awake[1] <= 24 or awake[1] - awake[0] < max(HOLDS_H):
        raise DataError(f"hours from {awake[0]} to {awake[1]}: give at least {max(HOLDS_H)} h of a day, as in 7 to 22")
    signed = [name for name, low in zip(layout.names.actuators, layout.lowest, strict=True) if low < 0.0]
    if signed:
        raise DataError(
            f"{', '.join(signed)} heats and cools (mode both): probe it by room set-points, with `tf-mpc identify "
            "--testcase`; levels by hand are for heating or cooling"
        )


def as_changes(schedule: ProbeSchedule) -> tuple[Array, Array]:
    """When levels change, s, (k,), and the levels from then on, (A, k), NaN for own control; the last ends it."""
    u = np.concatenate([schedule.u, np.full((schedule.u.shape[0], 1), np.nan)], axis=1)
    same = (u[:, 1:] == u[:, :-1]) | (np.isnan(u[:, 1:]) & np.isnan(u[:, :-1]))
    kept = np.concatenate([[True], ~same.all(axis=0)]) if u.shape[1] > 1 else np.array([], dtype=bool)
    return schedule.time_s[kept], u[:, kept]
