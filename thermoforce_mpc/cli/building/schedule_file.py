"""Levels of a past or coming stretch, from a file of times and levels or as one number."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import Array, Names
from thermoforce_mpc.data.dataframes import column, seconds_at
from thermoforce_mpc.errors import DataError, InputError
from thermoforce_mpc.files import read_bounded

_MOST_BYTES = 10_000_000


def levels_of(schedule: Path | None, level: float | None, names: Names, time_s: Array, origin: pd.Timestamp) -> Array:
    """Levels (A, N) over the steps that begin at `time_s` (N,), s from `origin`.

    A schedule has a column `time` and one per actuator, `u` where there is one, else by name or as `u[name]` (a plan of
    `tf-mpc plan` will do); a level holds until the next row. Times are on the clock of `origin` or have an offset.

    Raises:
        DataError: the file cannot be read, lacks a column or rows, begins too late, or holds what is no time or level.
    """
    if schedule is None:
        return np.full((len(names.actuators), time_s.size), level)
    try:
        frame = pd.read_csv(BytesIO(read_bounded(schedule, _MOST_BYTES, InputError)), dtype={"time": str})
    except ValueError as error:
        raise InputError(f"--schedule {schedule}: cannot be read as CSV ({error})") from error
    if "time" not in frame.columns:
        raise DataError(f"--schedule {schedule}: no column 'time'; there are {', '.join(map(str, frame.columns))}")
    if frame.empty:
        raise DataError(f"--schedule {schedule}: no rows; give one at least, at the begin of the stretch or before")
    # One by one, since over the end or begin of summer time the offsets of a plan differ.
    starts = np.array(
        [seconds_at(origin, at, f"--schedule {schedule}: row {k + 2}, time") for k, at in enumerate(frame["time"])]
    )
    if (np.diff(starts) <= 0).any():
        raise DataError(
            f"--schedule {schedule}: row {int(np.argmax(np.diff(starts) <= 0)) + 3} is not later than before"
        )
    row = np.searchsorted(starts, time_s + 1.0, side="right") - 1
    if row[0] < 0:
        raise DataError(
            f"--schedule {schedule}: begins at {frame['time'].iloc[0]}, after the stretch that is asked about"
        )
    return np.array([_levels(frame, _column(frame, names, a), schedule, row) for a in range(len(names.actuators))])


def _levels(frame: pd.DataFrame, name: str, schedule: Path, row: NDArray[np.intp]) -> Array:
    """The levels in the rows `row` (N,) of a column; raises `DataError` for one that is none."""
    levels = column(frame, name, f"--schedule {schedule}")
    rows = np.unique(row)
    wrong = rows[~(np.abs(levels[rows]) <= 1.0)]
    if wrong.size:
        raise DataError(
            f"--schedule {schedule}: row {wrong[0] + 2}, {name} is {levels[wrong[0]]:g}: give one from 0 to 1 (from -1 "
            "where it also cools)"
        )
    return levels[row]


def _column(frame: pd.DataFrame, names: Names, a: int) -> str:
    name = names.actuators[a]
    present = [key for key in (names.label("u", a), f"u[{name}]") if key in frame.columns]
    return present[0] if present else name
