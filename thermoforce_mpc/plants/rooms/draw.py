"""Seeded draw of a building of rooms. Sources: docs/how-it-works/random-buildings.md, and in `house`."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import ZERO_C_K, Array
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.drawn_houses import (
    AIR_WH_M3_K,
    DESIGN_OUT_C,
    DESIGN_ROOM_C,
    FACADES,
    FLOOR_LIMIT_W_M2,
    HEIGHT_M,
    WATER_J_KG_K,
    Facade,
    Mass,
    air_changes_1_h,
    climate,
    glazing_of,
    ground_C,
    opaque_U_W_m2K,
)
from thermoforce_mpc.plants.embedded import heat_pump as emulator
from thermoforce_mpc.plants.rooms.house import (
    HOUSE,
    Contact,
    Curve,
    Door,
    DrawnHouse,
    HeatPump,
    Kind,
    Place,
    Room,
    RoomEmitter,
    Use,
    contacts,
    facade_lengths,
    lay_out,
)

MOST_ROOMS = 30


# Share of a heated floor with pipes; resistance from water to screed, m²K/W (Koschenz and Lehmann 2000); surface film,
# W/m²K (EN 1264-5).
_COVERED, _PIPE_M2K_W, _FILM_W_M2K = 0.85, 0.10, 10.8
# Exponent of the heat over the excess of the water, and share that goes to the air, of radiators and fan coils.
_WATER_TO_ROOM: dict[RoomEmitter, tuple[float, float]] = {"radiator": (1.3, 0.7), "air": (1.0, 1.0)}
_SPREAD_K: dict[RoomEmitter, float] = {"floor": 5.0, "radiator": 7.0, "air": 5.0}
_LIMIT_C: dict[RoomEmitter, float] = {"floor": 45.0, "radiator": 60.0, "air": 60.0}
# Water and metal of a fan coil hold as much heat as it gives in this time, s (as in generated houses).
_COIL_S = 270.0
# Air through a door: a closed one leaks about 5 W/K; an open one of 0.9 m by 2 m exchanges 121 W/K^1.5
# (ρ c Cd/3 W H^1.5 √(g/T), Cd 0.65: Brown and Solvason 1962).
_OPEN_DOOR_W_K15 = 121.0
# Emitters are sized for the lowest temperature in use plus this, K.
_DESIGN_ABOVE_K = 1.0
# Least emitter, W, so that every valve has something to do.
_LEAST_EMITTER_W = 150.0


def emulator_fixed_share() -> float:
    """Return the fixed power of the emulator's heat pump over its heat at A2/W35; air and refrigerant are 4 K apart."""
    _, heat_W, _ = emulator.heat_pump(2.0 - 4.0 + ZERO_C_K, 35.0 + ZERO_C_K, 1.0)
    return float((emulator.CONSTANT_LOSS_W + emulator.FAN_W + emulator.PUMP_W) / heat_W)


def draw_rooms(n_rooms: int, seed: int, use: Use = HOUSE) -> DrawnHouse:
    """Draw a house, or an office, of `n_rooms` rooms; the same arguments give the same one.

    Every distribution is given here; sources in docs/how-it-works/random-buildings.md. Raises `InputError` where
    `n_rooms` is not a whole number from 1 to 30.
    """
    if isinstance(n_rooms, bool) or not isinstance(n_rooms, int | np.integer) or not 1 <= n_rooms <= MOST_ROOMS:
        raise InputError(f"{use.name} of {n_rooms!r} rooms: expected a whole number from 1 to {MOST_ROOMS}")
    rng = np.random.default_rng([seed, n_rooms, 3])
    kinds = [*use.first, *itertools.islice(itertools.cycle(use.further), n_rooms)][:n_rooms]
    storeys = 1 if n_rooms < 4 else 2 if n_rooms >= 12 else int(rng.choice([1, 2], p=[0.4, 0.6]))
    areas = [rng.uniform(*use.kinds[kind].area_m2) for kind in kinds]
    kinds, levels = _storeys(kinds, areas, storeys, use)
    places = lay_out(rng, levels, rng.uniform(1.1, 1.8))
    touching = contacts([place for storey in places for place in storey], HEIGHT_M)
    building = _building(rng, use)
    shell = _shell(rng, building, kinds, places, use)
    lower = [float(rng.choice(use.kinds[kind].lower_C)) for kind in kinds]
    upper = [T + float(rng.choice(use.kinds[kind].band_K)) for T, kind in zip(lower, kinds, strict=True)]
    doors = _doors(rng, kinds, touching, use)
    warm = np.array(lower) + _DESIGN_ABOVE_K
    load_W = _load_W(building, shell, warm, touching, doors)
    emitter_W = np.maximum(load_W * rng.uniform(*use.emitters_over_load, n_rooms), _LEAST_EMITTER_W)
    heating = _heating(rng, emitter_W, warm, shell, use)
    house_W = shell.loss_W_K * (DESIGN_ROOM_C - building.design_out_C)
    house_W += float(shell.ground_W_K.sum()) * (DESIGN_ROOM_C - ground_C(building.warmer_K))
    sizes = use.machine_over_load
    sizing = rng.uniform(*list(sizes)[rng.choice(len(sizes), p=list(sizes.values()))])
    pattern = list(use.patterns)[rng.choice(len(use.patterns), p=list(use.patterns.values()))]
    return DrawnHouse(
        use=use.name,
        seed=seed,
        rooms=_rooms(kinds, shell, lower, upper, heating, use),
        contacts=tuple(touching),
        doors=doors,
        storeys=storeys,
        turn_deg=building.turn_deg,
        attached=building.attached,
        mass=building.mass,
        U_wall_inside=building.U_wall_inside,
        U_floor_inside=building.U_floor_inside,
        g_value=building.g_value,
        unshaded=building.unshaded,
        air_changes_1_h=building.air_changes_1_h,
        pattern=pattern,
        people=max(1, round(float(shell.area_m2.sum()) / rng.uniform(*use.person_m2))),
        gains_home_W_m2=float(rng.uniform(*use.gains_W_m2)),
        gains_empty_W_m2=float(rng.uniform(*use.gains_empty_W_m2)),
        gains_sd=0.5,
        weather_seed=int(rng.integers(1, 2**31)),
        warmer_K=building.warmer_K,
        clearer=building.clearer,
        sizing=float(sizing),
        curves=heating.curves,
        heat_pump=_heat_pump(rng, float(sizing * house_W), building.design_out_C),
    )


class _Building(NamedTuple):
    """What all rooms share: U-values W/m²K, and the rest as in `DrawnHouse`."""

    U_opaque: float
    U_window: float
    g_value: float
    unshaded: float
    air_changes_1_h: float
    U_ground: float
    U_wall_inside: float
    U_floor_inside: float
    attached: tuple[Facade, ...]
    turn_deg: float
    mass: Mass
    warmer_K: float
    clearer: float

    @property
    def design_out_C(self) -> float:
        """Design outdoor temperature, °C."""
        return DESIGN_OUT_C + self.warmer_K


def _building(rng: np.random.Generator, use: Use) -> _Building:
    age = rng.uniform(*use.age)
    U_opaque, (U_window, g_value) = opaque_U_W_m2K(rng, age), glazing_of(age)
    unshaded, changes, U_ground = float(rng.uniform(*use.unshaded)), air_changes_1_h(rng, age), rng.uniform(0.15, 0.30)
    U_wall, U_floor = float(rng.uniform(1.2, 2.2)), float(rng.uniform(0.6, 1.2))
    attached: tuple[Facade, ...] = ((), ("west",), ("east",), ("west", "east"))[rng.choice(4, p=[0.5, 0.15, 0.15, 0.2])]
    turn, mass = float(rng.uniform(-45.0, 45.0)), use.masses[rng.integers(len(use.masses))]
    of_use = U_opaque, U_window, g_value, unshaded, changes, U_ground, U_wall, U_floor
    return _Building(*of_use, attached, turn, mass, *climate(rng))


class _Shell(NamedTuple):
    """Places and areas of rooms (n,), outside walls and windows of each by `FACADES` (n, 4), and what it loses (n,):
    through walls and roof, through windows, to the ground, and to outdoors in all, with infiltration.
    """

    places: list[Place]
    walls_m2: Array
    windows_m2: Array
    area_m2: Array
    at_ground: NDArray[np.bool_]
    opaque_W_K: Array
    windows_W_K: Array
    ground_W_K: Array
    outdoors_W_K: Array

    @property
    def loss_W_K(self) -> float:
        """Loss of all rooms to outdoors, W/K."""
        return float(self.outdoors_W_K.sum())


def _shell(
    rng: np.random.Generator, building: _Building, kinds: list[Kind], places: list[list[Place]], use: Use
) -> _Shell:
    """Draw the windows: glazing per floor area on the facades by their length, at most 60 % of a wall."""
    flat = [place for storey in places for place in storey]
    walls, windows = np.zeros((len(flat), 4)), np.zeros((len(flat), 4))
    for i, (kind, place) in enumerate(zip(kinds, flat, strict=True)):
        walls[i] = HEIGHT_M * np.array(facade_lengths(place, places[place.storey]))
        walls[i, [FACADES.index(facade) for facade in building.attached]] = 0.0
        glazing = rng.uniform(*use.kinds[kind].glazing) * place.area_m2
        windows[i] = np.minimum(glazing * walls[i] / max(walls[i].sum(), 1e-9), 0.6 * walls[i])
    area = np.array([place.area_m2 for place in flat])
    under_roof = np.array([place.storey == len(places) - 1 for place in flat])
    at_ground = np.array([place.storey == 0 for place in flat])
    opaque = building.U_opaque * ((walls - windows).sum(axis=1) + 0.8 * area * under_roof)
    glass, ground = building.U_window * windows.sum(axis=1), building.U_ground * area * at_ground
    outdoors = opaque + glass + AIR_WH_M3_K * HEIGHT_M * area * building.air_changes_1_h
    return _Shell(flat, walls, windows, area, at_ground, opaque, glass, ground, outdoors)


def _load_W(
    building: _Building, shell: _Shell, warm_C: Array, touching: list[Contact], doors: tuple[Door, ...]
) -> Array:
    """Heat load of rooms at `warm_C` (n,), W, heat to colder neighbours included (EN 12831)."""
    load = shell.outdoors_W_K * (warm_C - building.design_out_C)
    load += shell.ground_W_K * (warm_C - ground_C(building.warmer_K))
    for contact in touching:
        U = building.U_wall_inside if contact.kind == "wall" else building.U_floor_inside
        for i, j in ((contact.first, contact.second), (contact.second, contact.first)):
            load[i] += U * contact.area_m2 * max(warm_C[i] - warm_C[j], 0.0)
    for door in doors:
        for i, j in ((door.first, door.second), (door.second, door.first)):
            warmer_by = max(warm_C[i] - warm_C[j], 0.0)
            load[i] += (door.leak_W_K + door.open_W_K15 * warmer_by**0.5) * warmer_by
    return load


class _Heating(NamedTuple):
    """Emitter of each room, what it gives at design, W (n,), and the fields of a `Room` of its circuit; the curves of
    the heat pump by emitter.
    """

    emitters: list[RoomEmitter]
    emitter_W: Array
    circuits: list[dict[str, float]]
    curves: dict[RoomEmitter, Curve]


def _heating(rng: np.random.Generator, emitter_W: Array, warm_C: Array, shell: _Shell, use: Use) -> _Heating:
    """Draw emitters: floors in all rooms, on the ground floor only, or others; never floors where the load is too high.

    `emitter_W`, `warm_C` (n,): heat and temperature of each room at design.
    """
    area = shell.area_m2
    style = rng.choice(list(use.emitters), p=list(use.emitters.values()))
    other: RoomEmitter = "air" if style == "air" else "radiator"
    wanted = shell.at_ground if style == "floor below" else np.full(len(area), style == "floor")
    floors = wanted & (emitter_W <= FLOOR_LIMIT_W_M2 * area)
    emitters: list[RoomEmitter] = ["floor" if floor else other for floor in floors]
    covering = rng.uniform(0.01, 0.10)  # m²K/W
    screed = rng.uniform(0.045, 0.075)
    excess = rng.uniform(18.0, 28.0)  # mean radiator water over 20 °C: sized for a heat pump
    over_K = excess + DESIGN_ROOM_C - warm_C
    each = zip(emitters, emitter_W, area, over_K, strict=True)
    circuits = [_circuit(*one, covering, screed) for one in each]
    shift = float(rng.uniform(2.0, 4.0))  # as installers set a curve: some reserve, which the valves take back
    curves: dict[RoomEmitter, Curve] = {}
    if "floor" in emitters:
        # The room that needs the warmest water sets the curve of all floors.
        mean_C = warm_C + emitter_W * (_PIPE_M2K_W + 1.0 / _FILM_W_M2K + covering) / (_COVERED * area)
        hottest_C = float(mean_C[floors].max()) + 0.5 * _SPREAD_K["floor"]
        curves["floor"] = Curve(min(hottest_C, _LIMIT_C["floor"]), 1.0, shift, _LIMIT_C["floor"])
    if other in emitters:
        hottest_C = float(DESIGN_ROOM_C + excess + 0.5 * _SPREAD_K[other])
        curves[other] = Curve(hottest_C, _WATER_TO_ROOM[other][0], shift, _LIMIT_C[other])
    return _Heating(emitters, emitter_W, circuits, curves)


def _heat_pump(rng: np.random.Generator, capacity_W: float, design_out_C: float) -> HeatPump:
    """Draw a heat pump of a capacity at the design outdoor temperature."""
    per_K = 0.02  # air-source data sheets
    return HeatPump(
        capacity_W=capacity_W,
        capacity_per_K=per_K,
        lowest_level=float(rng.uniform(0.20, 0.35)),
        carnot=float(rng.uniform(0.60, 0.72)),  # the emulator's without its fixed part: 0.71 at A2/W35
        fixed_W=emulator_fixed_share() * capacity_W * (1.0 + per_K * (2.0 - design_out_C)),
    )


def _rooms(
    kinds: list[Kind], shell: _Shell, lower: list[float], upper: list[float], heating: _Heating, use: Use
) -> tuple[Room, ...]:
    """The rooms, of which all is drawn, with the shares of the people in them."""
    people_day, people_night = _people(kinds, use)
    return tuple(
        Room(
            name=name,
            kind=kinds[i],
            place=shell.places[i],
            walls_m2=tuple(float(value) for value in shell.walls_m2[i]),  # type: ignore[arg-type]
            windows_m2=tuple(float(value) for value in shell.windows_m2[i]),  # type: ignore[arg-type]
            opaque_W_K=float(shell.opaque_W_K[i]),
            windows_W_K=float(shell.windows_W_K[i]),
            ground_W_K=float(shell.ground_W_K[i]),
            lower_C=lower[i],
            upper_C=upper[i],
            appliances=use.kinds[kinds[i]].appliances,
            people_day=float(people_day[i]),
            people_night=float(people_night[i]),
            emitter=heating.emitters[i],
            emitter_W=float(heating.emitter_W[i]),
            flow_W_K=float(2.0 * heating.emitter_W[i] / _SPREAD_K[heating.emitters[i]]),
            **heating.circuits[i],
        )
        for i, name in enumerate(_names(kinds))
    )


def _circuit(
    emitter: RoomEmitter, emitter_W: float, area_m2: float, over_K: float, covering: float, screed_m: float
) -> dict[str, float]:
    """Return the fields of a `Room` of its emitter; `over_K`: its mean water over the room at design."""
    if emitter == "floor":
        covered = _COVERED * area_m2
        return {
            "emitter_J_K": float(1.2 * covered * WATER_J_KG_K),
            "emitter_W_Kn": float(covered / _PIPE_M2K_W),
            "emitter_exponent": 1.0,
            "convective": 0.0,
            "slab_J_K": float(covered * screed_m * 2000.0 * 1000.0),
            "slab_room_W_K": float(covered / (1.0 / _FILM_W_M2K + covering)),
        }
    exponent, convective = _WATER_TO_ROOM[emitter]
    # EN 442: type 22 panels hold 6 l and 28 kg of steel per kW at 50 K, plus 5 l/kW in pipes.
    per_kW = (11.0 * WATER_J_KG_K + 28.0 * 460.0) * (50.0 / over_K) ** exponent
    return {
        "emitter_J_K": float(_COIL_S * emitter_W / over_K if emitter == "air" else per_kW * emitter_W / 1e3),
        "emitter_W_Kn": float(emitter_W / over_K**exponent),
        "emitter_exponent": exponent,
        "convective": convective,
        "slab_J_K": 0.0,
        "slab_room_W_K": 0.0,
    }


def _storeys(kinds: list[Kind], areas: list[float], storeys: int, use: Use) -> tuple[list[Kind], list[list[float]]]:
    """Return the kinds from the ground up and the areas by storey, those of two storeys scaled to the same sum."""
    halls = 0
    keys = []
    for i, kind in enumerate(kinds):
        halls += kind == "hall"
        upstairs = kind == "hall" and halls % 2 == 0
        keys.append((len(use.from_the_ground) if upstairs else use.from_the_ground.index(kind), i))
    order = [i for _, i in sorted(keys)]
    if storeys == 1:
        return [kinds[i] for i in order], [[areas[i] for i in order]]
    total = np.cumsum([areas[i] for i in order])
    below = int(np.clip(np.argmin(np.abs(total - 0.5 * total[-1])) + 1, 1, len(order) - 1))
    levels = [[areas[i] for i in order[:below]], [areas[i] for i in order[below:]]]
    levels = [[area * 0.5 * total[-1] / sum(level) for area in level] for level in levels]
    return [kinds[i] for i in order], levels


def _names(kinds: list[Kind]) -> list[str]:
    """Return the kind, numbered where there are several of it."""
    seen: dict[Kind, int] = {}
    names = []
    for kind in kinds:
        seen[kind] = seen.get(kind, 0) + 1
        names.append(f"{kind}_{seen[kind]}" if kinds.count(kind) > 1 else kind)
    return names


def _people(kinds: list[Kind], use: Use) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of the people present in each room by day and by night, each of sum 1."""
    day = np.array([use.kinds[kind].people_day for kind in kinds])
    night = np.array([use.kinds[kind].people_night for kind in kinds])
    if not night.any():
        night = day
    return day / day.sum(), night / night.sum()


def _doors(rng: np.random.Generator, kinds: list[Kind], touching: list[Contact], use: Use) -> tuple[Door, ...]:
    """Return doors so that every room can be reached, by way of halls and living rooms where there are, and a stair.

    A spanning tree of the contacts (Kruskal): walls shorter than a door come last, floors are crossed once.
    """
    rank = {kind: of.private for kind, of in use.kinds.items()}

    def cost(contact: Contact) -> float:
        a, b = rank[kinds[contact.first]], rank[kinds[contact.second]]
        short = contact.kind == "wall" and contact.length_m < 0.9
        return min(a, b) + 0.1 * max(a, b) + (10.0 if short else 0.0) + (100.0 if contact.kind == "floor" else 0.0)

    group = list(range(len(kinds)))
    doors = []
    for contact in sorted(touching, key=cost):
        a, b = group[contact.first], group[contact.second]
        if a == b:
            continue
        group = [a if g == b else g for g in group]
        low, high = (0.5, 1.0)  # of a stairwell
        if contact.kind == "wall":
            tighter = max((kinds[contact.first], kinds[contact.second]), key=lambda kind: rank[kind])
            low, high = use.kinds[tighter].openness
        leak_W_K, open_share = float(rng.uniform(3.0, 8.0)), rng.uniform(low, high)
        doors.append(Door(contact.first, contact.second, leak_W_K, float(_OPEN_DOOR_W_K15 * open_share)))
    return tuple(doors)
