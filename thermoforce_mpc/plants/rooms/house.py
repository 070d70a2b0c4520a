"""What a house of rooms is made of: floor plan, rooms, doors and heat pump, and laws that draw and physics need.

What a building is used for, its kinds of rooms, and the ranges that its draw depends on, stand first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from thermoforce_mpc.plants.drawn_houses import (
    AIR_WH_M3_K,
    DESIGN_OUT_C,
    DESIGN_ROOM_C,
    FACADES,
    HEIGHT_M,
    MASSES,
    Facade,
    Mass,
    ground_C,
)
from thermoforce_mpc.plants.people import HOUSEHOLDS, Pattern

Kind = Literal["living", "kitchen", "bedroom", "bath", "study", "hall", "open", "cell", "meeting", "corridor"]
RoomEmitter = Literal["floor", "radiator", "air"]
Range = tuple[float, float]


@dataclass(frozen=True)
class KindOf:
    """What is typical of a kind of room; ranges are those of uniform draws.

    Floor area m², glazing per floor area, lowest temperature in use °C and width of the band K (one of each tuple),
    appliances relative to those of the building, and people (relative) while there by day and by night. `openness`:
    share of the time that its door stands open, with a less private room behind it; `private`: rank of that.
    """

    area_m2: Range
    glazing: Range
    lower_C: tuple[float, ...]
    band_K: tuple[float, ...]
    appliances: float
    people_day: float
    people_night: float
    openness: Range
    private: float


@dataclass(frozen=True)
class Use:
    """A use of buildings.

    `first` and `further`: kinds of the first rooms, and those that repeat in larger ones. `from_the_ground`: order in
    which two storeys are filled from below. `emitters`: styles and their probabilities; `masses`, `patterns` likewise.
    `age`: from 0, a passive house, to 1, not refurbished; `unshaded`: share of the sun that passes frame and
    shading; `emitters_over_load`, `machine_over_load`: sizes over the heat load (machine: with probabilities).
    `person_m2`: floor area per person; gains besides people while in use and while not, W/m² (EN ISO 13790, annex G).
    """

    name: str
    kinds: dict[Kind, KindOf]
    first: tuple[Kind, ...]
    further: tuple[Kind, ...]
    from_the_ground: tuple[Kind, ...]
    emitters: dict[str, float]
    masses: tuple[Mass, ...]
    patterns: dict[Pattern, float]
    age: Range
    unshaded: Range
    emitters_over_load: Range
    machine_over_load: dict[Range, float]
    person_m2: Range
    gains_W_m2: Range
    gains_empty_W_m2: Range


HOUSE = Use(
    "house",
    {
        "living": KindOf((22.0, 38.0), (0.18, 0.32), (20.5, 21.0, 21.5), (3.0, 4.0), 1.2, 4.0, 0.0, (0.3, 0.9), 1.0),
        "kitchen": KindOf((9.0, 16.0), (0.12, 0.22), (20.0, 20.5), (3.0, 4.0), 2.0, 2.0, 0.0, (0.3, 0.9), 2.0),
        "study": KindOf((8.0, 14.0), (0.12, 0.22), (20.0, 21.0), (3.0, 4.0), 1.5, 1.0, 0.0, (0.1, 0.5), 3.0),
        "bath": KindOf((5.0, 9.0), (0.04, 0.10), (22.0, 23.0), (3.0, 4.0), 1.0, 0.4, 0.0, (0.02, 0.15), 5.0),
        "hall": KindOf((6.0, 12.0), (0.02, 0.08), (17.0, 18.0), (5.0, 6.0), 0.3, 0.1, 0.0, (0.2, 0.7), 0.0),
        "bedroom": KindOf((10.0, 18.0), (0.12, 0.22), (18.0, 19.0), (5.0, 6.0), 0.5, 0.4, 1.0, (0.05, 0.4), 4.0),
    },
    ("living", "bedroom", "bath", "kitchen", "bedroom", "hall", "study", "bedroom", "bath"),
    ("hall", "bedroom", "study", "bedroom", "bath"),
    # A second hall comes with the upper storey.
    ("living", "kitchen", "hall", "study", "bath", "bedroom"),
    {"floor": 0.4, "floor below": 0.2, "radiator": 0.4},
    tuple(MASSES),
    dict(zip(HOUSEHOLDS, (0.35, 0.25, 0.20, 0.20), strict=True)),
    (0.0, 0.75),  # houses that a heat pump heats, from passive to partly renovated (TABULA)
    (0.45, 0.70),  # frame 0.7 to 0.8, external shading 0.6 to 0.9 (EN ISO 13790)
    (1.05, 1.35),
    {(0.85, 1.0): 0.2, (1.0, 1.3): 0.55, (1.3, 1.8): 0.25},
    (30.0, 55.0),
    (2.0, 5.0),
    (0.7, 1.5),
)
# Light, without cooling, with fan coils or radiators; hours as in BOPTEST's office, sized for a night's setback.
OFFICE = Use(
    "office",
    {
        "open": KindOf((60.0, 160.0), (0.15, 0.30), (21.0,), (4.0,), 1.2, 1.0, 0.0, (0.3, 0.9), 1.0),
        "cell": KindOf((12.0, 24.0), (0.15, 0.30), (21.0,), (4.0,), 1.0, 1.0, 0.0, (0.1, 0.5), 3.0),
        "meeting": KindOf((18.0, 40.0), (0.10, 0.25), (21.0,), (4.0,), 0.8, 1.5, 0.0, (0.05, 0.4), 4.0),
        "corridor": KindOf((12.0, 30.0), (0.02, 0.10), (19.0, 20.0), (5.0, 6.0), 0.3, 0.1, 0.0, (0.2, 0.7), 0.0),
    },
    ("open", "cell", "meeting", "corridor", "open", "cell", "cell", "meeting"),
    ("corridor", "cell", "open", "cell", "meeting"),
    ("open", "meeting", "corridor", "cell"),
    {"air": 0.7, "radiator": 0.3},
    ("very light", "light", "medium"),
    {"office": 1.0},
    (0.25, 0.90),
    (0.15, 0.35),  # external blinds
    (1.6, 2.2),  # heating up in the morning (EN 12831)
    {(1.5, 2.2): 1.0},
    (15.0, 30.0),
    (3.0, 7.0),
    (1.0, 2.0),
)
USES = {use.name: use for use in (HOUSE, OFFICE)}


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
    """A wall of `length_m` between two rooms, by index, or a floor of `area_m2` (length 0), `first` below `second`."""

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


# Film on either side of an inside wall, m²K/W (EN ISO 6946).
_INSIDE_FILM_M2K_W = 0.13


@dataclass(frozen=True)
class Room:
    """One room: zone, heat emitter and valve. Powers in W, temperatures in °C, areas in m².

    `walls_m2` outside walls and `windows_m2` glazing by `FACADES`; `opaque_W_K` and `windows_W_K` transmission to
    outdoors, `ground_W_K` to the ground. Comfort band `lower_C` to `upper_C` while in use. `appliances` relative to
    the house; `people_day`, `people_night` shares of the people at home.

    `emitter_W` at design; water and metal of `emitter_J_K` deliver `emitter_W_Kn` · ΔT^`emitter_exponent` W: by a
    radiator or coil, `convective` of it to the air and the rest to the surfaces; in a floor, all to a slab of
    `slab_J_K`, coupled to the room by `slab_room_W_K`. `flow_W_K`: heat taken at design flow per K of supply over
    mean water temperature.
    """

    name: str
    kind: Kind
    place: Place
    walls_m2: tuple[float, float, float, float]
    windows_m2: tuple[float, float, float, float]
    opaque_W_K: float
    windows_W_K: float
    ground_W_K: float
    lower_C: float
    upper_C: float
    appliances: float
    people_day: float
    people_night: float
    emitter: RoomEmitter
    emitter_W: float
    emitter_J_K: float
    emitter_W_Kn: float
    emitter_exponent: float
    convective: float
    slab_J_K: float
    slab_room_W_K: float
    flow_W_K: float

    @property
    def area_m2(self) -> float:
        """Floor area, m²."""
        return self.place.area_m2


@dataclass(frozen=True)
class Door:
    """Air exchange between two rooms by index, W/K: `leak_W_K` + `open_W_K15` · √|ΔT|; a stairwell is one too."""

    first: int
    second: int
    leak_W_K: float
    open_W_K15: float


@dataclass(frozen=True)
class Curve:
    """Heating curve of one kind of emitter: `design_C` supply at the design outdoor temperature, raised by `shift_K`.

    Supply temperature over 20 °C goes with the `exponent`-th root of the load; `limit_C` is never exceeded.
    """

    design_C: float
    exponent: float
    shift_K: float
    limit_C: float


@dataclass(frozen=True)
class HeatPump:
    """Air-to-water heat pump: `capacity_W` at design, rising by `capacity_per_K` per K outdoors.

    Below `lowest_level` of the capacity it cycles. COP is `carnot` times Carnot's, beside `fixed_W` of electric power
    while it runs.
    """

    capacity_W: float
    capacity_per_K: float
    lowest_level: float
    carnot: float
    fixed_W: float


@dataclass(frozen=True)
class DrawnHouse:
    """A house of rooms with one heat pump, or an office (`use`), see `draw_rooms`.

    `turn_deg`: the 'south' facade looks to 180° + `turn_deg`. `attached`: facades that touch a neighbour's house at
    the same temperature. `U_inside` of walls and floors between rooms, air to air, W/m²K. `air_changes_1_h` mean
    infiltration. `curves` by emitter; others as in `generated.House`.
    """

    use: str
    seed: int
    rooms: tuple[Room, ...]
    contacts: tuple[Contact, ...]
    doors: tuple[Door, ...]
    storeys: int
    turn_deg: float
    attached: tuple[Facade, ...]
    mass: Mass
    U_wall_inside: float
    U_floor_inside: float
    g_value: float
    unshaded: float
    air_changes_1_h: float
    pattern: Pattern
    people: int
    gains_home_W_m2: float
    gains_empty_W_m2: float
    gains_sd: float
    weather_seed: int
    warmer_K: float
    clearer: float
    sizing: float
    curves: dict[RoomEmitter, Curve]
    heat_pump: HeatPump

    @property
    def name(self) -> str:
        """Name from which the house can be drawn again, see `house_of_rooms`."""
        return f"{self.use}:{len(self.rooms)}rooms:{self.seed}"

    @property
    def floor_area_m2(self) -> float:
        """Floor area of all rooms, m²."""
        return sum(room.area_m2 for room in self.rooms)

    @property
    def design_out_C(self) -> float:
        """Design outdoor temperature, °C."""
        return DESIGN_OUT_C + self.warmer_K

    def ventilation_W_K(self, room: Room) -> float:
        """Heat loss of a room by the mean infiltration, W/K."""
        return AIR_WH_M3_K * HEIGHT_M * room.area_m2 * self.air_changes_1_h

    @property
    def loss_W_K(self) -> float:
        """Heat loss coefficient to outdoors, ground excluded, W/K."""
        return sum(room.opaque_W_K + room.windows_W_K + self.ventilation_W_K(room) for room in self.rooms)

    @property
    def design_load_W(self) -> float:
        """Heat load at the design outdoor temperature and 20 °C in all rooms, without gains, W (EN 12831)."""
        ground_W = sum(room.ground_W_K for room in self.rooms) * (DESIGN_ROOM_C - ground_C(self.warmer_K))
        return self.loss_W_K * (DESIGN_ROOM_C - self.design_out_C) + ground_W

    @property
    def words(self) -> str:
        """The house in one line."""
        area = self.floor_area_m2
        kinds = ", ".join(f"{room.name} ({room.emitter})" for room in self.rooms)
        return (
            f"{len(self.rooms)} rooms on {self.storeys} storey{'s' if self.storeys > 1 else ''}, {area:.0f} m2 "
            f"{self.mass}, {self.loss_W_K / area:.1f} W/m2K, heat pump {self.heat_pump.capacity_W / 1e3:.1f} kW "
            f"(x{self.sizing:.1f}), {self.pattern}: {kinds}"
        )


def core_W_m2K(U_W_m2K: float) -> float:
    """Return the conductance between the structures of two rooms, W/m²K, of a wall of `U_W_m2K` from air to air."""
    return 1.0 / (1.0 / U_W_m2K - 2.0 * _INSIDE_FILM_M2K_W)


def curve_supply_C(
    design_C: float, exponent: float, shift_K: float, limit_C: float, design_out_C: float, T_out_C: float
) -> float:
    """Return the supply temperature of a heating curve, see `Curve`, °C; arguments in °C and K."""
    load = max((20.0 - T_out_C) / (20.0 - design_out_C), 0.0)
    return float(min(20.0 + shift_K + (design_C - 20.0) * load ** (1.0 / exponent), limit_C))


def full_capacity_W(capacity_W: float, per_K: float, design_out_C: float, T_out_C: float) -> float:
    """Return the heat pump's capacity at `T_out_C`, W: between 0.5 and 1.6 times that at design."""
    return capacity_W * min(max(1.0 + per_K * (T_out_C - design_out_C), 0.5), 1.6)
