"""Readings of a table that is being written which are stamped after the clock: the clock of what wrote them was wrong.

They are put aside where others tell what is of now. Where none does the clock, or the zone of the map, is in doubt, and
they stay: who reads them says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.clock import CLOCKS_S
from thermoforce_mpc.data.notes import Note
from thermoforce_mpc.errors import counted
from thermoforce_mpc.measurements.tables.clock import Timed, newest_first

# Readings so old at most, or so many of their usual distances, tell what is of now, s: a logger that sends in batches
# of a quarter of an hour has missed a few, one that stood for longer tells nothing of now.
_RECENT_S, _RECENT = 3600.0, 3.0
# Readings that go on from those of now are of another zone or of a clock that goes ahead, and not of a while in which
# it did: no farther apart than so many of their usual distances.
_GOES_ON = 1.5


def before_set_back(at: pd.Series, signal: NDArray[np.int32], latest_s: Array) -> NDArray[np.bool_]:
    """Which rows (n,), in the order in which they were written, are stamped after `latest_s` (n,) and stand before one
    that is not, of a `signal` (n,) with both. In a table whose zone is wrong none is: its last rows are stamped after
    it too.
    """
    at_s = np.asarray((at - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1), dtype=np.float64)
    ahead = at_s > latest_s
    if not ahead.any() or newest_first(at_s):
        return np.zeros(at_s.size, dtype=bool)
    until = 0
    for one in np.unique(signal[ahead]):
        rows = np.flatnonzero(signal == one)
        later = rows[np.argmax(ahead[rows]) :]
        until = max(until, int(later[~ahead[later]].max(initial=0)))
    return np.asarray(ahead & (np.arange(at_s.size) < until))


@dataclass(frozen=True)
class _Column:
    """Readings of a column at `time_s` (n,), s from the clock's now: which are `ahead`, and what they say of it."""

    time_s: Array
    ahead: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    tells_now: bool = False
    goes_on: bool = False

    @classmethod
    def of(cls, time_s: Array, known: set[float], now_s: float) -> _Column:
        """`known`: times that were found to be wrong before, s."""
        ahead = time_s > CLOCKS_S
        usual_s = float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0
        past = time_s[~ahead]
        recent = bool(past.size and -past[-1] <= max(_RECENT_S, _RECENT * usual_s))
        new = [one for one in time_s[ahead].tolist() if round(now_s + one) not in known]
        goes_on = bool(new and new[0] <= CLOCKS_S + _GOES_ON * usual_s)
        return cls(time_s, ahead, recent and not goes_on, goes_on)


def without_ahead(rows: Timed, names: Sequence[str], now: pd.Timestamp, notes: list[str], known: set[float]) -> Timed:
    """`rows` without readings of the columns `names` that are stamped after `now`, and `notes` on them by column.

    `known`: instants that were put aside at an earlier look, s since 1970, to which those of this one are added: when
    the clock comes near they seem to go on from what is of now.

    A column whose readings are ahead throughout, where most of the others tell what is of now, is of a clock of its
    own: as long as it is ahead, its readings before now are of another time too, and left out. In a table with a
    column of time for all that cannot be.
    """
    names = [name for name in names if name in rows.columns]
    if rows.index.tz is None or not names:
        return rows
    now_s = now.timestamp()
    at = {name: rows.at(name)[np.isfinite(rows.columns[name])] for name in names}
    if not any(len(one) and one[-1] > now for one in at.values()):
        return rows
    found = {name: _Column.of(one.as_unit("ns").asi8 / 1e9 - now_s, known, now_s) for name, one in at.items()}
    telling = sum(one.tells_now for one in found.values())
    wrong = sum(one.goes_on for one in found.values())
    if not telling or wrong >= telling:
        return rows
    columns = dict(rows.columns)
    for name, one in found.items():
        if not one.ahead.any():
            continue
        newest_s = float(one.time_s[-1])
        left = one.time_s > (-newest_s if one.goes_on else CLOCKS_S)
        first, last = at[name][left][[0, -1]]
        text = (
            f"column '{name}': {counted(int(left.sum()), 'reading')} stamped {first} to {last}, by a clock that was "
            f"wrong (it is {now.tz_convert(rows.index.tz):%Y-%m-%d %H:%M}): left out"
        )
        notes.append(Note(text, f"column '{name}': a wrong clock", int(left.sum())))
        known |= {float(round(now_s + s)) for s in one.time_s[one.ahead].tolist()}
        values = columns[name].copy()
        values[np.flatnonzero(np.isfinite(values))[left]] = np.nan
        columns[name] = values
    return replace(rows, columns=columns)
