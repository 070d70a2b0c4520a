"""Signals of a table at the steps of its record: units, rules, resampling, and a summary of each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.data.limits import SignalRule
from thermoforce_mpc.data.series import stretches
from thermoforce_mpc.errors import counted
from thermoforce_mpc.measurements.map.entries import COUNTER, PER_STEP, Irradiance, Power, Signal, converted
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.map.starting_map import kind_of
from thermoforce_mpc.measurements.tables.clock import Timed
from thermoforce_mpc.measurements.tables.readings import (
    EXCURSION_S,
    PRICE,
    SOLAR,
    Flag,
    Readings,
    around,
    durations_s,
    held,
    longest_s,
    means,
    sampled,
    screened,
    usual_s,
    with_map,
)
from thermoforce_mpc.measurements.understood import SignalSummary

# A counter that rises by this many times the 99th percentile of its rises did not count energy.
_UNUSUAL = 10.0


class SignalReader:
    """Reads signals of `table`, whose rows stand at `time_s` (n,), at the boundaries `grid_s` of the steps.

    `summaries` collects what was read. Without `refuse` a signal that is mostly out of range is not measured.
    """

    def __init__(
        self,
        table: Timed,
        time_s: Array,
        grid_s: Array,
        step_s: float,
        rules: MeasurementMap,
        *,
        refuse: bool = True,
    ) -> None:
        self.grid_s, self.summaries, self._refuse = grid_s, list[SignalSummary](), refuse
        self._table, self._time_s, self._step_s = table, time_s, step_s
        self._marks, self._coverage = rules.time.marks, rules.coverage

    def sampled(self, key: str, signal: Signal, rules: SignalRule) -> Array:
        """A signal at the boundaries (n + 1,)."""
        readings, unit, flags = self._readings(key, signal, rules)
        return self._summarised(key, signal, unit, readings, sampled(readings, self.grid_s), flags)

    def irradiance(self, signal: Irradiance) -> Array:
        """Irradiance at the boundaries (n + 1,), W/m²."""
        readings, unit, flags = self._readings("sun", signal, SOLAR)
        values = around(readings, self.grid_s, self._step_s, self._coverage)
        return self._summarised("sun", signal, unit, readings, values, flags)

    def scheduled(self, key: str, source: float | Signal | None, rules: SignalRule) -> Array:
        """A bound or price at the boundaries (n + 1,): a number, the last reading of a column, or NaN for None."""
        if not isinstance(source, Signal):
            return np.full(self.grid_s.size, np.nan if source is None else float(source))
        readings, unit, flags = self._readings(key, source, rules)
        return self._summarised(key, source, unit, readings, held(readings, self.grid_s), flags)

    def price(self, key: str, source: float | Signal | None) -> Array:
        """A price at the boundaries (n + 1,): the mean over the step that begins there, as `scheduled`."""
        if not isinstance(source, Signal):
            return self.scheduled(key, source, PRICE)
        readings, unit, flags = self._readings(key, source, PRICE)
        values = held(readings, self.grid_s)
        if readings.values.size > 1 and self.grid_s.size > 1:
            lasts = durations_s(readings.time_s, readings.longest_s, "start")
            edges = np.append(self.grid_s, self.grid_s[-1] + self._step_s)
            over_step = means(readings.time_s, lasts, readings.values, edges, self._coverage)
            values = np.where(np.isfinite(over_step), over_step, values)
        return self._summarised(key, source, unit, readings, values, flags)

    def mean(self, key: str, signal: Signal | None, rules: SignalRule) -> Array:
        """Means of a signal over the steps (n,); NaN where it is not measured."""
        if signal is None:
            return np.full(self.grid_s.size - 1, np.nan)
        readings, unit, flags = self._readings(key, signal, rules)
        lasts = durations_s(readings.time_s, readings.longest_s, self._marks) if readings.values.size else np.empty(0)
        starts = readings.time_s - (lasts if self._marks == "end" else 0.0)
        values = means(starts, lasts, readings.values, self.grid_s, self._coverage)
        return self._summarised(key, signal, unit, readings, values, flags)

    def again(self, signal: Signal, rules: SignalRule) -> Array:
        """Means over the steps (n,) of a signal that is read as `scheduled` too: it holds until the next reading."""
        readings, _, _ = self._readings("", signal, rules)
        if not readings.values.size:
            return np.full(self.grid_s.size - 1, np.nan)
        ends = np.append(readings.time_s[1:], max(self.grid_s[-1], readings.time_s[-1]))
        lasts = np.minimum(ends - readings.time_s, readings.longest_s)
        return means(readings.time_s, lasts, readings.values, self.grid_s, self._coverage)

    def _readings(self, key: str, signal: Signal, rules: SignalRule) -> tuple[Readings, SignalRule, tuple[Flag, ...]]:
        """The readings of a signal that hold, in the unit inside, its rules, and what was flagged."""
        declared = getattr(signal, "unit", "")
        rules = with_map(rules, signal)
        raw = np.sum([self._table.columns[column] for column in signal.columns], axis=0) * signal.factor
        values, time_s = converted(raw, declared) if declared else np.asarray(raw), self._time_s
        if declared.endswith(PER_STEP):
            values = values / _intervals_s(time_s, np.isfinite(values), signal.hold_h, self._marks)
        flags: list[Flag] = []
        if (endless := np.isinf(values)).any():
            flags.append(Flag("range", int(endless.sum()), f"an infinite one at {self._at(int(np.argmax(endless)))}"))
        finite = np.isfinite(values)
        values, time_s, raw = values[finite], time_s[finite], raw[finite]
        if declared.endswith(COUNTER) and values.size > 1:
            values, time_s, raw, of_counter = _from_counter(values, time_s, raw, self._marks, self._when)
            flags += of_counter
        name = f"{key} (column {' + '.join(signal.columns)})"
        if values.size:
            holds, flagged = screened(
                time_s, values, raw, rules, name, declared or rules.unit, self._at, refuse=self._refuse
            )
            values, time_s = values[holds], time_s[holds]
            flags += flagged
        return Readings(time_s, values, longest_s(time_s, self._step_s, signal.hold_h)), rules, tuple(flags)

    def _at(self, row: int) -> str:
        return str(self._table.index[row])

    def _when(self, at_s: float) -> str:
        return self._at(int(np.searchsorted(self._time_s, at_s)))

    def _summarised(
        self, key: str, signal: Signal, rules: SignalRule, readings: Readings, values: Array, flags: tuple[Flag, ...]
    ) -> Array:
        finite = np.isfinite(values)
        least, median, most = (
            np.quantile(values[finite], (0.0, 0.5, 1.0)).tolist() if finite.any() else (float("nan"),) * 3
        )
        doubt = _doubt(signal, rules, readings, median, most) if finite.any() else "never measured: check the column"
        longest_gap = max((stop - start for start, stop in stretches(~finite)), default=0)
        self.summaries.append(
            SignalSummary(
                key,
                key,
                " + ".join(signal.columns),
                rules.unit,
                int(readings.values.size),
                usual_s(readings.time_s),
                float(finite.mean()),
                longest_gap * self._step_s / HOUR_S,
                least,
                median,
                most,
                flags,
                doubt,
                float(readings.time_s[-1]) if readings.time_s.size else float("nan"),
            )
        )
        return values


def _doubt(signal: Signal, rules: SignalRule, readings: Readings, median: float, most: float) -> str:
    """What is odd about readings that were accepted, '' if nothing."""
    if isinstance(signal, Power) and "unit" not in signal.model_fields_set and "energy" in map(kind_of, signal.columns):
        return "read as W, and its name says energy: name the unit (W, Wh per step, kWh counter, …)"
    if rules.kind == "temperature" and not rules.usual[0] <= median <= rules.usual[1]:
        return f"a median of {median:.1f} °C is unusual: check the unit"
    if rules.kind == "level" and 0.0 < most < rules.usual[0]:
        return f"never above {most:.3g}: check the unit, 0-1 is likelier than %"
    changes = np.diff(readings.values)[np.diff(readings.time_s) <= readings.longest_s]
    jumps = np.abs(changes) > rules.spike
    if jumps.any():
        return (
            f"{counted(int(jumps.sum()), 'jump')}, the largest of {np.abs(changes).max():.3g} {rules.unit} between two "
            "readings, without coming back: was the sensor moved or exchanged? use the part before or after"
        )
    return ""


def _intervals_s(time_s: Array, measured: NDArray[np.bool_], hold_h: float | None, marks: str) -> Array:
    """Lengths (n,) of the intervals of energies that stand at the rows `time_s` (n,) where they are `measured`, s.

    An interval reaches from row to row where cells beside are empty by chance, and from reading to reading where other
    columns have rows of their own: of both what is nearer to the column's usual distance.
    """
    rows = durations_s(time_s, longest_s(time_s, 0.0, hold_h), marks)
    read_s = time_s[measured]
    if read_s.size < 2:
        return rows
    own, usual = durations_s(read_s, longest_s(read_s, 0.0, hold_h), marks), usual_s(read_s)
    rows[measured] = np.where(np.abs(own - usual) < np.abs(rows[measured] - usual), own, rows[measured])
    return rows


def _from_counter(
    values: Array, time_s: Array, raw: Array, marks: str, at: Callable[[float], str]
) -> tuple[Array, Array, Array, list[Flag]]:
    """Mean power between readings of a counter, W, at the stamps that mark its intervals; and what was flagged.

    A reading that falls below the one before and comes back at once is none, since a counter that begins anew climbs as
    slowly as before. A rise of more than 10 times what the machine takes at most is no energy.
    """
    flags: list[Flag] = []

    def flag(wrong: NDArray[np.bool_], instants_s: Array, what: str) -> None:
        if wrong.any():
            words = f"{what}, first at {at(float(instants_s[int(np.argmax(wrong))]))}"
            flags.append(Flag("counter", int(wrong.sum()), words))

    fell = _fell_and_came_back(values, time_s)
    flag(fell, time_s, "readings that fell below the one before and came back")
    values, time_s, raw = values[~fell], time_s[~fell], raw[~fell]
    amount, lasts = np.diff(values), np.diff(time_s)
    back = amount < 0.0
    flag(back, time_s[1:], "readings below the one before: a reset or a new meter")
    # Readings that came late, in a burst, rise by no more than in the usual time.
    load = amount / np.maximum(lasts, usual_s(time_s))
    positive = load[load > 0.0]
    most = _UNUSUAL * float(np.percentile(positive, 99.0, method="lower")) if positive.size else np.inf
    jumped = load > most
    flag(jumped, time_s[1:], f"rises of more than {_UNUSUAL:g} times the usual largest: a new meter or a wrong reading")
    sound = ~back & ~jumped
    stamps_s = time_s[1:] if marks == "end" else time_s[:-1]
    return (amount / lasts)[sound], stamps_s[sound], raw[1:][sound], flags


def _fell_and_came_back(values: Array, time_s: Array) -> NDArray[np.bool_]:
    """Which readings of a counter (n,) lie below an earlier one to which it returns in one rise within 6 h."""
    away = np.zeros(values.size, dtype=bool)
    for i in np.flatnonzero(np.diff(values) < 0.0):
        if away[i]:
            continue
        fall = values[i] - values[i + 1]
        for k in range(i + 2, int(np.searchsorted(time_s, time_s[i] + EXCURSION_S, side="right"))):
            if values[k] >= values[i] and values[k] - values[k - 1] >= fall:
                away[i + 1 : k] = True
                break
    return away
