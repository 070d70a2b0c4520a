"""Columns that look like temperatures of rooms and stand outside the map: neighbours whose heat reaches those in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.map.starting_map import kind_of
from thermoforce_mpc.measurements.map.units import converted
from thermoforce_mpc.measurements.tables.raw_table import as_numbers

# Median of the temperature of a room that is lived in, °C.
_ROOM_C = (14.0, 30.0)


def rooms_beside(head: pd.DataFrame, rules: MeasurementMap) -> tuple[str, ...]:
    """What the columns of `head`, the first rows of a table, tell of rooms outside the map, in words; none for no room.

    They are found by their names and the size of their readings in the unit of the mapped zones.
    """
    named = {column for _, signal in rules.signals() for column in signal.columns}
    units: set[str] = {zone.temperature.unit for zone in rules.zones.values()}
    rooms = [
        str(column)
        for column in head.columns.drop_duplicates(keep=False)
        if str(column) not in named and kind_of(str(column)) == "temperature" and _of_a_room(head[column], rules, units)
    ]
    return (_words(rooms, list(rules.zones)),) if rooms else ()


def _of_a_room(column: pd.Series, rules: MeasurementMap, units: set[str]) -> bool:
    numbers = np.asarray(as_numbers(column, rules.csv.decimal), dtype=np.float64)
    known = numbers[np.isfinite(numbers)]
    if not known.size or np.ptp(known) == 0.0:
        return False
    return any(_ROOM_C[0] <= converted(np.array([np.median(known)]), unit)[0] <= _ROOM_C[1] for unit in units)


def _words(rooms: Sequence[str], zones: Sequence[str]) -> str:
    many = len(rooms) > 1
    return (
        f"neighbours left out: {', '.join(rooms)} {'look like rooms' if many else 'looks like a room'} beside "
        f"{', '.join(zones)} and stand{'' if many else 's'} outside the map: where {'they are' if many else 'it is'} "
        "heated, that heat is taken for the own; name them as zones, with what heats them"
    )
