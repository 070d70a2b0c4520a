"""What commands on a building read and write: levels of a stretch, a table of times, a picture over time."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from rich.console import Console

from thermoforce_mpc.data import Array, Names
from thermoforce_mpc.data.dataframes import column, seconds_at
from thermoforce_mpc.errors import DataError, InputError
from thermoforce_mpc.files import read_bounded, write_json, write_whole, written
from thermoforce_mpc.whatif.dates import date_ticks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    where = f"--schedule {schedule}"
    try:
        frame = pd.read_csv(BytesIO(read_bounded(schedule, _MOST_BYTES, InputError)), dtype={"time": str})
    except ValueError as error:
        raise InputError(f"{where}: cannot be read as CSV ({error})") from error
    if "time" not in frame.columns:
        raise DataError(f"{where}: no column 'time'; there are {', '.join(map(str, frame.columns))}")
    if frame.empty:
        raise DataError(f"{where}: no rows; give one at least, at the begin of the stretch or before")
    # One by one, since over the end or begin of summer time the offsets of a plan differ.
    starts = np.array([seconds_at(origin, at, f"{where}: row {k + 2}, time") for k, at in enumerate(frame["time"])])
    if (np.diff(starts) <= 0).any():
        raise DataError(f"{where}: row {int(np.argmax(np.diff(starts) <= 0)) + 3} is not later than before")
    row = np.searchsorted(starts, time_s + 1.0, side="right") - 1
    if row[0] < 0:
        raise DataError(f"{where}: begins at {frame['time'].iloc[0]}, after the stretch that is asked about")
    u = np.empty((len(names.actuators), time_s.size))
    for a, actuator in enumerate(names.actuators):
        name = next((key for key in (names.label("u", a), f"u[{actuator}]") if key in frame.columns), actuator)
        levels, rows = column(frame, name, where), np.unique(row)
        wrong = rows[~(np.abs(levels[rows]) <= 1.0)]
        if wrong.size:
            raise DataError(
                f"{where}: row {wrong[0] + 2}, {name} is {levels[wrong[0]]:g}: give one from 0 to 1 (from -1 where it "
                "also cools)"
            )
        u[a] = levels[row]
    return u


def write_table(path: Path, table: pd.DataFrame, console: Console, what: str, **beside: Any) -> None:
    """Write a table of times to a .csv or .json file, in JSON as `rows` with `beside`; raises `StorageError`."""
    table = table.round(4)
    if path.suffix == ".csv":
        write_whole(path, table.to_csv(lineterminator="\n"))
        console.print(f"{what}: {path}", soft_wrap=True)
    else:
        plain = table.astype(object).where(table.notna(), None)
        plain.index = [at.isoformat() if hasattr(at, "isoformat") else float(at) for at in table.index]
        rows = plain.reset_index(names="time").to_dict("records")
        write_json_file(path, {**beside, "rows": rows}, console, what)


def write_json_file(path: Path, content: Any, console: Console, what: str) -> None:
    """Write a result as JSON; raises `StorageError`."""
    write_json(path, content, follow=True)
    console.print(f"{what}: {path}", soft_wrap=True)


def write_picture(path: Path, figure: Figure, console: Console) -> None:
    """Write a picture, the same bytes each time; raises `StorageError`."""
    metadata = {"Software": None} if path.suffix == ".png" else {"Date": None}
    with written(path) as aside:
        figure.savefig(aside, dpi=120, metadata=metadata)
    console.print(f"Picture: {path}", soft_wrap=True)


def on_clock(index: pd.Index[Any]) -> np.ndarray[Any, Any]:
    """Times for the axis of a picture: those of the clock there, without their zone."""
    return (index.tz_localize(None) if isinstance(index, pd.DatetimeIndex) else index).to_numpy()


def finish_axes(figure: Figure) -> None:
    """A grid in the upper axes, and days, hours and the legend of these below all, where it hides no course."""
    upper, *_ = figure.axes
    upper.grid(alpha=0.3)
    told = upper.get_legend_handles_labels()
    figure.legend(*told, loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    date_ticks(upper)
