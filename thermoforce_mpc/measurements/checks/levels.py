"""Whether meter and level go together; where they do not, whether the level is none or the meter holds another load.

With the outdoor temperature a level tells what the machine takes. Where it does not, the rooms tell why: what the meter
shows beside the level and warms the rooms is heating that the level does not know of (the column is a set-point, or
what was asked for); what warms nobody is another load: hot water, or a whole house on the meter. Where several rooms
hang on one meter their levels explain much of it by chance: there hot water shows as bursts at the same hours of most
days, while the rooms get nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, Array, Layout, Record
from thermoforce_mpc.data.clock import whole_hour
from thermoforce_mpc.data.series import step_means
from thermoforce_mpc.measurements.checks.common import Remark, explained, fitted

# Share of the variance of its power that a machine's levels explain at least, with the outdoor temperature. Part load,
# cycling and water temperatures leave up to 10 % (test cases and generated houses), another load or a set-point more.
# With the heat that it gave, a machine leaves up to 2 %.
_LEAST_EXPLAINED, _LEAST_BY_HEAT = 0.8, 0.95
# Off is no level at all, two steps and more; then a share of full power is no stand-by, and a share of all energy,
# taken at so many times, no chance.
_OFF, _BURST, _LEAST_ENERGY, _LEAST_TIMES = 1e-6, 0.15, 0.01, 4
# Standard deviations from which rooms are warmed by what is beside the level, within so many steps.
_WARMS, _WITHIN = 5.5, (1, 2, 4)
# Without a meter: share of the variance of a level that the time of day explains where it is a schedule, what a zone
# under a fixed level has of the outdoor temperature of two days at least (with a time constant of 100 h a third), and
# what is needed of both to see it.
_ALIKE, _MOST_OF_WEATHER, _LEAST_DAYS, _LEAST_WEATHER_K = 0.95, 0.25, 7, 0.7
_LEAST_ROWS = 96
# Bursts beside the levels: from this many usual deviations and this share of the meter's range on. They are another
# load where they hold so much of the energy, come on so many of the days, and mostly at the same hours; and warm no
# room. House of three rooms with 14 % of hot water: 6 % in bursts, in any two weeks 4 % and more, nothing without it;
# nothing in 18 clean records of `bench records` (seed 41; 2026-11-28).
_TIMES_USUAL, _OF_RANGE = 3.0, 0.15
_BURST_ENERGY, _BURST_DAYS, _SAME_HOURS, _HOURS = 0.03, 0.6, 0.75, 5


def level_remarks(record: Record, layout: Layout) -> list[Remark]:
    """Levels that are none, and meters that hold another load."""
    found: list[Remark] = []
    doubted: set[int] = set()
    for m, (machine, fed) in enumerate(zip(layout.names.machines, layout.actuators_of_machines, strict=True)):
        remark = _of_meter(record, layout, fed, record.power_W[m], f"power of {machine}") if fed else None
        if remark is not None:
            found.append(remark)
            doubted.update(fed)
    for a, actuator in enumerate(layout.names.actuators):
        if a in doubted:
            continue
        if np.isfinite(record.heat_W[a]).any():
            remark = _of_meter(record, layout, [a], np.abs(record.heat_W[a]), f"heat of {actuator}", of_heat=True)
        elif not np.isfinite(record.power_W[layout.machine_of[a]]).any():
            remark = _kept(record, layout, a)
        else:
            remark = None
        found += [remark] if remark is not None else []
    return found


def _of_meter(
    record: Record, layout: Layout, fed: list[int], meter_W: Array, where: str, *, of_heat: bool = False
) -> Remark | None:
    """A remark on one meter beside the levels of what it feeds; of heat, which lags, while they are off."""
    u = record.u[fed]
    rows = np.isfinite(u).all(axis=0) & np.isfinite(meter_W) & np.isfinite(record.T_out_C[:-1])
    if rows.sum() < _LEAST_ROWS or not (np.ptp(u[:, rows], axis=1) > 0.0).any():
        return None
    T_out = record.T_out_C[:-1]
    on = (np.abs(row) > _OFF for row in u)  # fans and pumps of a machine that is on
    of_levels = [c[rows] for row in u for c in (row, np.square(row), row * T_out)] + [row[rows] for row in on]
    columns = np.array([np.ones(rows.sum()), *of_levels]).T
    (share, left), least = explained(columns, meter_W[rows]), _LEAST_EXPLAINED
    names = " and ".join(record.names.label("u", a) for a in fed)
    heat = np.abs(record.heat_W[fed]).sum(axis=0)[rows]
    if not of_heat and share >= least and np.isfinite(heat).all():
        columns = np.column_stack([columns, heat, heat * T_out[rows], np.square(heat)])
        (share, left), least = explained(columns, meter_W[rows]), _LEAST_BY_HEAT
    beside = np.full(record.n_steps, np.nan)
    beside[rows] = left
    if _counts(meter_W):
        return Remark(
            "unit of power",
            where,
            f"it only rises, from {np.nanmin(meter_W):.4g} to {np.nanmax(meter_W):.4g}: a counter of energy, no power",
            "set unit: kWh counter (or Wh counter) in the map",
        )
    energy, times = _while_off(u, meter_W, rows)
    at_rest = energy > _LEAST_ENERGY and times >= _LEAST_TIMES
    at_hours = 0.0 if of_heat or at_rest or share < least else _at_the_same_hours(record, layout, fed, meter_W, beside)
    if not (at_rest or at_hours) and (of_heat or share >= least):
        return None
    beside_level = " with the heat" if least == _LEAST_BY_HEAT else ""
    says = f"{names}{beside_level} explain{'s' if len(fed) == 1 else ''} {100 * max(share, 0.0):.0f} % of the {where}"
    if at_rest:
        says += f", {100 * energy:.0f} % of its energy flows while {'it is' if len(fed) == 1 else 'they are'} off"
    if at_hours:
        says += f", {100 * at_hours:.0f} % of its energy and more flows beside in bursts at the same hours of the day"
    warms = 0.0 if at_hours else _warming(record, layout, fed, beside)
    if warms > _WARMS:
        return Remark(
            "level is no level",
            names,
            f"{says}, and what flows beside warms the room",
            "a set-point, or what was asked for, is no level: name what the machine did (valve, speed, on and off), or "
            "leave the level out, and heat or power over the full one is taken for it",
            warms,
            tuple(fed),
        )
    return Remark(
        "meter holds another load",
        where,
        f"{says}, and what flows beside warms no room",
        "take the other load (hot water, the household) off, meter it apart, name a mode of hot water (hot_water of "
        "the machine), or the standing load as off_W",
        float(np.sqrt(rows.sum() * max(1.0 - share, 0.0))),
    )


def _counts(meter_W: Array) -> bool:
    """Whether a meter (n,) only rises, and again and again, as a counter does and no power."""
    known = meter_W[np.isfinite(meter_W)]
    changes = np.diff(known)
    return bool(
        known.size >= _LEAST_ROWS and (changes >= 0.0).mean() > 0.995 and (changes > 0.0).sum() > known.size / 20
    )


def _while_off(u: Array, meter_W: Array, rows: NDArray[np.bool_]) -> tuple[float, int]:
    """Share of the energy beyond stand-by that flows while all levels (k, n) are off, and the number of times."""
    off = rows & (np.abs(np.where(np.isfinite(u), u, 1.0)) < _OFF).all(axis=0)
    resting = off & np.append(False, off[:-1])  # the first step after it was on holds its end
    full_W = float(np.percentile(meter_W[rows], 99.0))
    if resting.sum() < _LEAST_TIMES or full_W <= 0.0:
        return 0.0, 0
    standby_W = float(np.percentile(meter_W[resting], 25.0))
    beyond = np.where(resting, meter_W - standby_W, 0.0)
    taken = beyond > _BURST * (full_W - standby_W)
    total = float(np.clip(meter_W[rows], 0.0, None).sum())
    times = int((np.diff(np.append(0, taken.astype(int))) > 0).sum())
    return float(beyond[taken].sum()) / total if total > 0.0 else 0.0, times


def _at_the_same_hours(record: Record, layout: Layout, fed: list[int], meter_W: Array, beside_W: Array) -> float:
    """Share of the energy in bursts of `beside_W` (n,) that come at the same hours and warm no room; 0 without."""
    usual_W = 1.4826 * float(np.nanmedian(np.abs(beside_W - np.nanmedian(beside_W))))
    known = np.isfinite(beside_W)
    range_W = float(np.percentile(meter_W[known], 99.0) - np.percentile(meter_W[known], 1.0))
    burst = known & (np.nan_to_num(beside_W) > max(_TIMES_USUAL * usual_W, _OF_RANGE * range_W))
    at_s = record.time_s[:-1][burst]
    days = np.unique(record.time_s[:-1][known] // DAY_S).size
    share = float(beside_W[burst].sum()) / float(np.clip(meter_W[known], 0.0, None).sum() or np.inf)
    if share < _BURST_ENERGY or np.unique(at_s // DAY_S).size < _BURST_DAYS * days:
        return 0.0
    by_hour = np.bincount(whole_hour(at_s), minlength=24)
    if np.sort(by_hour)[-_HOURS:].sum() < _SAME_HOURS * at_s.size:
        return 0.0
    # Later the rooms are warmed by what their thermostats ask for, at the same hours too.
    warms = _warming(record, layout, fed, np.where(known, np.where(burst, beside_W, 0.0), np.nan), within=_WITHIN[:1])
    return share if warms < _WARMS else 0.0


def _warming(
    record: Record, layout: Layout, fed: list[int], beside_W: Array, within: tuple[int, ...] = _WITHIN
) -> float:
    """How many standard deviations say that `beside_W` (n,), NaN where not known, warms a room of `fed` at once.

    0 where its own level is surer to warm some room: then levels are levels. What is beside warms too where the water
    is warmer at times (house 9211 of `bench commands`: 6.4 in a room whose valve hardly opens, beside 17 of a level).
    """
    most = by_level = 0.0
    for ahead in within:
        k = np.arange(2, record.n_steps - ahead)
        levels = [record.u[b][k - j] for b in fed for j in (0, 1)]
        for a in fed:
            T = record.T_zone_C[layout.home[a]]
            columns = [np.ones(k.size), T[k], T[k] - T[k - 2], record.T_out_C[k], record.solar_W_m2[k]]
            table, target = np.array([*columns, *levels, beside_W[k]]).T, layout.signs[a] * (T[k + ahead] - T[k])
            rows = np.isfinite(table).all(axis=1) & np.isfinite(target)
            if rows.sum() < _LEAST_ROWS:
                continue
            beta, covariance, _ = fitted(table[rows], target[rows])
            sure = beta / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
            own = len(columns) + 2 * fed.index(a)
            if covariance[-1, -1] > 0.0:
                most = max(most, float(sure[-1]))
            by_level = max(by_level, *(float(sure[i]) for i in (own, own + 1) if covariance[i, i] > 0.0), 0.0)
    return most if most > by_level else 0.0


def _kept(record: Record, layout: Layout, a: int) -> Remark | None:
    """A remark where a level is the same every day and the zone keeps its temperature all the same; none is metered."""
    per_day = round(DAY_S / record.step_s)
    days = record.n_steps // per_day
    if days < _LEAST_DAYS:
        return None
    n = days * per_day
    u = record.u[a, :n].reshape(days, per_day)
    T = record.T_zone_C[layout.home[a], :n].reshape(days, per_day)
    T_out = record.T_out_C[:n].reshape(days, per_day).mean(axis=1)
    if not np.isfinite(u).all() or np.ptp(u) == 0.0:
        return None
    alike = 1.0 - float(np.square(u - u.mean(axis=0)).sum() / np.square(u - u.mean()).sum())
    # What the zone has of the weather of two days comes after it.
    outdoors, zone = step_means(T_out), T.mean(axis=1)[1:]
    rows = np.isfinite(outdoors) & np.isfinite(zone)
    if alike < _ALIKE or rows.sum() < _LEAST_DAYS - 1 or np.std(outdoors[rows]) < _LEAST_WEATHER_K:
        return None
    beta, covariance, _ = fitted(np.array([np.ones(rows.sum()), outdoors[rows]]).T, zone[rows])
    sd = float(np.sqrt(covariance[1, 1]))
    if not beta[1] + sd < _MOST_OF_WEATHER:
        return None
    return Remark(
        "level is no level",
        record.names.label("u", a),
        f"the same every day ({100 * alike:.0f} % of its variance), and yet the zone has {beta[1]:.2f} K of each K of "
        "the outdoor temperature: something else keeps it",
        "a set-point is no level: name what the machine did (valve, speed, on and off), or its heat or power",
        float((_MOST_OF_WEATHER - beta[1]) / sd) if sd > 0.0 else float("inf"),
        (a,),
    )
