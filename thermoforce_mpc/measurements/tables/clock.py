"""Rows of one table or several in the order of time: shuffled and repeated stamps, differing clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.map.mapped_table import Clock
from thermoforce_mpc.measurements.tables.raw_table import RawTable
from thermoforce_mpc.measurements.tables.stamps import instants

_AN_HOUR = pd.Timedelta("1h")
_MOST_YEARS = 20


@dataclass(frozen=True)
class Timed:
    """Columns of one table or several over increasing instants.

    `index` (n,): in the zone of the map, without a zone where there is none; `columns` by name (n,); `notes`: what was
    done to the rows, in words.
    """

    index: pd.DatetimeIndex
    columns: dict[str, Array]
    notes: tuple[str, ...] = field(default=())


def timed(tables: Sequence[RawTable], clock: Clock) -> Timed:
    """The rows of `tables` in the order of time.

    Raises:
        DataError: a stamp cannot be read, is out of order, comes twice or does not exist, or zones differ; names
            file, line and what to do.
    """
    notes: list[str] = []
    stamps = [instants(table, clock, notes) for table in tables]
    has = [stamp.dt.tz is not None for stamp in stamps]
    if len(set(has)) > 1:
        naive, aware = tables[has.index(False)].name, tables[has.index(True)].name
        raise DataError(
            f"{naive}: its time stamps have no time zone, those of {aware} have one; name time.zone of the map"
        )
    zones = list(dict.fromkeys(str(stamp.dt.tz) for stamp in stamps))
    if len(zones) > 1:
        other = tables[[str(stamp.dt.tz) for stamp in stamps].index(zones[1])].name
        raise DataError(
            f"{other}: its time stamps have the offset {zones[1]}, those of {tables[0].name} {zones[0]}: daylight "
            "saving, or two time zones; name the building's as time.zone, such as Europe/Brussels"
        )
    order = sorted(range(len(stamps)), key=lambda i: stamps[i].iloc[0])
    tables, stamps = [tables[i] for i in order], [stamps[i] for i in order]
    index = pd.DatetimeIndex(pd.concat(stamps, ignore_index=True))
    columns = {
        name: np.concatenate([t.columns[name][s.index] for t, s in zip(tables, stamps, strict=True)])
        for name in tables[0].columns
    }
    places = _Places(tables, stamps)
    keep = _in_order(index, clock, places, notes)
    if keep is not None:
        index, columns = index[keep], {name: values[keep] for name, values in columns.items()}
    if (years := (index[-1] - index[0]).days / 365.0) > _MOST_YEARS:
        row = int(np.argmax(np.diff(index.asi8)))
        raise DataError(
            f"{tables[0].name}: {years:.0f} years from {index[0]} to {index[-1]}, the longest gap from {index[row]} to "
            f"{index[row + 1]}: mend the time stamp that is wrong, or give {_MOST_YEARS} years at most"
        )
    return Timed(index, columns, tuple(notes))


@dataclass(frozen=True)
class _Places:
    """Where the rows of several tables stand."""

    tables: Sequence[RawTable]
    stamps: Sequence[pd.Series]

    def where(self, row: int) -> str:
        for table, stamps in zip(self.tables, self.stamps, strict=True):
            if row < len(stamps):
                return table.where(int(stamps.index[row]))
            row -= len(stamps)
        return self.tables[-1].name


def _in_order(index: pd.DatetimeIndex, clock: Clock, places: _Places, notes: list[str]) -> NDArray[np.intp] | None:
    """The rows to keep in the order to keep them, None where all stand as they should."""
    at = index.asi8
    keep = np.arange(at.size)
    back = np.flatnonzero(np.diff(at) < 0)
    if back.size:
        row = int(back[0]) + 1
        autumn = index[row - 1] - index[row] < _AN_HOUR * 1.01
        what = f"{places.where(row)}: {index[row]} comes after {index[row - 1]}; {back.size} such rows"
        if clock.order == "refuse":
            hint = "; if it is the end of summer time, name time.zone" if autumn and clock.zone is None else ""
            raise DataError(f"{what}: sort the table, or set time.order: sort{hint}")
        keep = np.argsort(at, kind="stable")
        at = at[keep]
        notes.append(f"{what}: sorted")
    same = np.flatnonzero(np.diff(at) == 0)
    if same.size:
        first, second = (int(keep[same[0] + i]) for i in (0, 1))
        what = f"{places.where(second)}: {index[second]} stands at {places.where(first)} too; {same.size} such rows"
        if clock.duplicates == "refuse":
            raise DataError(f"{what}: remove one of them, or set time.duplicates: first or last")
        drop = same + 1 if clock.duplicates == "first" else same
        keep = np.delete(keep, drop)
        notes.append(f"{what}: the {clock.duplicates} one kept")
    return keep if back.size or same.size else None
