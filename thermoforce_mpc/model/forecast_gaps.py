"""Filling of gaps in the forecast of the boundary conditions, so that a plan never rests on a value nobody gave.

| signal | filled, in this order |
|---|---|
| weather | interpolation up to 6 h between two values; the last whole forecast; the day before; the mean of that hour |
| prices, bounds, occupancy, emissions | the last whole forecast; the day before; the value before, or the first known |

The day before is in the record or a forecast; the last reading of the record is one end of a gap at the begin. A
weather value that cannot be (`limits`) is none. Values that a source of data has filled itself (`Boundary.guessed`) are
said in the same words.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from thermoforce_mpc.data import CONDITIONS, DAY_S, HOUR_S, Array, Boundary, Record
from thermoforce_mpc.data.limits import BRIDGED_GAP_H, RULES
from thermoforce_mpc.data.series import WEATHER, at_instants, gap_s

# Instants nearer than this are the same, s.
_SAME_S = 1.0
# How a source of data fills what follows a schedule.
BY_DAYS = "the same hour of the days before"
_DAYS_BEFORE = 7


def lengthened(boundary: Boundary, n_steps: int, step_s: float) -> Boundary:
    """`boundary`, at steps of `step_s` s, with at least `n_steps` steps; those not given have no values (NaN)."""
    missing = n_steps - boundary.n_steps
    if missing <= 0:
        return boundary
    later = boundary.time_s[-1] + step_s * np.arange(1, missing + 1)
    values: dict[str, Any] = {"time_s": np.append(boundary.time_s, later)}
    for name in CONDITIONS[1:]:
        signal = getattr(boundary, name)
        values[name] = np.concatenate([signal, np.full((*signal.shape[:-1], missing), np.nan)], axis=-1)
    return replace(boundary, **values)


def completed(boundary: Boundary, history: Record, last: Boundary | None) -> tuple[Boundary, str]:
    """`boundary` with its gaps filled, and what was filled with what, in words ('' without gaps).

    What cannot be filled from anything stays NaN. Occupancy and emissions, which need not be given, count as gaps only
    where part of them is known. `last`: the last forecast of this run that was whole.
    """
    filled: dict[str, Any] = {}
    notes = [
        f"{boundary.names.label(name, row)} at {guessed.sum()} of {guessed.size} instants "
        f"({100 * guessed.mean():.0f} % of the plan) by {BY_DAYS}"
        for name, rows in boundary.guessed.items()
        for row, guessed in enumerate(rows)
        if guessed.any() and not (name == "heating_price_per_kWh" and "price_per_kWh" in boundary.guessed)
    ]
    labels: set[str] = {note.partition(" ")[0] for note in notes}
    for name in CONDITIONS[1:]:
        rows = np.atleast_2d(getattr(boundary, name))
        low, high = RULES[name].range if name in WEATHER else (-np.inf, np.inf)
        missing = ~(np.isfinite(rows) & (rows >= low) & (rows <= high))
        if not missing.any():
            continue
        out = np.where(missing, np.nan, rows)
        for row in range(len(out)):
            if not missing[row].any():
                continue
            complete, how = _row(name, row, out[row], boundary, history, last)
            if how:
                out[row] = complete
                label = boundary.names.label(name, row) if np.ndim(getattr(boundary, name)) == 2 else name
                if name == "heating_price_per_kWh" and label.replace("heating_", "", 1) in labels:
                    continue  # the same price
                labels.add(label)
                notes.append(f"{label} at {missing[row].sum()} of {missing[row].size} instants by {how}")
        filled[name] = out.reshape(np.shape(getattr(boundary, name)))
    return (replace(boundary, **filled) if filled else boundary), f"forecast: {', '.join(notes)}" if notes else ""


def whole(boundary: Boundary) -> bool:
    """Whether weather, bounds and prices were given at every instant."""
    if any(guessed.any() for guessed in boundary.guessed.values()):
        return False
    return all(np.isfinite(getattr(boundary, name)).all() for name in (*WEATHER, "lower_C", "upper_C", "price_per_kWh"))


def _row(
    name: str, row: int, values: Array, boundary: Boundary, history: Record, last: Boundary | None
) -> tuple[Array, str]:
    """One row (N + 1,) of a signal without gaps, and the means by which they were filled."""
    out, time_s, how = values.copy(), boundary.time_s, []

    def fill(candidates: Array, by: str) -> None:
        new = np.isnan(out) & np.isfinite(candidates)
        if new.any():
            out[new] = candidates[new]
            how.append(by)

    weather = name in WEATHER
    if weather:
        fill(_between(time_s, out, history, name), "interpolation")
    # Of the record only the weather is known; of the other signals, what forecasts say of the day before.
    sources = [(time_s, out)]
    if last is not None:
        forecast = np.atleast_2d(getattr(last, name))[row]
        sources.append((last.time_s, forecast))
        hours = (time_s[0] - last.time_s[0]) / HOUR_S
        fill(at_instants(time_s, last.time_s, forecast, _SAME_S), f"the last forecast ({hours:g} h old)")
    if weather:
        sources.append((history.time_s, getattr(history, name)))
    for day in range(1, _DAYS_BEFORE + 1):
        for source_s, source in sources:
            if np.isnan(out).any():
                fill(
                    at_instants(time_s - day * DAY_S, source_s, source.copy(), _SAME_S),
                    "the day before" if day == 1 else "days before",
                )
    if weather and np.isnan(out).any():
        fill(_mean_of_hour(time_s, history, name), "the mean of the record at that hour")
    finite_at = np.flatnonzero(np.isfinite(out))
    if finite_at.size and np.isnan(out).any() and name not in ("occupancy", "emission_kg_per_kWh"):
        before = np.maximum(np.searchsorted(finite_at, np.arange(out.size), side="right") - 1, 0)
        fill(out[finite_at[before]], "the value before")
    return out, " and ".join(dict.fromkeys(how))


def _between(time_s: Array, values: Array, history: Record, name: str) -> Array:
    """Values (n,) with gaps of up to 6 h between two known ones filled by a straight line, from the last reading on."""
    known = np.isfinite(values)
    known_s, levels = time_s[known], values[known]
    measured = np.flatnonzero(np.isfinite(getattr(history, name)) & (history.time_s <= time_s[0]))
    if measured.size and known_s.size and history.time_s[measured[-1]] < known_s[0]:
        known_s = np.append(history.time_s[measured[-1]], known_s)
        levels = np.append(getattr(history, name)[measured[-1]], levels)
    if known_s.size < 2:
        return values
    line = np.interp(time_s, known_s, levels)
    inside = (time_s >= known_s[0]) & (time_s < known_s[-1])
    return np.where(inside & (gap_s(time_s, known_s) <= BRIDGED_GAP_H * HOUR_S), line, values)


def _mean_of_hour(time_s: Array, history: Record, name: str) -> Array:
    """Mean of the record at the hour of the day of each instant (n,); NaN where it was never measured then."""
    values = getattr(history, name)
    measured = np.isfinite(values)
    hour = (history.time_s % DAY_S // HOUR_S).astype(int)
    total = np.bincount(hour[measured], weights=values[measured], minlength=24)
    count = np.bincount(hour[measured], minlength=24)
    means = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return np.asarray(means[(time_s % DAY_S // HOUR_S).astype(int)])
