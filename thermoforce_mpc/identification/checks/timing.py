"""Whether heat or level are stamped late or early: a room follows its heat, neither before it nor after a pause.

The change of the room over a step is regressed on the heat of the steps around it. A room cannot warm before it is
heated; where it seems to, the heat is stamped late. Where it does nothing in the step of its heat and all at once
later, the heat is stamped early. What is slow by nature (a floor slab, a sensor in a wall) rises little by little;
there a shift of a step is not seen.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array, Layout, Record
from thermoforce_mpc.identification.checks.regression import fitted
from thermoforce_mpc.identification.checks.remark import Remark

# Steps before and after its own in which heat is looked for.
_BEFORE, _AFTER = 8, 5
# Standard deviations from which a response counts, and those that a pooled response needs.
_CLEAR, _SEEN = 5.0, 3.0
# Before its heat a room does less than this share of its largest response: the rounding of stamps moves a part of it.
_MOST_AHEAD = 0.25
# A system of three lags, far slower than a step, does a seventh in the first step of what it does in the second, and
# from then on at most 2.7 times as much (t³): what rises faster than the first and no faster than the second is late.
_LEAST_FIRST, _MOST_RISE = 0.12, 2.0
_MOST_SHIFT = 4
# Least share of known heat; rows needed for each coefficient.
_LEAST_KNOWN, _ROWS_EACH = 0.5, 3


def timing_remarks(record: Record, layout: Layout) -> list[Remark]:
    """Whether what acts is stamped late or early, by all actuators together: they stand in one table."""
    pooled = _pooled(record, layout)
    if pooled is None:
        return []
    response, covariance = pooled
    shift, sure = _shift(response, np.sqrt(np.diag(covariance)))
    if not shift:
        return []
    where = "heat" if np.isfinite(record.heat_W).any() else "level"
    minutes, steps = abs(shift) * record.step_s / 60.0, f"{abs(shift)} step{'s' if abs(shift) > 1 else ''}"
    if shift > 0:
        return [
            Remark(
                "stamps late",
                where,
                f"rooms warm up to {steps} ({minutes:g} min) before they are heated",
                "if a stamp marks the end of its step set time.marks: end, else move the column so much earlier; where "
                "temperatures are means over a step, give those at its stamp",
                sure,
            )
        ]
    return [
        Remark(
            "stamps early",
            where,
            f"rooms do nothing for {steps} ({minutes:g} min) after they are heated, then all at once",
            "if a stamp marks the start of its step set time.marks: start, else move the column so much later (a clock "
            "that is off, summer time?)",
            sure,
        )
    ]


def _pooled(record: Record, layout: Layout) -> tuple[Array, Array] | None:
    """Mean response of all zones to their own heat by its step, largest 1, with its covariance; None: none is seen."""
    total, weights, spread = np.zeros(_BEFORE + _AFTER + 1), 0.0, np.zeros((_BEFORE + _AFTER + 1,) * 2)
    for a in range(len(layout.home)):
        found = _response(record, layout, a)
        if found is None:
            continue
        response, covariance = found
        top = int(np.argmax(response))
        variance = covariance[top, top]
        if response[top] <= 0.0 or response[top] < _SEEN * np.sqrt(variance):
            continue
        weight = response[top] ** 2 / variance
        total += weight * response / response[top]
        spread += weight**2 * covariance / response[top] ** 2
        weights += weight
    return (total / weights, spread / weights**2) if weights else None


def _response(record: Record, layout: Layout, a: int) -> tuple[Array, Array] | None:
    """Change of a zone in step k for heat of its actuator in step k − 8 to k + 5, with its covariance."""
    zone, n = layout.home[a], record.n_steps
    heat = record.heat_W[a] if np.isfinite(record.heat_W[a]).mean() >= _LEAST_KNOWN else record.u[a]
    heat = heat * (layout.signs[a] if heat is record.u[a] else 1.0)
    known = heat[np.isfinite(heat)]
    if n < _BEFORE + _AFTER + 2 or not known.size or np.ptp(known) == 0.0:
        return None
    k = np.arange(_BEFORE, n - _AFTER)
    T, sun = record.T_zone_C[zone], record.solar_W_m2
    beside = [np.ones(k.size), T[k], T[k - 1], T[k - 2], record.T_out_C[k], sun[k] + sun[k + 1], sun[k - 2]]
    beside += [record.T_zone_C[z][k] for z in range(len(record.T_zone_C)) if z != zone]
    beside += [record.u[b][k + j] for b in range(len(layout.home)) if b != a for j in (-2, -1, 0, 1, 2)]
    own = [heat[k + j] / np.percentile(np.abs(known), 99.0) for j in range(-_BEFORE, _AFTER + 1)]
    columns, target = np.array(beside + own).T, T[k + 1] - T[k]
    rows = np.isfinite(columns).all(axis=1) & np.isfinite(target)
    if rows.sum() < _ROWS_EACH * columns.shape[1]:
        return None
    beta, covariance, _ = fitted(columns[rows], target[rows])
    return beta[len(beside) :], covariance[len(beside) :, len(beside) :]


def _shift(response: Array, sd: Array) -> tuple[int, float]:
    """Steps by which heat is late (above 0) or early, and how many standard deviations say so; 0 where neither."""
    top = float(response.max())
    ahead, ahead_sd = response[_BEFORE + 1 : _BEFORE + 1 + _MOST_SHIFT], sd[_BEFORE + 1 : _BEFORE + 1 + _MOST_SHIFT]
    # Where heat follows a thermostat, a strongly negative response is its cause, and what lies beyond it no heat.
    heated = response[_BEFORE] > _MOST_AHEAD * top
    before = (np.cumsum(ahead < -_MOST_AHEAD * top) == 0) | (not heated)
    late = np.flatnonzero((ahead > _CLEAR * ahead_sd) & (ahead > _MOST_AHEAD * top) & before)
    if late.size:
        return int(late[-1]) + 1, float((ahead / ahead_sd)[late].max())
    for shift in range(1, _MOST_SHIFT + 1):
        first = _BEFORE - shift
        if response[first] > _CLEAR * sd[first] and response[first] > _MOST_AHEAD * top:
            pause, pause_sd = response[first + 1 : _BEFORE + 1], sd[first + 1 : _BEFORE + 1]
            sudden = bool((pause + 2.0 * pause_sd < _LEAST_FIRST * response[first]).all())
            sudden &= bool((pause > -_MOST_AHEAD * top).all())
            sudden &= response[first - 1] < _MOST_RISE * response[first]
            return (-shift, float(response[first] / sd[first])) if sudden else (0, 0.0)
    return 0, 0.0
