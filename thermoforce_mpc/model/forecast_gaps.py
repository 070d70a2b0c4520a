"""Filling of gaps in the forecast of the boundary conditions, so that a plan never rests on a value nobody gave.

| signal | filled, in this order |
|---|---|
| weather | interpolation up to 6 h between two values; the last whole forecast; the day before; the mean of that hour |
| prices, bounds, occupancy, emissions | the last whole forecast; the day before; the value before, or the first known |

The day before is in the record or a forecast; the last reading of the record is one end of a gap at the begin. A
weather value that cannot be (`limits`) is none. What is filled otherwise than by the last forecast is a guess
(`Boundary.guessed`), as what a source of data has filled itself, and said with its share of the plan. How far guesses
of the weather may be off (`weather_spread`) widens the band of the free forecast (`predictor`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import AT_THE_METER, CONDITIONS, DAY_S, HOUR_S, Array, Boundary, Record, steps_in
from thermoforce_mpc.data.clock import CLOCK_TOLERANCE_S, whole_hour
from thermoforce_mpc.data.limits import BRIDGED_GAP_H, RULES, outside
from thermoforce_mpc.data.series import WEATHER, at_instants, gap_s, rms

# How a source of data fills what follows a schedule.
BY_DAYS = "the same hour of the days before"
# By how many days ago the same hour is taken: a week has each day of the week.
_DAYS_BEFORE = 7
# Last days of the record that tell how far a guess of the weather may be off: two weeks, of one season still.
_SPREAD_DAYS = 14


def lengthened(boundary: Boundary, n_steps: int, step_s: float) -> Boundary:
    """`boundary`, at steps of `step_s` s, with at least `n_steps` steps; those not given have no values (NaN)."""
    missing = n_steps - boundary.n_steps
    if missing <= 0:
        return boundary
    later = boundary.time_s[-1] + step_s * np.arange(1, missing + 1)
    values: dict[str, Any] = {"time_s": np.append(boundary.time_s, later)}
    for name in (*CONDITIONS[1:], *AT_THE_METER):
        signal = getattr(boundary, name)
        if not signal.size:
            continue
        values[name] = np.concatenate([signal, np.full((*signal.shape[:-1], missing), np.nan)], axis=-1)
    values["guessed"] = {
        name: np.concatenate([rows, np.zeros((*rows.shape[:-1], missing), dtype=bool)], axis=-1)
        for name, rows in boundary.guessed.items()
    }
    return replace(boundary, **values)


def completed(boundary: Boundary, history: Record, last: Boundary | None) -> tuple[Boundary, str]:
    """`boundary` with its gaps filled, and what was filled with what, in words ('' without gaps).

    What cannot be filled from anything stays NaN. Occupancy and emissions, which need not be given, count as gaps only
    where part of them is known. `last`: the last forecast of this run that was whole.
    """
    filled: dict[str, Any] = {}
    guesses = dict(boundary.guessed)
    notes = [
        f"{boundary.names.label(name, row)} {_at(guessed)}{_share(guessed)} by {BY_DAYS}"
        for name, rows in boundary.guessed.items()
        for row, guessed in enumerate(rows)
        if name not in WEATHER and guessed.any() and not _same_price(name, row, boundary)
    ]
    for name in CONDITIONS[1:]:
        rows = np.atleast_2d(getattr(boundary, name))
        missing = ~np.isfinite(rows)
        if name in WEATHER:
            missing |= outside(rows, RULES[name].range)
        if not missing.any():
            continue
        out, made_up = np.where(missing, np.nan, rows), np.zeros_like(missing)
        for row in range(len(out)):
            if not missing[row].any():
                continue
            complete, how, made_up[row] = _row(name, row, out[row], boundary, history, last)
            if how:
                out[row] = complete
                if _same_price(name, row, boundary):
                    continue
                label = boundary.names.label(name, row) if np.ndim(getattr(boundary, name)) == 2 else name
                notes.append(f"{label} {_at(missing[row])} by {how}{_share(missing[row])}")
        filled[name] = out.reshape(np.shape(getattr(boundary, name)))
        if made_up.any():
            of_signal = made_up.reshape(np.shape(getattr(boundary, name)))
            guesses[name] = of_signal | guesses.get(name, np.zeros_like(of_signal))
    if filled:
        boundary = replace(boundary, **filled, guessed=guesses)
    return boundary, f"forecast: {', '.join(notes)}" if notes else ""


def _same_price(name: str, row: int, boundary: Boundary) -> bool:
    """Whether a row is the price of heating of a machine that has one price, which is said once."""
    if name != "heating_price_per_kWh":
        return False
    return np.array_equal(boundary.heating_price_per_kWh[row], boundary.price_per_kWh[row], equal_nan=True)


def _at(instants: NDArray[np.bool_]) -> str:
    return f"at {instants.sum()} of {instants.size} instants"


def _share(instants: NDArray[np.bool_]) -> str:
    return f" ({100 * instants.mean():.0f} % of the plan)"


def weather_spread(name: str, boundary: Boundary, history: Record) -> Array:
    """Standard deviation of what is guessed of a weather signal (N + 1,), in its unit; 0 where nothing is.

    By the record: what was missed on its last days by a straight line over so long a gap, and by the day before at that
    hour of the day. Of a record of less than two days its own standard deviation.
    """
    guessed = np.asarray(boundary.guessed.get(name, np.zeros(boundary.time_s.size, dtype=bool)))
    spread = np.zeros(guessed.size)
    values, step_s = getattr(history, name), history.step_s if history.n_steps else HOUR_S
    values = values[-round(_SPREAD_DAYS * DAY_S / step_s) :]
    time_s = history.time_s[-values.size :]
    known = values[np.isfinite(values)]
    whole_sd = float(np.std(known)) if known.size else 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], guessed, [False]]).astype(int)))
    for begin, end in edges.reshape(-1, 2):
        lasts_s = (end - begin + 1) * boundary.step_s
        if end < guessed.size and lasts_s <= BRIDGED_GAP_H * HOUR_S:
            half = steps_in(0.5 * lasts_s, step_s)
            off = values[half:-half] - 0.5 * (values[: -2 * half] + values[2 * half :])
            spread[begin:end] = _rms(off, whole_sd)
        else:
            day = round(DAY_S / step_s)
            off, hours = values[day:] - values[:-day], whole_hour(time_s[day:])
            at = whole_hour(boundary.time_s[begin:end])
            spread[begin:end] = np.array([_rms(off[hours == hour], whole_sd) for hour in range(24)])[at]
    return spread


def _rms(off: Array, otherwise: float) -> float:
    off = off[np.isfinite(off)]
    return rms(off) if off.size else otherwise


def whole(boundary: Boundary) -> bool:
    """Whether weather, bounds and prices were given at every instant."""
    if any(guessed.any() for guessed in boundary.guessed.values()):
        return False
    return all(np.isfinite(getattr(boundary, name)).all() for name in (*WEATHER, "lower_C", "upper_C", "price_per_kWh"))


def _row(
    name: str, row: int, values: Array, boundary: Boundary, history: Record, last: Boundary | None
) -> tuple[Array, str, NDArray[np.bool_]]:
    """One row (N + 1,) of a signal without gaps, the means by which they were filled, and which values nobody gave."""
    out, time_s, how = values.copy(), boundary.time_s, []
    made_up = np.zeros(values.size, dtype=bool)

    def fill(candidates: Array, by: str, *, given: bool = False) -> None:
        new = np.isnan(out) & np.isfinite(candidates)
        if new.any():
            out[new] = candidates[new]
            how.append(by)
            made_up[new] = not given

    weather = name in WEATHER
    if weather:
        fill(_between(time_s, out, history, name), "interpolation")
    # Of the record only the weather is known; of the other signals, what forecasts say of the day before.
    sources = [(time_s, out)]
    if last is not None:
        forecast = np.atleast_2d(getattr(last, name))[row]
        sources.append((last.time_s, forecast))
        hours = (time_s[0] - last.time_s[0]) / HOUR_S
        fill(
            at_instants(time_s, last.time_s, forecast, CLOCK_TOLERANCE_S),
            f"the last forecast ({hours:g} h old)",
            given=True,
        )
    if weather:
        sources.append((history.time_s, getattr(history, name)))
    for day in range(1, _DAYS_BEFORE + 1):
        for source_s, source in sources:
            if np.isnan(out).any():
                fill(
                    at_instants(time_s - day * DAY_S, source_s, source.copy(), CLOCK_TOLERANCE_S),
                    "the day before" if day == 1 else "days before",
                )
    if weather and np.isnan(out).any():
        fill(_mean_of_hour(time_s, history, name), "the mean of the record at that hour")
    finite_at = np.flatnonzero(np.isfinite(out))
    if finite_at.size and np.isnan(out).any() and name not in ("occupancy", "emission_kg_per_kWh"):
        before = np.maximum(np.searchsorted(finite_at, np.arange(out.size), side="right") - 1, 0)
        fill(out[finite_at[before]], "the value before")
    return out, " and ".join(dict.fromkeys(how)), made_up


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
    hour = whole_hour(history.time_s)
    total = np.bincount(hour[measured], weights=values[measured], minlength=24)
    count = np.bincount(hour[measured], minlength=24)
    means = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return np.asarray(means[whole_hour(time_s)])
