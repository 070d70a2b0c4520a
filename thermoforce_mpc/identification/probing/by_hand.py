"""A probing schedule to run by hand: days of levels after which a record can tell the effect of acting.

Draws are chosen as in probing (`design.choose`), but levels change on the hour and only while people are awake; at
night the building's own control acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Layout, Record, steps_in
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.data.clock import hour_of_day
from thermoforce_mpc.data.series import bridged
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.probing.design import choose, expected_rise_K
from thermoforce_mpc.identification.probing.excitation import Draws, Excitation

# Longest schedule, days. By judgement, as the rest: what people may be asked for.
_MOST_DAYS = 7
# Holding times by hand, h, since nobody turns a knob by the quarter hour, and draws that are compared a day.
_HOLDS_H, _CANDIDATES = (1, 2, 3, 4, 6), 24
# Half width of a comfort band that nobody named, around the usual temperature, K.
_BAND_K = 1.5


@dataclass(frozen=True)
class ProbeSchedule:
    """Levels to hold by hand.

    `time_s` (n + 1,) s: boundaries of the hours. `u` (A, n): levels, NaN where the building's own control acts.
    `probed`: actuators that are. `lower_C`, `upper_C` (Z,): comfort band assumed. `discomfort_Kh` (Z,): expected K·h
    outside the band, `excursion_K` (Z,): expected largest distance from the usual temperature.
    """

    record: Record
    time_s: Array
    u: Array
    probed: tuple[str, ...]
    lower_C: Array
    upper_C: Array
    discomfort_Kh: Array
    excursion_K: Array

    @property
    def by_hand_h(self) -> int:
        """Hours in which some level is set by hand."""
        return int(np.isfinite(self.u).any(axis=0).sum())


def probe_schedule(
    record: Record,
    layout: Layout,
    *,
    days: int = 1,
    lower_C: Array | None = None,
    upper_C: Array | None = None,
    levels: Sequence[float] = (0.0, 1.0),
    awake: tuple[int, int] = (7, 22),
    start_s: float | None = None,
    competent: Sequence[bool] | None = None,
    seed: int = 1,
) -> ProbeSchedule:
    """A schedule of whole days, the most informative of the draws that are compared.

    Args:
        record: the last month or so of operation.
        layout: what acts where.
        days: length of the schedule, 1 to 7.
        lower_C, upper_C: comfort band of each zone (Z,), °C; NaN or None: 1.5 K around the zone's median.
        levels: levels to draw from, off first.
        awake: hours of the day between which levels change and are held, local standard time.
        start_s: where it starts; default: the first morning after the end of the record.
        competent: of each actuator, whether a model of the record is (`operation.findings`); those of which it is are
            not probed. Default: all are.
        seed: seed of the draws.

    Raises:
        DataError: days, levels or hours make no sense, a level is signed (mode both), or weather or a temperature was
            never measured.
    """
    _check(layout, days, levels, awake)
    filled, _ = bridged(record)
    silent = ~np.isfinite(record.T_zone_C).any(axis=1)
    if silent.any():
        raise DataError(f"{record.names.zones[int(np.argmax(silent))]}: its temperature was not measured of late")
    usual = np.nanmedian(record.T_zone_C, axis=1)
    lower, upper = _band(lower_C, usual - _BAND_K), _band(upper_C, usual + _BAND_K)
    probed = [a for a in range(len(layout.home)) if competent is None or not competent[a]]
    morning = np.ceil((float(record.time_s[-1]) - awake[0] * HOUR_S) / DAY_S) * DAY_S + awake[0] * HOUR_S
    begin = morning if start_s is None else start_s
    n = 24 * days
    future = _continued(_hourly(filled), begin, n, usual)
    first = future.n_steps - n
    history, ahead = future.slice(0, first), future.slice(first, first + n)
    u = np.full((len(layout.home), n), np.nan)
    for a in probed:
        home = layout.home[a]
        _, u[a] = choose(
            history.part(home, [a]),
            Boundary.measured(ahead.part(home, [a])),
            Excitation(tuple(levels), _HOLDS_H, np.random.default_rng(seed)),
            [Draws(_HOLDS_H, (seed, a, k)) for k in range(_CANDIDATES)],
            centre_C=0.5 * float(lower[home] + upper[home]),
            sign=layout.signs[a],
            acts=_are_awake(ahead.time_s[:-1], awake),
        )
    rise = _rise_K(future, layout, u)
    T = usual[:, None] + rise
    outside = excess(T, lower[:, None], upper[:, None])
    names = tuple(layout.names.actuators[a] for a in probed)
    time_s = np.asarray(begin + np.arange(n + 1) * HOUR_S)
    return ProbeSchedule(record, time_s, u, names, lower, upper, outside[:, 1:].sum(axis=1), np.abs(rise).max(axis=1))


def _continued(record: Record, begin_s: float, hours: int, usual_C: Array) -> Record:
    """An hourly record as it may go on for the `hours` that are probed: as usual, its last week's weather again.

    It goes on to `begin_s` of the next day; a schedule of later days may as well begin then.
    """
    n = round((begin_s - float(record.time_s[-1])) / HOUR_S) % 24 + hours
    week = min(7 * 24, record.n_steps)
    back = np.arange(n) % week - week
    usual_u = np.nanmean(record.u, axis=1, keepdims=True)

    def unknown(rows: int) -> Array:
        return np.full((rows, record.n_steps + n), np.nan)

    return Record(
        np.concatenate([record.time_s, record.time_s[-1] + np.arange(1, n + 1) * HOUR_S]),
        np.concatenate([record.T_zone_C, np.repeat(usual_C[:, None], n, axis=1)], axis=1),
        np.concatenate([record.T_out_C, record.T_out_C[back]]),
        np.concatenate([record.solar_W_m2, record.solar_W_m2[back]]),
        np.concatenate([record.u, np.repeat(usual_u, n, axis=1)], axis=1),
        unknown(len(record.names.machines)),
        unknown(len(record.names.actuators)),
        origin=record.origin,
        names=record.names,
    )


def _rise_K(future: Record, layout: Layout, u: Array) -> Array:
    """Expected change of the zones by levels `u` (A, n) against own control, (Z, n + 1), K."""
    rise = np.zeros((len(layout.names.zones), u.shape[1] + 1))
    extra = np.where(np.isfinite(u), u - future.u[:, -1:], 0.0)
    for home, sign, levels in zip(layout.home, layout.signs, extra, strict=True):
        rise[home] += sign * expected_rise_K(levels, HOUR_S)
    return rise


def _are_awake(time_s: Array, awake: tuple[int, int]) -> NDArray[np.bool_]:
    of_day = hour_of_day(time_s)
    return np.asarray((of_day >= awake[0]) & (of_day < awake[1]))


def _hourly(record: Record) -> Record:
    """The record in hours: the design looks at hourly rows anyway, and people act on the hour."""
    every = steps_in(HOUR_S, record.step_s)
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


def _check(layout: Layout, days: int, levels: Sequence[float], awake: tuple[int, int]) -> None:
    if not 1 <= days <= _MOST_DAYS:
        raise DataError(f"{days} days to probe: give 1 to {_MOST_DAYS}")
    if levels[0] != 0.0 or len(set(levels)) < 2 or not all(0.0 <= level <= 1.0 for level in levels):
        raise DataError(f"levels to probe are {list(levels)}: start with 0, and give another one in (0, 1]")
    if not 0 <= awake[0] < awake[1] <= 24 or awake[1] - awake[0] < max(_HOLDS_H):
        raise DataError(f"hours from {awake[0]} to {awake[1]}: give at least {max(_HOLDS_H)} h of a day, as in 7 to 22")
    signed = [name for name, low in zip(layout.names.actuators, layout.u_min, strict=True) if low < 0.0]
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
