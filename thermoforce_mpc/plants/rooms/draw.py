"""Seeded draw of a building of rooms. Sources: docs/how-it-works/random-buildings.md, and in `house`."""

from __future__ import annotations

import itertools

import numpy as np

from thermoforce_mpc.data import ZERO_C_K
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.drawn_houses import AIR_WH_M3_K, FACADES, HEIGHT_M, WATER_J_KG_K, Facade
from thermoforce_mpc.plants.embedded import heat_pump as emulator
from thermoforce_mpc.plants.random_houses.draw import ground_C
from thermoforce_mpc.plants.rooms.house import (
    DESIGN_OUT_C,
    DESIGN_ROOM_C,
    HOUSE,
    Contact,
    Curve,
    Door,
    DrawnHouse,
    HeatPump,
    Kind,
    Room,
    RoomEmitter,
    Use,
    contacts,
    facade_lengths,
    lay_out,
)

MOST_ROOMS = 30


# Output of floor heating that rooms may need, W/m² (EN 1264-2: 100 at a surface of 29 °C), and share of the floor with
# pipes; resistance from water to screed, m²K/W (Koschenz and Lehmann 2000); surface film, W/m²K (EN 1264-5).
_FLOOR_LIMIT_W_M2, _COVERED, _PIPE_M2K_W, _FILM_W_M2K = 70.0, 0.85, 0.10, 10.8
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
    flat = [place for storey in places for place in storey]
    touching = contacts(flat, HEIGHT_M)

    age = rng.uniform(*use.age)
    U_opaque = 0.15 * 8.0 ** (age * rng.uniform(0.85, 1.0))
    U_window, g_value = 0.8 + 2.0 * age, 0.5 + 0.25 * age  # triple to double glazing, EN 673 and EN 410
    unshaded = rng.uniform(*use.unshaded)
    air_changes = rng.uniform(0.15, 0.35) + 0.45 * age * rng.uniform(0.5, 1.0)
    U_ground = rng.uniform(0.15, 0.30)
    U_wall, U_floor = rng.uniform(1.2, 2.2), rng.uniform(0.6, 1.2)
    attached: tuple[Facade, ...] = ((), ("west",), ("east",), ("west", "east"))[rng.choice(4, p=[0.5, 0.15, 0.15, 0.2])]
    turn = rng.uniform(-45.0, 45.0)
    mass = use.masses[rng.integers(len(use.masses))]
    warmer, clearer = rng.uniform(-4.0, 4.0), rng.uniform(-0.3, 0.8)
    design_out = DESIGN_OUT_C + warmer

    # Outside walls and windows: glazing per floor area on the facades by their length, at most 60 % of a wall.
    walls, windows = np.zeros((n_rooms, 4)), np.zeros((n_rooms, 4))
    for i, (kind, place) in enumerate(zip(kinds, flat, strict=True)):
        walls[i] = HEIGHT_M * np.array(facade_lengths(place, places[place.storey]))
        walls[i, [FACADES.index(facade) for facade in attached]] = 0.0
        glazing = rng.uniform(*use.kinds[kind].glazing) * place.area_m2
        windows[i] = np.minimum(glazing * walls[i] / max(walls[i].sum(), 1e-9), 0.6 * walls[i])
    area = np.array([place.area_m2 for place in flat])
    under_roof = np.array([place.storey == storeys - 1 for place in flat])
    at_ground = np.array([place.storey == 0 for place in flat])
    opaque = U_opaque * ((walls - windows).sum(axis=1) + 0.8 * area * under_roof)
    glass = U_window * windows.sum(axis=1)
    ground = U_ground * area * at_ground

    # Heat load of each room 1 K above its lowest temperature in use, heat to colder neighbours included (EN 12831).
    lower = [float(rng.choice(use.kinds[kind].lower_C)) for kind in kinds]
    upper = [T + float(rng.choice(use.kinds[kind].band_K)) for T, kind in zip(lower, kinds, strict=True)]
    warm = np.array(lower) + _DESIGN_ABOVE_K
    load = (opaque + glass + AIR_WH_M3_K * HEIGHT_M * area * air_changes) * (warm - design_out)
    load += ground * (warm - ground_C(warmer))
    for contact in touching:
        U = U_wall if contact.kind == "wall" else U_floor
        for i, j in ((contact.first, contact.second), (contact.second, contact.first)):
            load[i] += U * contact.area_m2 * max(warm[i] - warm[j], 0.0)
    doors = _doors(rng, kinds, touching, use)
    for door in doors:
        for i, j in ((door.first, door.second), (door.second, door.first)):
            warmer_by = max(warm[i] - warm[j], 0.0)
            load[i] += (door.leak_W_K + door.open_W_K15 * warmer_by**0.5) * warmer_by
    emitter_W = np.maximum(load * rng.uniform(*use.emitters_over_load, n_rooms), _LEAST_EMITTER_W)

    # Emitters: floors in all rooms, on the ground floor only, or others; never floors where the load is too high.
    style = rng.choice(list(use.emitters), p=list(use.emitters.values()))
    other: RoomEmitter = "air" if style == "air" else "radiator"
    wanted = at_ground if style == "floor below" else np.full(n_rooms, style == "floor")
    can = emitter_W <= _FLOOR_LIMIT_W_M2 * area
    emitters: list[RoomEmitter] = ["floor" if floor else other for floor in wanted & can]
    covering = rng.uniform(0.01, 0.10)  # m²K/W
    screed = rng.uniform(0.045, 0.075)
    excess = rng.uniform(18.0, 28.0)  # mean radiator water over 20 °C: sized for a heat pump
    people_day, people_night = _people(kinds, use)
    names = _names(kinds)
    rooms = []
    for i, kind in enumerate(kinds):
        rooms.append(
            Room(
                name=names[i],
                kind=kind,
                place=flat[i],
                walls_m2=tuple(float(value) for value in walls[i]),  # type: ignore[arg-type]
                windows_m2=tuple(float(value) for value in windows[i]),  # type: ignore[arg-type]
                opaque_W_K=float(opaque[i]),
                windows_W_K=float(glass[i]),
                ground_W_K=float(ground[i]),
                lower_C=lower[i],
                upper_C=upper[i],
                appliances=use.kinds[kind].appliances,
                people_day=float(people_day[i]),
                people_night=float(people_night[i]),
                emitter=emitters[i],
                emitter_W=float(emitter_W[i]),
                flow_W_K=float(2.0 * emitter_W[i] / _SPREAD_K[emitters[i]]),
                **_circuit(emitters[i], emitter_W[i], area[i], excess + DESIGN_ROOM_C - warm[i], covering, screed),
            )
        )
    shift = rng.uniform(2.0, 4.0)  # as installers set a curve: some reserve, which the valves take back
    curves: dict[RoomEmitter, Curve] = {}
    if "floor" in emitters:
        # The room that needs the warmest water sets the curve of all floors.
        mean_C = warm + emitter_W * (_PIPE_M2K_W + 1.0 / _FILM_W_M2K + covering) / (_COVERED * area)
        hottest_C = float(mean_C[wanted & can].max()) + 0.5 * _SPREAD_K["floor"]
        curves["floor"] = Curve(min(hottest_C, _LIMIT_C["floor"]), 1.0, float(shift), _LIMIT_C["floor"])
    if other in emitters:
        hottest_C = float(DESIGN_ROOM_C + excess + 0.5 * _SPREAD_K[other])
        curves[other] = Curve(hottest_C, _WATER_TO_ROOM[other][0], float(shift), _LIMIT_C[other])

    loss = float((opaque + glass + AIR_WH_M3_K * HEIGHT_M * area * air_changes).sum())
    house_W = loss * (DESIGN_ROOM_C - design_out) + float(ground.sum()) * (DESIGN_ROOM_C - ground_C(warmer))
    sizes = use.machine_over_load
    sizing = rng.uniform(*list(sizes)[rng.choice(len(sizes), p=list(sizes.values()))])
    capacity, per_K = sizing * house_W, 0.02  # air-source data sheets
    pattern = list(use.patterns)[rng.choice(len(use.patterns), p=list(use.patterns.values()))]
    return DrawnHouse(
        use=use.name,
        seed=seed,
        rooms=tuple(rooms),
        contacts=tuple(touching),
        doors=doors,
        storeys=storeys,
        turn_deg=float(turn),
        attached=attached,
        mass=mass,
        U_wall_inside=float(U_wall),
        U_floor_inside=float(U_floor),
        g_value=float(g_value),
        unshaded=float(unshaded),
        air_changes_1_h=float(air_changes),
        pattern=pattern,
        people=max(1, round(float(area.sum()) / rng.uniform(*use.person_m2))),
        gains_home_W_m2=float(rng.uniform(*use.gains_W_m2)),
        gains_empty_W_m2=float(rng.uniform(*use.gains_empty_W_m2)),
        gains_sd=0.5,
        weather_seed=int(rng.integers(1, 2**31)),
        warmer_K=float(warmer),
        clearer=float(clearer),
        sizing=float(sizing),
        curves=curves,
        heat_pump=HeatPump(
            capacity_W=float(capacity),
            capacity_per_K=per_K,
            lowest_level=float(rng.uniform(0.20, 0.35)),
            carnot=float(rng.uniform(0.60, 0.72)),  # the emulator's without its fixed part: 0.71 at A2/W35
            fixed_W=emulator_fixed_share() * float(capacity) * (1.0 + per_K * (2.0 - design_out)),
        ),
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
