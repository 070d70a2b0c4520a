"""What a building of rooms is used for: its kinds of rooms, and the ranges that its draw depends on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from thermoforce_mpc.plants.drawn_houses import MASSES, Mass
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
