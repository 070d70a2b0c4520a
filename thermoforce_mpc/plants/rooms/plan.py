"""Floor plan: rooms of given areas in two rows on one or two storeys, and which of them touch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from thermoforce_mpc.plants.drawn_houses.envelope import FACADES

_LEAST_CONTACT_M = 1e-6


@dataclass(frozen=True)
class Place:
    """Rectangle of a room on the plan, m: x from west to east, y from south to north; `storey` 0 is at the ground."""

    storey: int
    x0: float
    x1: float
    y0: float
    y1: float

    @property
    def area_m2(self) -> float:
        """Floor area, m²."""
        return (self.x1 - self.x0) * (self.y1 - self.y0)


@dataclass(frozen=True)
class Contact:
    """Surface shared by two rooms, by index: a wall of length `length_m`, or a floor of `area_m2` (length 0).

    Of a floor `first` is the room below it.
    """

    first: int
    second: int
    kind: Literal["wall", "floor"]
    area_m2: float
    length_m: float


def lay_out(rng: np.random.Generator, storeys: list[list[float]], aspect: float) -> list[list[Place]]:
    """Return the places of rooms of `storeys` (areas in m², each storey of the same sum), by storey.

    A storey of up to two rooms has one row of the full depth. Others have two, south and north, of about equal area:
    the largest rooms are set first, each into the row with less. The order within a row is drawn. `aspect` is length
    from west to east over depth of the house.
    """
    footprint = sum(storeys[0])
    length = float(np.sqrt(footprint * aspect))
    return [_storey(rng, level, areas, length) for level, areas in enumerate(storeys)]


def _storey(rng: np.random.Generator, level: int, areas: list[float], length: float) -> list[Place]:
    rows: list[list[int]] = [[], []]
    if len(areas) <= 2:
        rows = [list(range(len(areas)))]
    else:
        for room in sorted(range(len(areas)), key=lambda i: -areas[i]):
            filled = [sum(areas[i] for i in row) for row in rows]
            rows[int(np.argmin(filled))].append(room)
    places: dict[int, Place] = {}
    south = 0.0
    for row in rows:
        depth = float(sum(areas[i] for i in row) / length)
        # The last edge is the length itself: rounding must not open a gap to the facade.
        order = [row[i] for i in rng.permutation(len(row))]
        edges = np.concatenate([[0.0], np.cumsum([areas[i] / depth for i in order])])
        edges[-1] = length
        for i, room in enumerate(order):
            places[room] = Place(level, float(edges[i]), float(edges[i + 1]), south, south + depth)
        south += depth
    return [places[i] for i in range(len(areas))]


def facade_lengths(place: Place, storey: list[Place]) -> tuple[float, float, float, float]:
    """Return the length of the room's outside walls by `FACADES`, m; `storey` holds all rooms of its storey."""
    wide, deep = place.x1 - place.x0, place.y1 - place.y0
    at = {
        "south": (place.y0, min(p.y0 for p in storey), wide),
        "north": (place.y1, max(p.y1 for p in storey), wide),
        "west": (place.x0, min(p.x0 for p in storey), deep),
        "east": (place.x1, max(p.x1 for p in storey), deep),
    }
    south, west, north, east = (at[name][2] if abs(at[name][0] - at[name][1]) < 1e-6 else 0.0 for name in FACADES)
    return south, west, north, east


def contacts(places: list[Place], height_m: float) -> list[Contact]:
    """Return the walls between rooms of a storey and the floors between rooms of two."""
    contacts = []
    for i, a in enumerate(places):
        for j in range(i + 1, len(places)):
            b = places[j]
            along_x = min(a.x1, b.x1) - max(a.x0, b.x0)
            along_y = min(a.y1, b.y1) - max(a.y0, b.y0)
            if a.storey != b.storey:
                if min(along_x, along_y) > _LEAST_CONTACT_M:
                    below, above = (i, j) if a.storey < b.storey else (j, i)
                    contacts.append(Contact(below, above, "floor", along_x * along_y, 0.0))
            elif max(along_x, along_y) > _LEAST_CONTACT_M and min(along_x, along_y) > -1e-6:
                wall = max(along_x, along_y)
                contacts.append(Contact(i, j, "wall", wall * height_m, wall))
    return contacts
