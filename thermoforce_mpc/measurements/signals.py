"""Signals of a table at the steps of its record: units, rules, resampling; and what was understood of them.

That is period, step, signals with gaps and flags, and assumptions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Boundary, Record
from thermoforce_mpc.data.limits import EXCURSION_S, SignalRule, codes_of_none
from thermoforce_mpc.data.prices import currency_of, price_doubt
from thermoforce_mpc.data.series import stretches
from thermoforce_mpc.errors import counted
from thermoforce_mpc.measurements.map.mapping import (
    Irradiance,
    MeasurementMap,
    Power,
    Signal,
)
from thermoforce_mpc.measurements.map.names import tags
from thermoforce_mpc.measurements.readings import (
    PRICE,
    SOLAR,
    Flag,
    SignalReadings,
    around,
    durations_s,
    ends_s,
    held,
    held_means,
    longest_s,
    looks_like_setpoints,
    means,
    sampled,
    screened,
    stored_on_change,
    usual_s,
    with_map,
)
from thermoforce_mpc.measurements.tables.clock import Timed
from thermoforce_mpc.measurements.units import COUNTER, PER_STEP, converted

# About three days: a table of three has a step less.
_ABOUT_THREE_DAYS_H = 70.0


@dataclass(frozen=True)
class SignalSummary:
    """One signal: `name` as in the record, map `key`, `source` (columns or estimate) and declared unit.

    `readings`: how many; `usual_s`: usual time between them, s; `measured`: share of the record's values that are
    known; `longest_gap_h`: longest stretch of unknown ones, h; `least`, `median`, `most` in `unit`; `flags`: what the
    rules refused; `doubt`: what looks odd, '' if nothing; `newest_s`: time of the newest reading that holds, s.
    """

    name: str
    key: str
    source: str
    unit: str
    readings: int
    usual_s: float
    measured: float
    longest_gap_h: float
    least: float
    median: float
    most: float
    flags: tuple[Flag, ...] = ()
    doubt: str = ""
    newest_s: float = float("nan")


@dataclass(frozen=True)
class Understood:
    """Report on a table: files and rows read, period, time zone ('' for none), distance of rows and step, signals.

    `assumed`: what was decided by rule, in words. `missing`: what the table does not hold, and what follows. `beside`:
    rooms that it holds and the map does not name.
    """

    files: tuple[str, ...]
    rows: int
    begins: str
    ends: str
    days: float
    zone: str
    rows_every_s: float
    step_s: float
    signals: tuple[SignalSummary, ...]
    assumed: tuple[str, ...]
    missing: tuple[str, ...]
    beside: tuple[str, ...] = ()

    def doubts_in_words(self) -> list[str]:
        """Which readings count as not measured, and what is doubtful of a signal."""
        found = []
        for signal in self.signals:
            for flag in signal.flags:
                found.append(f"flagged in {signal.key}: {flag.count} by rule '{flag.rule}', first {flag.first}")
            if signal.doubt:
                found.append(f"doubtful: {signal.key}: {signal.doubt}")
        return found

    def to_json(self) -> dict[str, Any]:
        """All fields as JSON values; None for what is not known."""
        content: dict[str, Any] = _finite(asdict(self))
        return content


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def of_clock(zone: str, rows_every_s: float, step_s: float, *, by_hour: bool) -> list[str]:
    """What is assumed about clock and step, in words; `by_hour`: the map has comfort bounds by the hour."""
    notes = [] if zone else ["the time stamps have no time zone (time.zone): every day is taken to have 24 h"]
    if zone == "UTC" and by_hour:
        notes.append(
            "hours of comfort are of UTC (time.zone), not the building's clock: name its zone, and hours of it"
        )
    if rows_every_s > step_s * 1.01:
        notes.append(
            f"rows come every {rows_every_s / 60.0:g} min, the step is {step_s / 60.0:g} min: fast effects are not seen"
        )
    return notes


def of_changes(on_change: Sequence[str]) -> list[str]:
    """What is assumed of signals that are stored when they change, in words."""
    keys = ", ".join(dict.fromkeys(on_change))
    return [f"stored only when they change, so a reading holds until the next one: {keys} (hold_h)"] if keys else []


def missing(rules: MeasurementMap, record: Record, conditions: Boundary) -> tuple[str, ...]:
    """What the table does not hold, and what follows."""
    notes = []
    if not rules.actuators:
        notes.append("no actuator: nothing can be said about the effect of acting")
    if rules.sun is None:
        notes.append("no irradiance (sun): the sun counts as a disturbance; sun.estimate makes one from the clear sky")
    for m, machine in enumerate(record.names.machines):
        if not np.isfinite(record.power_W[m]).any():
            notes.append(f"no power of {machine} (machines.{machine}.power): nothing can be planned for it")
        if not np.isfinite(conditions.price_per_kWh[m]).any():
            notes.append(f"no price of {machine} (machines.{machine}.price): a plan needs one, here or in the forecast")
    for z, zone in enumerate(record.names.zones):
        if not np.isfinite(conditions.lower_C[z]).any() or not np.isfinite(conditions.upper_C[z]).any():
            notes.append(f"no comfort bounds of {zone} (lower, upper): a plan needs them, here or in the forecast")
    hours = record.n_steps * record.step_s / HOUR_S
    if hours < _ABOUT_THREE_DAYS_H:
        notes.append(f"only {hours:.0f} h: a model needs about three days of probing or weeks of operation")
    return tuple(notes)


# A counter is coarse that steps at less than this share of its readings, so often at least, by a power of ten (within a
# thousandth), and mostly (share) by its least step: of whole kWh, read every 10 min, that is so of 1 to 4 kW. It rested
# before a step that took so many times what the next one did (simulated heat meter of 28 November 2026: 2.5, 4 and 6
# times err by 633, 613 and 608 W, differences by 1,440 W).
_OFTEN, _LEAST_STEPS, _ROUND, _MOSTLY, _ONE_STEP, _RESTED = 0.7, 8, 1e-3, 0.5, 1.1, 4.0
# A meter of energy that tells this many times the 99th percentile of what it tells, and more than so many times the
# kilowatt that any home's machine takes, did not count it. Of a machine that nearly always rests the percentile is its
# standby: where there are fewer than 100 loads, or three that differ lie beyond that, it is 1000 times. By judgement;
# codes for no reading, such as 65535 kWh, are alike and lie beyond both.
_UNUSUAL, _A_MACHINE_W = 10.0, 1000.0
_FEW_LOADS, _RUNS, _UNUSUAL_OF_RARE = 100, 3, 1000.0
# Codes of a power: from the least limit of 16 bits, in tenths, on; 85 and 999 W are what machines take.
_LEAST_CODE = 3276.7
# A signal of so few readings, of a table with so many rows for each of them, is stored when it changes.
_FEW, _ROWS_BESIDE = 8, 5


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
        refuse: bool,
    ) -> None:
        self.grid_s, self.summaries, self._refuse = grid_s, list[SignalSummary](), refuse
        self._table, self._time_s, self._step_s = table, time_s, step_s
        self._marks, self._coverage = rules.time.marks, rules.coverage
        self.on_change: list[str] = []
        self.coarse: list[str] = []

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
        if readings.values.size and self.grid_s.size > 1:
            lasts = self._lasts_s(readings, "start")
            values = held_means(readings, lasts, self.grid_s, self._step_s, self._coverage)
        else:
            values = held(readings, self.grid_s)
        return self._summarised(key, source, unit, readings, values, flags)

    def _lasts_s(self, readings: SignalReadings, marks: str) -> Array:
        """See `durations_s`; a reading that holds for ever lasts beyond the end of the record."""
        if not readings.values.size:
            return np.empty(0)
        return np.minimum(durations_s(readings, marks), max(self.grid_s[-1], self._time_s[-1]) + self._step_s)

    def _marks_of(self, signal: Signal) -> str:
        """Which end of an interval the stamps of a signal mark, by its file."""
        return self._table.marks.get(signal.columns[0], self._marks)

    def mean(self, key: str, signal: Signal | None, rules: SignalRule) -> Array:
        """Means of a signal over the steps (n,); NaN where it is not measured."""
        if signal is None:
            return np.full(self.grid_s.size - 1, np.nan)
        readings, unit, flags = self._readings(key, signal, rules)
        marks = self._marks_of(signal)
        lasts = self._lasts_s(readings, marks)
        starts = readings.time_s - (lasts if marks == "end" else 0.0)
        values = means(starts, lasts, readings.values, self.grid_s, self._coverage)
        return self._summarised(key, signal, unit, readings, values, flags)

    def again(self, signal: Signal, rules: SignalRule) -> Array:
        """Means over the steps (n,) of a signal that is read as `scheduled` too: it holds until the next reading."""
        readings, _, _ = self._readings("", signal, rules)
        return means(readings.time_s, self._lasts_s(readings, "start"), readings.values, self.grid_s, self._coverage)

    def _readings(
        self, key: str, signal: Signal, rules: SignalRule
    ) -> tuple[SignalReadings, SignalRule, tuple[Flag, ...]]:
        """The readings of a signal that hold, in the unit inside, its rules, and what was flagged."""
        declared = getattr(signal, "unit", "")
        rules = with_map(rules, signal)
        flags: list[Flag] = []
        of_power = rules.kind == "power" and not declared.endswith((PER_STEP, COUNTER))
        raw, time_s = self._raw(signal, flags if of_power else None)
        raw = raw * signal.factor
        values = converted(raw, declared) if declared else raw
        if declared.endswith(PER_STEP):
            values = values / _intervals_s(time_s, np.isfinite(values), signal.hold_h, self._marks_of(signal))
        if (endless := np.isinf(values)).any():
            row = time_s[int(np.argmax(endless))]
            flags.append(Flag("range", int(endless.sum()), f"an infinite one at {self._when(row)}"))
        finite = np.isfinite(values)
        own = all(column in self._table.own for column in signal.columns)
        breaks_s = time_s[np.isnan(values)] if own else np.empty(0)
        values, time_s, raw = values[finite], time_s[finite], raw[finite]
        is_counter = declared.endswith(COUNTER)
        stored_s = time_s
        if declared.endswith(PER_STEP) and (wrong := _unusual(values)).any():
            first = self._when(float(time_s[int(np.argmax(wrong))]))
            words = f"energies of more than {_UNUSUAL:g} times the usual largest: wrong readings, first at {first}"
            flags.append(Flag("energy", int(wrong.sum()), words, (), float(time_s[wrong][-1])))
            values, time_s, raw = values[~wrong], time_s[~wrong], raw[~wrong]
        if is_counter and values.size > 1:
            if step := _step_of(raw):
                self.coarse.append(
                    f"{key} (column {' + '.join(signal.columns)}): a counter in steps of {step:.3g} is read more often "
                    "than it steps: taken as even from step to step, so that short runs are not seen"
                )
            values, time_s, raw, of_counter = _from_counter(
                values, time_s, raw, self._marks_of(signal), self._when, coarse=step > 0.0
            )
            flags += of_counter
        name = f"{key} (column {' + '.join(signal.columns)})"
        longest = longest_s(time_s, self._step_s, signal.hold_h)
        ends, holds = ends_s(time_s, longest, breaks_s), signal.hold_h is not None
        if holds and time_s.size > 1:  # of what stays away for longer nobody knows how long it held
            gone = np.flatnonzero(np.diff(time_s) > longest)
            ends[gone] = np.minimum(ends[gone], time_s[gone] + usual_s(time_s))
        if signal.hold_h is None and not declared.endswith(PER_STEP):
            stored = self._stored_on_change(time_s, values, breaks_s, longest, rules, own=own)
            if is_counter:  # power between two readings is known until the later one
                stored = None if stored_s.size < 2 else np.append(time_s[1:], time_s[-1:] + longest)
                stored = np.maximum(ends, stored) if own and stored is not None and values.size else None
            if stored is not None:
                ends, holds = stored, not is_counter
                self.on_change += [] if is_counter else [key]
        if values.size:
            believed, flagged = screened(
                time_s, values, raw, rules, name, declared or rules.unit, lambda row: self._when(time_s[row]),
                refuse=self._refuse,
            )  # fmt: skip
            values, time_s, ends = values[believed], time_s[believed], ends[believed]
            flags += flagged
        return SignalReadings(time_s, values, ends, holds), rules, tuple(flags)

    def _raw(self, signal: Signal, of_power: list[Flag] | None) -> tuple[Array, Array]:
        """Readings (n,) of a signal in its unit, and their instants, s; of columns apart the sum of what holds.

        Of a power codes for no reading are left out of each column, which a flag in `of_power` says.
        """
        table, names = self._table, signal.columns
        apart = any(name in table.own for name in names)
        columns, codes = list[tuple[Array, Array]](), dict[float, float]()
        for name in names:
            values, time_s = table.columns[name], self._seconds(table.at(name)) if apart else self._time_s
            if of_power is not None and (coded := _codes(values)).any():
                codes |= dict(zip(time_s[coded].tolist(), values[coded].tolist(), strict=True))
                values = np.where(coded, np.nan, values)
                if apart:  # NaN says there that it was not available from then on
                    values, time_s = values[~coded], time_s[~coded]
            columns.append((values, time_s))
        if of_power is not None and codes:
            words = f"{codes[min(codes)]:g} at {self._when(min(codes))}"
            of_power.append(Flag("code for no reading", len(codes), words, (), max(codes)))
        if not apart:
            return np.sum([values for values, _ in columns], axis=0), self._time_s
        if len(names) == 1:
            return columns[0]
        every = np.unique(np.concatenate([time_s for _, time_s in columns]))
        total = np.zeros(every.size)
        for values, time_s in columns:
            last = np.searchsorted(time_s, every, side="right")
            total += np.append(np.nan, values)[last]
        return total, every

    def _seconds(self, index: pd.DatetimeIndex) -> Array:
        apart = (index - self._table.index[0]).total_seconds().to_numpy()
        return np.asarray(self._time_s[0] + apart)

    def _stored_on_change(
        self, time_s: Array, values: Array, breaks_s: Array, longest: float, rules: SignalRule, *, own: bool
    ) -> Array | None:
        """See `stored_on_change`; a signal of few readings is one where other columns have rows between them."""
        most_s = {"temperature": max(rules.stuck_h, 24.0) * HOUR_S, "irradiance": 24.0 * HOUR_S}.get(rules.kind, np.inf)
        found = stored_on_change(time_s, values, breaks_s, longest, most_s)
        if found is not None or not values.size:
            return found
        few = values.size <= _FEW and (np.diff(values) != 0.0).all()
        within = int(((self._time_s >= time_s[0]) & (self._time_s <= time_s[-1])).sum())
        if few and (own or (values.size > 1 and within >= _ROWS_BESIDE * (values.size - 1))):
            return ends_s(time_s, most_s, breaks_s)
        return None

    def _at(self, row: int) -> str:
        return str(self._table.index[row])

    def _when(self, at_s: float) -> str:
        return self._at(min(int(np.searchsorted(self._time_s, at_s)), self._time_s.size - 1))

    def _summarised(
        self,
        key: str,
        signal: Signal,
        rules: SignalRule,
        readings: SignalReadings,
        values: Array,
        flags: tuple[Flag, ...],
    ) -> Array:
        finite = np.isfinite(values)
        least, median, most = (
            np.quantile(values[finite], (0.0, 0.5, 1.0)).tolist() if finite.any() else (float("nan"),) * 3
        )
        doubt = _doubt(signal, rules, readings, median, most) if finite.any() else "never measured: check the column"
        in_percent = rules.kind == "level" and getattr(signal, "unit", "") == "%"
        if finite.any() and in_percent and looks_like_setpoints(100.0 * readings.values / signal.factor):
            doubt = "these look like set-points in °C or °F, and a set-point is no level: name what the machine did"
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


def _doubt(signal: Signal, rules: SignalRule, readings: SignalReadings, median: float, most: float) -> str:
    """What is odd about readings that were accepted, '' if nothing."""
    if (
        isinstance(signal, Power)
        and "unit" not in signal.model_fields_set
        and any("energy" in tags(name) for name in signal.columns)
    ):
        return "read as W, and its name says energy: name the unit (W, Wh per step, kWh counter, …)"
    if rules.kind == "temperature" and not rules.usual[0] <= median <= rules.usual[1]:
        return f"a median of {median:.1f} °C is unusual: check the unit"
    if rules.kind == "level" and 0.0 < most < rules.usual[0]:
        return f"never above {most:.3g}: check the unit, 0-1 is likelier than %"
    if rules.kind == "price" and (doubt := price_doubt(readings.values, currency_of(signal.columns[0]))):
        return f"{doubt} Set unit: per MWh or cent per kWh, or a factor"
    changes = np.diff(readings.values)[readings.reaches]
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
    rows = _lasting_s(time_s, hold_h, marks)
    read_s = time_s[measured]
    if read_s.size < 2:
        return rows
    own, usual = _lasting_s(read_s, hold_h, marks), usual_s(read_s)
    rows[measured] = np.where(np.abs(own - usual) < np.abs(rows[measured] - usual), own, rows[measured])
    return rows


def _lasting_s(time_s: Array, hold_h: float | None, marks: str) -> Array:
    longest = longest_s(time_s, 0.0, hold_h)
    return durations_s(SignalReadings(time_s, time_s, ends_s(time_s, longest, np.empty(0))), marks)


def _from_counter(
    values: Array, time_s: Array, raw: Array, marks: str, at: Callable[[float], str], *, coarse: bool
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
    jumped = _unusual(load)
    flag(jumped, time_s[1:], f"rises of more than {_UNUSUAL:g} times the usual largest: a new meter or a wrong reading")
    sound = ~back & ~jumped
    if coarse:
        anew = np.flatnonzero(~sound) + 1
        counts = [_between_steps(*part) for part in zip(np.split(values, anew), np.split(time_s, anew), strict=True)]
        amount = np.diff(np.concatenate(counts))
    stamps_s = time_s[1:] if marks == "end" else time_s[:-1]
    return (amount / lasts)[sound], stamps_s[sound], raw[1:][sound], flags


def _unusual(load: Array) -> NDArray[np.bool_]:
    """Which loads (n,) that a meter of energy tells no machine took, see `_UNUSUAL`."""
    positive = load[load > 0.0]
    if not positive.size:
        return np.zeros(load.size, dtype=bool)
    usual = np.percentile(positive, 99.0, method="lower")
    most = _UNUSUAL * max(usual, _A_MACHINE_W)
    if positive.size < _FEW_LOADS or np.unique(positive[positive > most]).size >= _RUNS:
        most = max(most, _UNUSUAL_OF_RARE * usual)
    return np.asarray(load > most)


def _step_of(counts: Array) -> float:
    """The step of a coarse counter (n,) that is read more often than it steps; 0 for others."""
    rises = np.diff(counts)
    steps = rises[rises > 0.0]
    if steps.size < _LEAST_STEPS or steps.size > _OFTEN * rises.size:
        return 0.0
    least = float(steps.min())
    # A meter steps by 1, 0.1 or 10 of its unit; equal rises of other size are those of a machine at one power.
    round_step = abs(np.log10(least) - round(float(np.log10(least)))) < _ROUND
    return least if round_step and (steps < _ONE_STEP * least).mean() > _MOSTLY else 0.0


def _between_steps(counts: Array, time_s: Array) -> Array:
    """What a coarse counter (n,) counted until each reading, evenly from step to step.

    Of a meter of whole kWh, read every 10 min, the differences are those of 0 and 6 kW. Before a step that took far
    longer than the next one the machine rested first.
    """
    steps = np.flatnonzero(np.diff(counts) > 0.0)
    if steps.size < _LEAST_STEPS:
        return counts
    at_s = 0.5 * (time_s[steps] + time_s[steps + 1])  # a step came between two readings
    # After the last one it goes on at its rate, unless another one was due.
    rise, since_s, last_s = counts[-1] - counts[steps[-1]], time_s[-1] - at_s[-1], at_s[-1] - at_s[-2]
    more = rise * since_s / last_s if since_s < last_s else 0.0
    rises, took_s = counts[steps + 1] - counts[steps], np.diff(at_s, prepend=time_s[0])
    like_next_s = rises[:-1] * took_s[1:] / rises[1:]
    rested = np.flatnonzero(took_s[:-1] > _RESTED * like_next_s)
    knots_s = np.concatenate([time_s[:1], at_s[rested] - like_next_s[rested], at_s, time_s[-1:]])
    knots = np.concatenate([counts[:1], counts[steps[rested]], counts[steps + 1], [counts[-1] + more]])
    order = np.argsort(knots_s, kind="stable")
    return np.asarray(np.interp(time_s, knots_s[order], knots[order]))


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


def _codes(values: Array) -> NDArray[np.bool_]:
    """Which readings (n,) of a power, NaN where there is none, are codes for none; what a machine takes has room."""
    coded, finite = np.zeros(values.size, dtype=bool), np.isfinite(values)
    coded[finite] = codes_of_none(values[finite])
    return coded & (np.abs(values) >= _LEAST_CODE)
