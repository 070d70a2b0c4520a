"""What earlier looks at a table that is being written found: a log is rotated at midnight, a column of it is renamed.

What was read then stands where the table does not have it any more, for as long as controllers look back.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.notes import Note
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.tables.clock import Timed

_Readings = tuple[pd.DatetimeIndex, Array]


@dataclass
class Earlier:
    """What looks at the tables of one building found before; `days`: for how long it stands.

    `ahead`: instants whose readings were put aside, as stamped after the clock, s since 1970; so long as well.
    """

    days: float
    ahead: set[float] = field(default_factory=set)
    last: Timed | None = None
    _latest: dict[str, _Readings] = field(default_factory=dict)
    _gone: dict[str, _Readings] = field(default_factory=dict)

    @property
    def columns(self) -> Collection[str]:
        """Columns that were there once."""
        return self._latest.keys() | self._gone.keys()

    def joined(self, rows: Timed, wanted: Sequence[str], now: pd.Timestamp, name: str, notes: list[str]) -> Timed:
        """`rows` of the table `name` with earlier readings of the columns `wanted` that it has not any more.

        Those are of a column that is away, which was not available from then on, and of one whose readings all came
        after them: the table was begun anew. Raises `DataError` where all rows come before those that were read: of a
        clock that has not been set yet.
        """
        if self.last is not None and rows.index[-1] < self.last.index[0] <= now:
            raise DataError(f"{name}: its last row is of {rows.index[-1]}, before all that was read: a wrong clock?")
        here = {one: _readings_of(rows, one) for one in wanted if one in rows.columns}
        for one in wanted:
            before = self._latest.get(one)
            if before is not None and _is_gone(before, here.get(one)):
                self._gone[one] = _after(self._gone.get(one), before)
                del self._latest[one]
        self._latest |= here
        since = now - pd.Timedelta(days=self.days)
        self.ahead = {at for at in self.ahead if at >= since.timestamp()}
        for one, (at, values) in self._gone.items():
            stands = at >= since
            if one in here and len(here[one][0]):
                stands &= at < here[one][0][0]
            self._gone[one] = at[stands], values[stands]
        if (gone := [at for at, _ in self._gone.values() if len(at)]) and set(here) == set(wanted):
            text = (
                f"{name}: begins at {rows.index[0]}, what was read before it until {max(at[-1] for at in gone)} stands"
            )
            notes.append(Note(text, f"{name}: begun anew"))
        self.last = self._with_gone(rows, [one for one in wanted if one not in here])
        return self.last

    def _with_gone(self, rows: Timed, away: Sequence[str]) -> Timed:
        gone = {one: of for one, of in self._gone.items() if len(of[0])}
        if not gone and not away:
            return rows
        of_all = Timed(rows.index, dict(rows.columns), rows.notes, dict(rows.own), rows.beside, rows.marks)
        if not away and not rows.own:
            return _on_one_index(of_all, gone)
        for one in [*rows.columns, *away]:
            at, values = _after(gone.get(one), self._latest.get(one) or _readings_of(rows, one))
            later = rows.index[rows.index > at[-1]] if len(at) else rows.index[:0]
            if one in away and len(later):  # not available from then on
                at, values = pd.DatetimeIndex(at.append(later[:1])), np.append(values, np.nan)
            of_all.own[one], of_all.columns[one] = at, values
        index = _every_instant([*of_all.own.values()])
        return Timed(index, of_all.columns, rows.notes, of_all.own, rows.beside, rows.marks)


def _readings_of(rows: Timed, name: str) -> _Readings:
    """Instants, in ns, and values of a column; of one beside others without its empty cells, which say nothing."""
    if name not in rows.columns:
        return rows.index[:0].as_unit("ns"), np.empty(0)
    at, values = rows.at(name).as_unit("ns"), rows.columns[name]
    known = np.ones(len(at), dtype=bool) if name in rows.own else np.isfinite(values)
    return at[known], values[known]


def _is_gone(before: _Readings, new: _Readings | None) -> bool:
    """Whether a table has nothing any more of what was read `before` of a column, and has now.

    A logger may begin its new file with the last row of the one before.
    """
    if not len(before[0]):
        return False
    return new is None or not len(new[0]) or bool(new[0][0] >= before[0][-1])


def _after(first: _Readings | None, second: _Readings) -> _Readings:
    """Readings one after the other; where they overlap the second count."""
    if first is None or not len(first[0]):
        return second
    at, values = first
    if len(second[0]):
        before = at < second[0][0]
        at, values = at[before], values[before]
    return pd.DatetimeIndex(at.append(second[0])), np.append(values, second[1])


def _on_one_index(rows: Timed, gone: dict[str, _Readings]) -> Timed:
    """Columns that stand beside one another, with the readings `gone` before them."""
    now = rows.index.as_unit("ns")
    index = _every_instant([*(at for at, _ in gone.values()), now])
    columns = {}
    for name, values in rows.columns.items():
        column = np.full(len(index), np.nan)
        column[index.searchsorted(now)] = values
        if name in gone:
            column[index.searchsorted(gone[name][0])] = gone[name][1]
        columns[name] = column
    return Timed(index, columns, rows.notes, rows.own, rows.beside, rows.marks)


def _every_instant(indices: Sequence[pd.DatetimeIndex]) -> pd.DatetimeIndex:
    """The instants of all, each once and in order; they are in ns and of one time zone."""
    every = pd.DatetimeIndex(np.unique(np.concatenate([at.asi8 for at in indices])))
    zone = indices[0].tz
    return every if zone is None else every.tz_localize("UTC").tz_convert(zone)
