"""Whether heat or level are stamped late or early: a room follows its heat, neither before it nor after a pause.

Two regressions, pooled over all actuators, tell. In the first, the change of a room over a step is that of heat in the
steps around it. A room cannot warm before it is heated; where it seems to, the heat is stamped late. Where it does
nothing in the step of its heat and all at once later, the heat is stamped early. In the second, the level of a step is
that of the temperatures around it: it is told by the difference of those at its end and its start, so that the
temperature with the most negative coefficient stands at the start of the step, or, where emitters lag, one step after.
What is slow by nature (a floor slab) tells neither.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thermoforce_mpc.data import Array, Layout, Record
from thermoforce_mpc.identification.checks.regression import fitted
from thermoforce_mpc.identification.checks.remark import Remark

# Steps before and after its own in which heat is looked for, and temperatures that tell of a level.
_BEFORE, _AFTER, _SPAN = 8, 5, 6
# Standard deviations from which a response counts, and those that the largest of an actuator needs.
_CLEAR, _SEEN = 6.0, 3.0
# Before its heat a room does less than this share of its largest response: the rounding of stamps moves a part of it.
_MOST_AHEAD = 0.25
# A system of three lags, far slower than a step, does a seventh in the first step of what it does in the second, and
# from then on at most 2.7 times as much (t³): what rises faster than the first and no faster than the second is late.
_LEAST_FIRST, _MOST_RISE = 0.12, 2.0
# In the second regression: share of the largest coefficient that counts beside it, and standard deviations for early.
_BESIDE, _CLEAR_EARLY = 0.4, 8.0
_MOST_SHIFT = 4
# Least share of known heat; rows needed for each coefficient.
_LEAST_KNOWN, _ROWS_EACH = 0.5, 3

Fit = tuple[Array, Array]


def timing_remarks(record: Record, layout: Layout) -> list[Remark]:
    """Whether what acts is stamped late or early, by all actuators together: they stand in one table."""
    shift, sure = _by_response(_pooled(record, layout, _response, 1.0))
    if not shift:
        shift, sure = _by_level(_pooled(record, layout, _told_by, -1.0))
    if not shift:
        return []
    where = "heat" if np.isfinite(record.heat_W).any() else "level"
    minutes, steps = abs(shift) * record.step_s / 60.0, f"{abs(shift)} step{'s' if abs(shift) > 1 else ''}"
    if shift > 0:
        words = f"rooms warm up to {steps} ({minutes:g} min) before they are heated"
        remedy = (
            "if a stamp marks the end of its step set time.marks: end, else move the column so much earlier; where "
            "temperatures are means over a step, give those at its stamp"
        )
        return [Remark("stamps late", where, words, remedy, sure)]
    words = f"rooms do nothing for {steps} ({minutes:g} min) after they are heated, then all at once"
    remedy = (
        "if a stamp marks the start of its step set time.marks: start, else move the column so much later (a clock "
        "that is off, summer time?)"
    )
    return [Remark("stamps early", where, words, remedy, sure)]


def _pooled(
    record: Record, layout: Layout, fit: Callable[[Record, Layout, int], Fit | None], sign: float
) -> Fit | None:
    """Mean coefficients of all actuators, each over its largest of `sign`, with their covariance; None: none seen."""
    total, spread, weights = 0.0, 0.0, 0.0
    for a in range(len(layout.home)):
        found = fit(record, layout, a)
        if found is None:
            continue
        coefficients, covariance = found
        top = int(np.argmax(sign * coefficients))
        largest, variance = sign * coefficients[top], covariance[top, top]
        if largest <= 0.0 or largest < _SEEN * np.sqrt(variance):
            continue
        weight = largest**2 / variance
        total = total + weight * coefficients / largest
        spread = spread + weight**2 * covariance / largest**2
        weights += weight
    return (np.asarray(total / weights), np.asarray(spread / weights**2)) if weights else None


def _response(record: Record, layout: Layout, a: int) -> Fit | None:
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
    own = [heat[k + j] / np.abs(known).max() for j in range(-_BEFORE, _AFTER + 1)]
    columns, target = np.array(beside + own).T, T[k + 1] - T[k]
    rows = np.isfinite(columns).all(axis=1) & np.isfinite(target)
    if rows.sum() < _ROWS_EACH * columns.shape[1]:
        return None
    beta, covariance, _ = fitted(columns[rows], target[rows])
    return beta[len(beside) :], covariance[len(beside) :, len(beside) :]


def _told_by(record: Record, layout: Layout, a: int) -> Fit | None:
    """The level of step k for the temperatures of its zone at boundary k − 5 to k + 6, with its covariance."""
    u, T = layout.signs[a] * record.u[a], record.T_zone_C[layout.home[a]]
    k = np.arange(_SPAN, record.n_steps - _SPAN)
    beside = [np.ones(k.size), u[k - 1], u[k - 2]]
    columns, target = np.array([*beside, *(T[k + j] for j in range(1 - _SPAN, _SPAN + 1))]).T, u[k]
    rows = np.isfinite(columns).all(axis=1) & np.isfinite(target)
    if rows.sum() < _ROWS_EACH * columns.shape[1] or np.ptp(target[rows]) == 0.0:
        return None
    beta, covariance, _ = fitted(columns[rows], target[rows])
    return beta[len(beside) :], covariance[len(beside) :, len(beside) :]


def _by_response(pooled: Fit | None) -> tuple[int, float]:
    """Steps by which heat is late (above 0) or early, and how many standard deviations say so; 0 where neither."""
    if pooled is None:
        return 0, 0.0
    response, covariance = pooled
    sd, top = np.sqrt(np.diag(covariance)), float(response.max())
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
            pause = slice(first + 1, _BEFORE + 1)
            mean_sd = float(np.sqrt(covariance[pause, pause].mean()))
            sudden = float(response[pause].mean()) + 2.0 * mean_sd < _LEAST_FIRST * response[first]
            sudden &= bool((np.abs(response[pause]) < _MOST_AHEAD * top).all())
            sudden &= bool(response[first - 1] < _MOST_RISE * response[first])
            return (-shift, float(response[first] / sd[first])) if sudden else (0, 0.0)
    return 0, 0.0


def _by_level(pooled: Fit | None) -> tuple[int, float]:
    """The same by what tells of a level; an emitter's lag of one step is no early stamp."""
    if pooled is None:
        return 0, 0.0
    told, covariance = pooled
    clear = told / np.sqrt(np.diag(covariance))
    at = int(np.argmin(told))
    rises = any(told[i] > _BESIDE * -told[at] and clear[i] > _CLEAR for i in range(at + 1, min(at + 3, told.size)))
    late = _SPAN - 1 - at
    if 0 < late <= _MOST_SHIFT and rises and clear[at] < -_CLEAR:
        return late, float(-clear[at])
    # What acts may follow a temperature (a thermostat), but none that is still to come.
    early = -late - (at > 0 and told[at - 1] < _BESIDE * told[at])
    return (1 - early, float(-clear[at])) if 1 < early <= _MOST_SHIFT + 1 and clear[at] < -_CLEAR_EARLY else (0, 0.0)
