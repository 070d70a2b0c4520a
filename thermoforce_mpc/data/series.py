"""A first-order lag of a series, and gaps of the measured past filled where a computation needs numbers.

| signal | filled with |
|---|---|
| weather, up to 6 h between two readings | linear interpolation; up to now, towards the forecast for now |
| weather, longer | the reading of the same hour of the nearest day; without one, the nearest reading |
| u, up to 2 h | linear interpolation: the level where both readings agree, between them where they do not |
| u, longer | the mean level over 12 h on either side, or of all known levels; 0 if none is known |
| zone temperature, heat, power, return water | not filled: their users handle NaN |

The level is not needed where heat was measured and drives the operator (`heat_drive`).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Record, steps_in
from thermoforce_mpc.data.limits import BRIDGED_GAP_H, BRIDGED_LEVEL_H, LEVELS_AROUND_H
from thermoforce_mpc.errors import DataError, counted

WEATHER = ("T_out_C", "solar_W_m2")


# Steps that `first_order` takes at once.
_BLOCK = 32


def first_order(poles: Array, drive: Array, start: Array) -> Array:
    """States (..., n, q) of x_t = a x_(t−1) + d_t: `poles` a (q,) in [0, 1], `drive` (..., n, q), `start` (..., q)."""
    n = drive.shape[-2]
    if n <= 1:  # laws that see the temperature ask step by step
        return np.asarray(poles * start[..., None, :] + drive)[..., :n, :]
    width = min(_BLOCK, n)
    within, fading, whole = _powers(np.asarray(poles, dtype=np.float64).tobytes(), width)
    count, first, q = -(-n // width), drive.shape[:-2], poles.size
    padded = np.zeros((*first, count * width, q))
    padded[..., :n, :] = drive
    # Axes by number: what finds them by name takes as long as all else of a short series.
    axes, (block, step, mode) = tuple(range(len(first))), range(len(first), len(first) + 3)
    blocks = padded.reshape(*first, count, width, q).transpose(*axes, mode, block, step)
    own = blocks @ within.swapaxes(-1, -2)  # (..., q, count, width), each block from 0
    begin = start[..., None]
    if count > 1:
        ends = first_order(whole, own[..., :-1, -1].swapaxes(-1, -2), start)
        begin = np.concatenate([np.broadcast_to(begin, (*first, q, 1)), ends.swapaxes(-1, -2)], axis=-1)
    states = own + begin[..., None] * fading
    return states.transpose(*axes, block + 1, block + 2, block).reshape(padded.shape)[..., :n, :]


@lru_cache(32)
def _powers(poles: bytes, width: int) -> tuple[Array, Array, Array]:
    """What a drive leaves within a block (q, width, width), and a state after each step (q, 1, width) and after all.

    They take longer to work out than all else of a series of some days, and a run asks for the same ones.
    """
    a = np.frombuffer(poles)
    lag = np.arange(width)[:, None] - np.arange(width)
    within = np.where(lag >= 0, a[:, None, None] ** np.maximum(lag, 0), 0.0)
    return within, a[:, None, None] ** np.arange(1, width + 1), a**width


def step_means(values: Array) -> Array:
    """Means (..., n) over n steps of what is sampled at their ends (..., n + 1) and goes straight between."""
    values = np.asarray(values)
    return np.asarray(0.5 * (values[..., :-1] + values[..., 1:]))


def rms(values: ArrayLike) -> float:
    """Root mean square of values of any shape; NaN of none."""
    values = np.asarray(values, dtype=np.float64)
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


def means_between(time_s: Array, means: Array, edges_s: Array) -> Array:
    """Means (..., m) between `edges_s` (m + 1,) of what has `means` (..., n) between `time_s` (n + 1,), s."""
    amount = np.zeros((*means.shape[:-1], time_s.size))
    np.cumsum(np.diff(time_s) * means, axis=-1, out=amount[..., 1:])
    at_edges = [np.interp(edges_s, time_s, row) for row in amount.reshape(-1, time_s.size)]
    return np.asarray(np.diff(np.reshape(at_edges, (*means.shape[:-1], edges_s.size))) / np.diff(edges_s))


def means_of(values: Array, n: int) -> Array:
    """Means (m // n,) of `n` values (m,) each, a rest left out; NaN where one is."""
    return np.asarray(values[: values.size // n * n].reshape(-1, n).mean(axis=1))


def lagged(signal: Array, pole: float, start: float = 0.0) -> Array:
    """States (n + 1,) of a lag of steady gain 1 of `signal` (n,), constant in each step; `pole`: exp(−step/τ)."""
    followed = first_order(np.array([pole]), (1.0 - pole) * np.asarray(signal)[:, None], np.array([start]))
    return np.append(start, followed[:, 0])


def bridged(history: Record, ahead: Boundary | None = None) -> tuple[Record, str]:
    """Return `history` with all gaps in weather and levels filled, and a note on the filling ('' without gaps).

    `ahead`: forecast from now on, for the weather at the end of the history. Raises `DataError` where a weather signal
    has no value in either.
    """
    filled: dict[str, Any] = {}
    notes: list[str] = []
    for name in WEATHER:
        if not np.isfinite(getattr(history, name)).all():
            filled[name], note = _weather(history, ahead, name)
            notes.append(note)
    unknown = ~np.isfinite(history.u)
    if unknown.any():
        filled["u"] = np.array([_levels(row, history.step_s) for row in history.u])
        for a in np.flatnonzero(unknown.any(axis=1)).tolist():
            notes.append(f"{history.names.label('u', a)}: {_of_levels(history.u[a], history.step_s)}")
    return (replace(history, **filled), "bridged " + ", ".join(notes)) if filled else (history, "")


def interpolated(values: Array) -> Array:
    """`values` (n,) with gaps interpolated; zeros where none is known."""
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(values.size), known, values[known]) if known.size else np.zeros(values.size)


def short_gaps_bridged(values: Array, apart: int) -> Array:
    """`values` (n,) with lines between known values at most `apart` places apart; longer gaps and the ends stay NaN."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size in (0, values.size):
        return values
    steps = np.diff(known)
    short = np.zeros(values.size, dtype=bool)
    short[known[0] : known[-1]] = np.repeat(steps <= apart, steps)
    return np.where(short, interpolated(values), values)


def held(values: Array) -> Array:
    """`values` (n,), not all NaN, with each gap filled by the last finite value (at the start, by the first)."""
    finite = np.isfinite(values)
    index = np.maximum.accumulate(np.where(finite, np.arange(values.size), -1))
    return np.asarray(values[np.where(index < 0, int(np.argmax(finite)), index)])


def at_instants(time_s: Array, known_s: Array, values: Array, within_s: float) -> Array:
    """The `values` (k,) at `known_s` that stand at the instants `time_s`, its shape; NaN where none does."""
    index = np.clip(np.searchsorted(known_s, time_s - within_s), 0, known_s.size - 1)
    return np.where(np.abs(known_s[index] - time_s) <= within_s, values[index], np.nan)


def stretches(wanted: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and one past the last place of each stretch in which `wanted` (n,) holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], wanted, [False]]).astype(int))).tolist()
    return list(zip(edges[0::2], edges[1::2], strict=True))


def gapless(history: Record) -> bool:
    """Whether `bridged` has nothing to fill."""
    return all(bool(np.isfinite(getattr(history, name)).all()) for name in (*WEATHER, "u"))


def long_gaps(history: Record, name: str) -> NDArray[np.bool_]:
    """Return which instants of the weather signal `name` lie in a gap longer than 6 h, shape (n + 1,)."""
    time_s, values = history.time_s, getattr(history, name)
    measured = np.isfinite(values)
    if not measured.any():
        return np.ones(time_s.size, dtype=bool)
    return ~measured & (gap_s(time_s, time_s[measured]) > BRIDGED_GAP_H * HOUR_S)


def long_level_gaps(history: Record) -> NDArray[np.bool_]:
    """Return which steps lie in a gap of more than 2 h in the level of an actuator, shape (n,)."""
    return np.any([_long_gap(row, history.step_s) for row in history.u], axis=0)


def _long_gap(u: Array, step_s: float) -> NDArray[np.bool_]:
    """Which of `u` (n,) are unknown for more than 2 h together."""
    long = np.zeros(u.size, dtype=bool)
    for start, stop in stretches(~np.isfinite(u)):
        long[start:stop] = (stop - start) * step_s > BRIDGED_LEVEL_H * HOUR_S
    return long


def _of_levels(u: Array, step_s: float) -> str:
    unknown, long = ~np.isfinite(u), _long_gap(u, step_s)
    short = unknown & ~long
    words = [f"{_count(short)} ({100 * short.mean():.1f} %) between the levels around"] if short.any() else []
    words += [f"{_count(long)} ({100 * long.mean():.1f} %) filled with the mean level around"] if long.any() else []
    return " and ".join(words)


def _weather(history: Record, ahead: Boundary | None, name: str) -> tuple[Array, str]:
    """Return the signal without gaps, shape (n + 1,), and a note."""
    time_s, values = history.time_s, getattr(history, name)
    missing = ~np.isfinite(values)
    at_s, measured = time_s[~missing], values[~missing]
    if ahead is not None:
        later = np.isfinite(getattr(ahead, name)) & (ahead.time_s > (at_s[-1] if at_s.size else -np.inf))
        at_s, measured = np.append(at_s, ahead.time_s[later]), np.append(measured, getattr(ahead, name)[later])
    if not measured.size:
        raise DataError(f"history: {name} was never measured and no forecast of it is given; check the sensor")
    line = np.interp(time_s, at_s, measured)
    long = missing & (gap_s(time_s, at_s) > BRIDGED_GAP_H * HOUR_S)
    note = f"{name}: {_count(missing)} by linear interpolation"
    if long.any():
        note = f"{name}: {_count(missing)}, {long.sum()} of them from the same hour of the nearest day"
        line[long] = _same_hour(time_s[long], at_s, measured, line[long], 0.5 * history.step_s)
    return np.where(missing, line, values), note


def gap_s(time_s: Array, known_s: Array) -> Array:
    """The gap length at each of `time_s` (n,), s, between the known instants (k,) or the ends of the data."""
    after = np.searchsorted(known_s, time_s)
    ends = np.concatenate([[min(time_s[0], known_s[0])], known_s, [max(time_s[-1], known_s[-1])]])
    return np.asarray(ends[after + 1] - ends[after])


def _same_hour(time_s: Array, measured_s: Array, measured: Array, otherwise: Array, within_s: float) -> Array:
    """For each of `time_s` (n,) the value of `measured` (k,) a whole number of days away: nearest day, past first."""
    filled = np.full(time_s.size, np.nan)
    days = int(np.ceil((max(measured_s[-1], time_s[-1]) - min(measured_s[0], time_s[0])) / DAY_S)) + 1
    for day in range(1, days + 1):
        for shift_s in (-day * DAY_S, day * DAY_S):
            there = at_instants(time_s + shift_s, measured_s, measured, within_s)
            filled = np.where(np.isnan(filled), there, filled)
        if not np.isnan(filled).any():
            break
    return np.where(np.isnan(filled), otherwise, filled)


def _levels(u: Array, step_s: float) -> Array:
    """Return `u` (n,) with unknown levels interpolated up to 2 h, else the mean of those around, of all, or 0."""
    finite = np.isfinite(u)
    short = ~finite & ~_long_gap(u, step_s)
    if short.any() and finite.any():
        known = np.flatnonzero(finite)
        u = np.where(short, np.interp(np.arange(u.size), known, u[known]), u)
        finite = finite | short
    reach = steps_in(LEVELS_AROUND_H * HOUR_S, step_s)
    total = np.concatenate([[0.0], np.cumsum(np.where(finite, u, 0.0))])
    count = np.concatenate([[0], np.cumsum(finite)])
    steps = np.arange(u.size)
    first, last = np.maximum(steps - reach, 0), np.minimum(steps + reach + 1, u.size)
    near = count[last] - count[first]
    everywhere = float(u[finite].mean()) if finite.any() else 0.0
    mean = np.where(near > 0, (total[last] - total[first]) / np.maximum(near, 1), everywhere)
    return np.where(finite, u, mean)


def _count(missing: NDArray[np.bool_]) -> str:
    return counted(int(missing.sum()), "value")
