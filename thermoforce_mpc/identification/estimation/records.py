"""Input data of an identification: runs of one building and pairs of runs with the same weather; their checks."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, SIGNALS, Array, Record
from thermoforce_mpc.data.limits import LEVEL, ROUNDING
from thermoforce_mpc.data.names import AXIS
from thermoforce_mpc.data.series import WEATHER, bridged, long_gaps, long_level_gaps
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.screening import ReadingLimits, screened_history

# Least excitation: hours on, standard deviation of u, changes of u. Below it, gain and drift cannot be separated. By
# judgement (2026-11-21); probing is far above each.
MIN_ON_H = 1.0
MIN_SD_U = 0.05
MIN_CHANGES = 4
MIN_DAYS = 0.9
# Most rows of one run in its regression (all steps are simulated); more only make it slower. Rows an hour apart of a
# month; where they were farther apart than 1.5 h no error an hour ahead was known (2026-11-23).
MOST_ROWS = 700
# A prediction begins its lead time before its target, or up to so many times that where the sensor was silent. By
# judgement.
LEAD_REACH = 1.5
# Largest share of a signal's readings outside physical limits: more indicates a wrong unit, not a sensor fault. By
# judgement.
_MOST_REFUSED = 0.1
# Temperatures of rooms and outdoors, and what their median is in °F where it cannot be in °C.
_IN_C, _IN_F = ("T_zone_C", "T_out_C"), (45.0, 110.0)
# A grid of readings: share of different values among them below which there may be one, tolerance of a reading as a
# share of it, and the finest that counts, K.
_GRID_SHARE, _GRID_ROUNDING, _LEAST_GRID_K = 0.5, 0.05, 0.02
# Largest difference of the starting temperatures of a pair, which starts from one state, K: what is left is rounding of
# records.
MAX_START_DIFFERENCE_K = 0.05


@dataclass(frozen=True)
class Pair:
    """Two runs with the same initial state and weather but different actions (paper eq:paired).

    Raises:
        DataError: the runs differ in names, time, weather or the starting temperature of a zone.
    """

    a: Record
    b: Record
    label: str = ""

    def __post_init__(self) -> None:
        what = f"pair {self.label}".strip()
        names = self.a.names
        if self.b.names != names:
            raise DataError(f"{what}: the runs are of {names} and of {self.b.names}; a pair is of one building")
        for name in ("time_s", "T_out_C", "solar_W_m2"):
            first, second = getattr(self.a, name), getattr(self.b, name)
            if first.shape != second.shape or not np.allclose(first, second, atol=1e-6, equal_nan=True):
                raise DataError(f"{what}: {name} differs between the two runs; a pair shares clock and weather")
        for zone, apart in zip(names.zones, np.abs(self.a.T_zone_C[:, 0] - self.b.T_zone_C[:, 0]), strict=True):
            if not apart <= MAX_START_DIFFERENCE_K:
                who = "the zone" if len(names.zones) == 1 else f"zone {zone}"
                raise DataError(
                    f"{what}: {who} starts {apart:.3f} K apart, more than {MAX_START_DIFFERENCE_K} K: "
                    "start both runs from the same state"
                )

    def part(self, zone: int, actuators: Sequence[int], machines: Sequence[int] = ()) -> Pair:
        """The pair of one zone with some of the actuators and machines, see `Record.part`."""
        return Pair(self.a.part(zone, actuators, machines), self.b.part(zone, actuators, machines), self.label)


def prepared_runs(runs: Sequence[Record], allowed: ReadingLimits) -> tuple[list[Record], list[str]]:
    """Return usable runs without implausible readings and gaps, and notes on the changes.

    Short gaps of the weather and of u are bridged as in `data.series`. Steps in longer gaps are dropped; each
    part between them becomes a run of its own if it passes `check_run`, a long one several.

    Raises:
        DataError: nothing usable is left of a run, or more than 10 % of a signal's readings are implausible; gives the
            wrong numbers and what to do.
    """
    prepared: list[Record] = []
    notes: list[str] = []
    for index, run in enumerate(runs):
        name = f"run {index}" if len(runs) > 1 else "run"
        run, doubts = _plausible(run, allowed, name)
        pieces = _pieces(run)
        left_out = run.n_steps - sum(piece.n_steps for piece in pieces)
        if left_out:
            doubts += (f"{left_out} of {run.n_steps} steps without level or weather left out",)
        if len(pieces) > 1:
            doubts += (f"gaps in u or in the weather divide it into {len(pieces)} pieces",)
        used: list[Record] = []
        refusals: list[DataError] = []
        for piece in pieces:
            piece, filled = bridged(piece)
            try:
                part = name if len(pieces) == 1 else f"{name}, {piece.n_steps} steps between gaps"
                check_run(piece, part, allowed.range("u"))
            except DataError as error:
                refusals.append(error)
                continue
            parts = _parts(piece)
            used += parts
            doubts += (filled,) if filled else ()
            if len(parts) > 1:
                doubts += (f"{piece.n_steps} steps are fitted as {len(parts)} runs, one after another",)
        if not used:
            raise refusals[0] if refusals else DataError(f"{name}: {_never_together(run)}")
        doubts += tuple(f"left out: {error}" for error in refusals)
        notes += [f"{name}: {doubt}" for doubt in doubts]
        prepared += used
    return prepared, notes


def prepared_pairs(pairs: Sequence[Pair], allowed: ReadingLimits) -> tuple[list[Pair], list[str]]:
    """Return pairs without implausible readings and with short gaps of the weather bridged, and notes on the changes.

    Longer gaps and unknown levels remain and are refused by `check_pairs`: a pair cannot be divided, since its runs
    share only their start.

    Raises:
        DataError: more than 10 % of a signal's readings are implausible; names the signal with its numbers.
    """
    prepared: list[Pair] = []
    notes: list[str] = []
    for index, pair in enumerate(pairs):
        sides = []
        for side, history in (("first run", pair.a), ("second run", pair.b)):
            name = f"pair {pair.label or index} ({side})"
            history, doubts = _plausible(history, allowed, name)
            if np.isfinite(history.u).all() and _usable(history).all():
                history, filled = bridged(history)
                doubts += (filled,) if filled else ()
            sides.append(history)
            notes += [f"{name}: {doubt}" for doubt in doubts]
        prepared.append(Pair(sides[0], sides[1], label=pair.label))
    return prepared, notes


def _plausible(record: Record, allowed: ReadingLimits, name: str) -> tuple[Record, tuple[str, ...]]:
    """Return the record without implausible readings, and notes; raises `DataError` above 10 % of a signal's row."""
    screened, doubts = screened_history(record, allowed)
    for signal in SIGNALS:
        refused = np.isfinite(getattr(record, signal)) & ~np.isfinite(getattr(screened, signal))
        for row, places in enumerate(np.atleast_2d(refused)):
            if places.size and places.mean() > _MOST_REFUSED:
                label = record.names.label(signal, row) if signal in AXIS else signal
                why = next(doubt for doubt in doubts if doubt.startswith(f"{label} "))
                middle = float(np.nanmedian(np.atleast_2d(getattr(record, signal))[row]))
                unit = "°F is likely: give (x − 32) / 1.8; " if signal in _IN_C and _IN_F[0] < middle < _IN_F[1] else ""
                raise DataError(f"{name}: {why}; {unit}too many for sensor faults: check the unit and the floor area")
    return screened, doubts


def _usable(history: Record) -> NDArray[np.bool_]:
    """Return which steps have levels of all actuators and weather, known or bridged, shape (n,)."""
    lost = np.any([long_gaps(history, name) for name in WEATHER], axis=0)
    return np.asarray(~long_level_gaps(history) & ~lost[:-1] & ~lost[1:])


def _never_together(run: Record) -> str:
    """What is wrong with a run without a usable step."""
    rows = {**run.names.columns(u=run.u), **{name: getattr(run, name) for name in WEATHER}}
    silent = [label for label, values in rows.items() if not np.isfinite(values).any()]
    why = f": {', '.join(silent)} has no value; check where it is read" if silent else ""
    return f"u and the weather were never measured together{why}"


def _pieces(run: Record) -> list[Record]:
    """Return the consecutive parts of usable steps."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], _usable(run), [False]]).astype(int)))
    return [run.slice(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def _parts(run: Record) -> list[Record]:
    """Return a run in as few parts of about equal length as leave rows in reach of predictions an hour ahead."""
    most = MOST_ROWS * max(1, int(LEAD_REACH * HOUR_S / run.step_s))
    edges = np.linspace(0, run.n_steps, -(-run.n_steps // most) + 1).round().astype(int).tolist()
    return [run.slice(start, stop) for start, stop in pairwise(edges)]


def resolution_K(runs: Sequence[Record]) -> float:
    """Return the resolution of the zone sensor, K: the grid that all readings lie on, 0 where there is none."""
    readings = np.concatenate([run.T_zone_C[0] for run in runs]) if runs else np.empty(0)
    readings = readings[np.isfinite(readings)]
    values = np.unique(np.round(readings, 6))
    if values.size < 3 or values.size > _GRID_SHARE * readings.size:
        return 0.0
    steps = np.diff(values)
    grid = float(steps.min())
    on_grid = np.abs(steps / grid - np.round(steps / grid)).max() < _GRID_ROUNDING
    return grid if on_grid and grid >= _LEAST_GRID_K else 0.0


def check_run(history: Record, name: str, levels: tuple[float, float]) -> None:
    """Check length, signals, range of levels and excitation of a run; of several actuators one must be excited enough.

    Raises:
        DataError: the run is too short, incomplete or not excited; gives the wrong numbers and what to do.
    """
    _check_signals(history, name, levels)
    days = history.n_steps * history.step_s / DAY_S
    if days < MIN_DAYS:
        raise DataError(
            f"{name}: {days:.2f} days of data, need at least {MIN_DAYS} to separate the slow part of the response "
            "from the daily cycle of the weather; record one to three days"
        )
    # One of several that hardly acted must not refuse the rest: the verdict on its own model says so.
    spread = history.u.std(axis=1)
    lacking = [_unexcited(u, history.names.label("u", a), history.step_s) for a, u in enumerate(history.u)]
    if all(lacking):
        raise DataError(
            f"{name}: {lacking[int(np.argmax(spread))]}; "
            "probe with varied levels and holding times (`tf-mpc identify` designs that), or add days"
        )


def _unexcited(u: Array, label: str, step_s: float) -> str:
    """What is too little about the level `u` (n,) of an actuator to identify its effect; empty where nothing is."""
    on_h = float((np.abs(u) > 0.02).sum()) * step_s / HOUR_S
    changes = int((np.abs(np.diff(u)) > 0.02).sum())
    spread = float(np.std(u))
    if spread < 1e-6:
        return f"{label} is constant at {u[0]:g}: its effect cannot be identified"
    if on_h < MIN_ON_H or spread < MIN_SD_U or changes < MIN_CHANGES:
        return (
            f"too little excitation: on for {on_h:.1f} h (need {MIN_ON_H:g}), standard deviation of {label} "
            f"{spread:.3f} (need {MIN_SD_U:g}), {changes} changes of {label} (need {MIN_CHANGES})"
        )
    return ""


def check_pairs(pairs: Sequence[Pair]) -> None:
    """Check the signals of pairs and that their levels differ.

    Raises:
        DataError: gives the wrong numbers and what to do.
    """
    for index, pair in enumerate(pairs):
        name = f"pair {pair.label or index}"
        _check_signals(pair.a, name + " (first run)")
        _check_signals(pair.b, name + " (second run)")
    largest = max(float(np.max(np.abs(p.a.u - p.b.u))) for p in pairs)
    if largest < MIN_SD_U:
        raise DataError(
            f"pairs: u differs by at most {largest:.3f} between the runs of any pair, need {MIN_SD_U:g}: "
            "let the second run of each pair act differently"
        )


def check_steps(histories: Sequence[Record]) -> None:
    """Check that all records have one step length.

    Raises:
        DataError: names the steps found.
    """
    steps = sorted({round(h.step_s, 3) for h in histories})
    if len(steps) > 1:
        raise DataError(f"the records have steps of {', '.join(f'{s:g}' for s in steps)} s: resample them to one step")


def _check_signals(history: Record, name: str, levels: tuple[float, float] = LEVEL) -> None:
    if history.n_steps < 2:
        raise DataError(f"{name}: {history.n_steps} steps, need at least 2")
    for zone, measured in zip(history.names.zones, np.isfinite(history.T_zone_C), strict=True):
        of_zone, otherwise = (f" of {zone}", ", or leave the zone out") if len(history.names.zones) > 1 else ("", "")
        if not measured.any():
            raise DataError(f"{name}: no zone temperature{of_zone} is known; check its column or point{otherwise}")
        if measured.mean() < 0.5:
            share = f"only {100 * measured.mean():.0f} % of the zone temperatures{of_zone} were measured"
            raise DataError(f"{name}: {share}, need half")
    rows = history.names.columns(u=history.u)
    for signal, values in {**rows, "T_out_C": history.T_out_C, "solar_W_m2": history.solar_W_m2}.items():
        gaps = np.flatnonzero(~np.isfinite(values))
        if gaps.size:
            raise DataError(
                f"{name}: {signal} is not finite at {gaps.size} of {values.size} places, first at {gaps[0]}; "
                "cut the record there or fill it"
            )
    for label, u in rows.items():
        if (u < levels[0]).any() or (u > levels[1]).any():
            raise DataError(
                f"{name}: {label} ranges from {u.min():g} to {u.max():g}, expected [{levels[0] + ROUNDING:g}, 1]; "
                "rescale it"
            )


def data_hash(history: Record) -> str:
    """Return the SHA-256 of a run's data, stored in the saved model."""
    digest = hashlib.sha256()
    for name in SIGNALS:
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(getattr(history, name)).tobytes())
    return digest.hexdigest()
