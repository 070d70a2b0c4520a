"""Whether heat or level are stamped late or early: moved by so many steps, they explain a room much better.

The next reading of a room is told by the readings so far, the weather, and heat that acted at once or through lags of
emitter and sensor, which only warms. All that acts is moved by some steps, and fitted again: what is late has to be
moved to before the temperature that it made; what is early, beyond any lag that emitters have. Half the logarithm of
the squared errors, times their number, is the negative log likelihood (Ljung 1999, chapter 7). What emitter, pipes and
sensor delay anyway, a quarter of an hour or with a floor slab an hour, cannot be told from a wrong stamp.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Layout, Record
from thermoforce_mpc.data.series import interpolated, lagged
from thermoforce_mpc.measurements.checks.common import Remark

# Steps by which what acts is moved, at most.
_MOST_SHIFT = 6
# Time constants of emitters and sensors, s, and how many of them follow one another: nothing, a sensor or a convector,
# both, a radiator behind pipes, thin screed, thick screed.
_LAGS = ((0.0, 0), (600.0, 1), (600.0, 2), (1200.0, 2), (2400.0, 2), (4800.0, 2))
# Means of the readings so far, in steps: what a Kalman filter makes of them, whose gain is not known.
_MEMORIES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
# Log likelihood from which a shift counts, and that of an early stamp as a share of all that heat explains: lags have
# other shapes than those above.
_LEAST_GAIN, _LEAST_SHARE_EARLY = 8.0, 0.09
# Least share of known heat; rows needed for each coefficient.
_LEAST_KNOWN, _ROWS_EACH = 0.5, 3


def timing_remarks(record: Record, layout: Layout) -> list[Remark]:
    """Whether what acts is stamped late or early, by all zones together: they stand in one table."""
    found = [loss for zone in dict.fromkeys(layout.home) if (loss := _losses(record, layout, zone)) is not None]
    if not found:
        return []
    losses = np.sum(found, axis=0)
    shift, gained = _shift(losses)
    if not shift:
        return []
    where = "heat" if np.isfinite(record.heat_W).any() else "level"
    minutes, steps = abs(shift) * record.step_s / 60.0, f"{abs(shift)} step{'s' if abs(shift) > 1 else ''}"
    sure = float(np.sqrt(2.0 * gained))
    if shift > 0:
        words = f"rooms warm up to {steps} ({minutes:g} min) before they are heated"
        remedy = (
            "if a stamp marks the end of its step set time.marks: end, else move the column so much earlier; where "
            "temperatures are means over a step, give those at its stamp"
        )
        return [Remark("stamps late", where, words, remedy, sure)]
    words = f"rooms do nothing for about {steps} ({minutes:g} min) after they are heated, then all at once"
    remedy = (
        "if a stamp marks the start of its step set time.marks: start, else move the column so much later (a clock "
        "that is off, summer time?)"
    )
    return [Remark("stamps early", where, words, remedy, sure)]


def _shift(losses: Array) -> tuple[int, float]:
    """Steps by which heat is late (above 0) or early, and the log likelihood gained; 0 where neither.

    `losses` (2 · most + 2,): negative log likelihood by shift, and last that without heat.
    """
    by_shift, as_it_is = losses[:-1], losses[_MOST_SHIFT]
    best = int(np.argmin(by_shift))
    gained, shift = float(as_it_is - by_shift[best]), best - _MOST_SHIFT
    least = max(_LEAST_GAIN, _LEAST_SHARE_EARLY * (losses[-1] - by_shift[best]) if shift < 0 else 0.0)
    return (shift, gained) if gained > least else (0, 0.0)


def _losses(record: Record, layout: Layout, zone: int) -> Array | None:
    """Negative log likelihood of a zone by the shift of its heat, and last without it; None: not enough is known."""
    from scipy.optimize import nnls

    T, n = record.T_zone_C[zone], record.n_steps
    if n <= 2 * _MOST_SHIFT or not np.isfinite(T).any():
        return None
    k = np.arange(_MOST_SHIFT, n - _MOST_SHIFT)
    beside, target = _told_without_heat(record, zone)[k], T[k + 1]
    acting = np.column_stack([_lagged(record, layout, a) for a in layout.actuators_of(zone)])
    shifted = [acting[k + shift] for shift in range(-_MOST_SHIFT, _MOST_SHIFT + 1)]
    rows = np.isfinite(np.column_stack([beside, target, *shifted])).all(axis=1)
    if rows.sum() < _ROWS_EACH * (beside.shape[1] + acting.shape[1]):
        return None
    basis, _ = np.linalg.qr(beside[rows])

    def left(values: Array) -> Array:
        return np.asarray(values[rows] - basis @ (basis.T @ values[rows]))

    rest = left(target)
    errors = [nnls(left(heat), rest)[1] for heat in shifted]
    return np.asarray(rows.sum() * np.log(np.maximum([*errors, np.linalg.norm(rest)], 1e-9)))


def _told_without_heat(record: Record, zone: int) -> Array:
    """What tells the next reading of a zone beside its heat, (n, m): readings so far, neighbours and weather."""
    T, sun, outdoors = record.T_zone_C[zone], record.solar_W_m2, record.T_out_C
    bridged = interpolated(T)
    hour = 2.0 * np.pi * record.time_s / DAY_S
    columns = [np.ones(T.size), T, np.cos(hour), np.sin(hour), outdoors, sun, _before(outdoors, 1), _before(sun, 1)]
    columns += [np.append(sun[1:], sun[-1]), _before(sun, 2)]
    columns += [lagged(bridged, float(np.exp(-1.0 / memory)), float(bridged[0]))[1:] for memory in _MEMORIES]
    columns += [other for z, other in enumerate(record.T_zone_C) if z != zone]
    return np.column_stack(columns)[:-1]


def _lagged(record: Record, layout: Layout, a: int) -> Array:
    """What an actuator does in each step, over its largest, at once and through each of the lags (n, L)."""
    metered = np.isfinite(record.heat_W[a]).mean() >= _LEAST_KNOWN
    heat = record.heat_W[a] if metered else layout.signs[a] * record.u[a]
    known = np.isfinite(heat)
    if not known.any():
        return np.full((heat.size, len(_LAGS)), np.nan)
    columns = []
    for lag_s, times in _LAGS:
        column = interpolated(heat) / max(np.abs(heat[known]).max(), 1e-9)
        for _ in range(times):
            memory = lag_s / record.step_s
            at_end = lagged(column, float(np.exp(-1.0 / memory)))[1:]
            column = column + (_before(at_end, 1) - column) * memory * -np.expm1(-1.0 / memory)  # mean over the step
        columns.append(column)
    return np.where(known[:, None], np.column_stack(columns), np.nan)


def _before(values: Array, steps: int) -> Array:
    """`values` (n,) so many steps before; the first ones repeated."""
    return np.concatenate([values[:1].repeat(steps), values[:-steps]])
