"""An open window: its contact says so, or the room falls as steeply as it does not by itself.

For half an hour the room needs neither heat nor cooling then, and its readings teach nothing (they count as not
measured, and the model stands in). Its bounds are those of an empty house over the whole plan: with those of later in
it, a plan heats ahead for them, out of the window. It is taken back sooner where the room comes back or the contact
closes, and at the latest after two hours, from when on the cold room counts as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Boundary, Layout, Record, steps_in
from thermoforce_mpc.records.people import AWAY_C

# What thermostats of radiators pause for, and for how long an open contact counts, s.
PAUSE_S, _LONGEST_S = 1800.0, 7200.0
# A steep fall: in 15 min by so much below all of the last hour, K, and by so many times what steps in which nothing was
# turned down bring (but for a share of 0.03 of them); outdoors so much colder, K. A room that usually falls by more
# than this, K in 15 min, also falls that much for other reasons (an office of air units where its people go home).
_LEAST_K, _TIMES, _USUAL, _COLDER_K, _LIGHT_K = 0.5, 2.5, 0.97, 5.0, 0.25
_STEP_S = 900.0
# Turned down against the step before, or the mean of so long before, h: by so much, or to less than half. An air unit
# holds a light room by a level of 0.05, and one that begins to cool takes 1.3 K from it by 0.03 (`bench detectors`,
# seed 640401, 2026-11-29). Levels this small are rounding.
_DOWN, _BEFORE_H, _ROUNDING = 0.05, 2.0, 0.005
# It comes back: by this share of the fall. Least steps from which a usual fall is known: two days of 15 min.
_BACK, _LEAST_STEPS = 0.4, 192


@dataclass(frozen=True)
class OpenWindow:
    """A window of a room that is open since `since_s`, and the room's readings until `until_s` do not count; s on the
    clock of the record, and `why` in words.
    """

    since_s: float
    until_s: float
    why: str


def steep_falls(T_C: Array, T_out_C: Array, u: Array, step_s: float) -> tuple[NDArray[np.bool_], float]:
    """Steps (n,) in which a room fell steeply, and from which fall on that is, K a step (infinite: not known).

    `T_C`, `T_out_C` (n + 1,), °C; `u` (A, n): levels of what acts there, those that cool below 0.
    """
    fall = -np.diff(T_C)
    hour, back = max(2, round(HOUR_S / step_s)), steps_in(_BEFORE_H * HOUR_S, step_s)
    if fall.size <= max(hour, back):
        return np.zeros(fall.size, dtype=bool), float("inf")
    below = np.full(fall.size, np.nan)  # what was the coldest of the last hour until now
    below[hour:] = np.lib.stride_tricks.sliding_window_view(T_C[:-1], hour + 1).min(axis=1) - T_C[hour + 1 :]
    more = below - np.maximum(np.concatenate([[np.nan], fall[:-1]]), 0.0)  # one that cools by itself falls ever less
    down = np.zeros(fall.size, dtype=bool)
    for level in u:
        sums = np.cumsum(np.concatenate([np.zeros(back), np.nan_to_num(level)]))
        before = (sums[back - 1 : -1] - np.concatenate([[0.0], sums[: -back - 1]])) / back
        last = np.concatenate([level[:1], level[:-1]])
        usual_u = np.fmax(before, last)
        less = np.clip(0.5 * np.abs(usual_u), _ROUNDING, _DOWN)
        down |= ~(level >= usual_u - less)  # also where it is not known
    down[:back] = True
    by_itself = np.isfinite(fall) & ~down
    if by_itself.sum() < _LEAST_STEPS * min(_STEP_S / step_s, 1.0):
        return np.zeros(fall.size, dtype=bool), float("inf")
    usual = float(np.quantile(np.maximum(fall[by_itself], 0.0), _USUAL))
    if usual > _LIGHT_K * step_s / _STEP_S:
        return np.zeros(fall.size, dtype=bool), float("inf")
    limit = max(_LEAST_K * max(step_s / _STEP_S, 1.0), _TIMES * usual)
    with np.errstate(invalid="ignore"):
        steep = by_itself & (more > limit) & (T_C[:-1] - T_out_C[:-1] > _COLDER_K)
    return steep, limit


def open_windows(record: Record, layout: Layout, contacts: Mapping[str, Array] | None = None) -> dict[int, OpenWindow]:
    """Rooms by number whose window is open at the end of a record; `contacts` (n + 1,): above 0.5 open, by room."""
    found, now_s = {}, float(record.time_s[-1])
    for z, name in enumerate(record.names.zones):
        contact = (contacts or {}).get(name)
        if contact is not None and np.isfinite(contact[-1]):
            window = _by_contact(record.time_s, contact)
        else:
            window = _by_fall(record, layout, z, now_s)
        if window is not None and now_s < window.until_s:
            found[z] = window
    return found


def without(record: Record, windows: Mapping[int, OpenWindow]) -> Record:
    """The record without what rooms with an open window read since."""
    T_C = np.array(record.T_zone_C)
    for z, window in windows.items():
        T_C[z, record.time_s > window.since_s + 1.0] = np.nan
    return replace(record, T_zone_C=T_C) if windows else record


def as_if_empty(ahead: Boundary, windows: Mapping[int, OpenWindow]) -> Boundary:
    """The boundary conditions with the bounds of an empty house in rooms with an open window."""
    lower_C, upper_C, open_ones = np.array(ahead.lower_C), np.array(ahead.upper_C), list(windows)
    lower_C[open_ones] = np.minimum(lower_C[open_ones], AWAY_C[0])
    upper_C[open_ones] = np.maximum(upper_C[open_ones], AWAY_C[1])
    return replace(ahead, lower_C=lower_C, upper_C=upper_C) if windows else ahead


def _by_contact(time_s: Array, contact: Array) -> OpenWindow | None:
    if not contact[-1] > 0.5:
        return None
    shut = np.flatnonzero(~(contact > 0.5))
    since_s = float(time_s[shut[-1]] if shut.size else time_s[0])
    return OpenWindow(since_s, since_s + _LONGEST_S, "a window is open")


def _by_fall(record: Record, layout: Layout, z: int, now_s: float) -> OpenWindow | None:
    T_C, acting = record.T_zone_C[z], list(layout.actuators_of(z))
    u = record.u[acting] * np.array([layout.signs[a] for a in acting])[:, None]
    steep, limit = steep_falls(T_C, record.T_out_C, u, record.step_s)
    lately = np.flatnonzero(steep & (record.time_s[1:] > now_s - PAUSE_S + 1.0))
    if not lately.size:
        return None
    first, last = int(lately[0]), int(lately[-1])
    fall = float(T_C[first] - np.nanmin(T_C[first + 1 :]))
    if T_C[-1] - np.nanmin(T_C[first + 1 :]) > _BACK * fall:
        return None
    minutes = record.step_s / 60.0
    step_K = float(T_C[last] - T_C[last + 1])
    why = f"it fell {step_K:.1f} K in {minutes:g} min ({limit:.1f} K are steep): a window is probably open"
    return OpenWindow(float(record.time_s[first]), float(record.time_s[last + 1]) + PAUSE_S, why)
