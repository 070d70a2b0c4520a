"""Equations of a house of rooms: five nodes a room, walls and doors between them, valves, one heat pump; 30-s steps.

Nodes of a room: emitter water, slab, surfaces, air, structure, as in a generated house. Structures of neighbours are
coupled through walls and floors, their air through doors, by the root of the temperature difference.

All couplings are implicit (backward Euler) and every heat flow leaves one node and enters another, or crosses the
boundary and is recorded: the energy balance closes to rounding. What a circuit takes from the heat pump follows from
its temperatures, and a door's exchange and a radiator's coefficient from those, at the start of the step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.plants import drawn_houses
from thermoforce_mpc.plants.random_houses.draw import heat_pump_cop
from thermoforce_mpc.plants.rooms.device import (
    BUFFER,
    CHARGES,
    DEFROST_POWER,
    RAISE,
    RECOMMENDED,
    STANDBY,
    TANK_OVER,
    heat_of_device,
    switched,
)
from thermoforce_mpc.plants.rooms.device import TANK as TANK_STATE
from thermoforce_mpc.plants.rooms.house import DrawnHouse, core_W_m2K, curve_supply_C, full_capacity_W

# Blocks of nodes, each of one node a room. Nodes with few neighbours come first, which keeps the elimination sparse.
WATER, SLAB, SURFACE, AIR, MASS = range(5)
N_BLOCKS = 5
# Weather columns, interpolated: °C, W/m²; then the sun through each room's windows, W, and each room's air change
# relative to the mean infiltration.
T_OUT, GLOBAL, SUN = range(3)
# Record of a step: machine, house and tank (°C, NaN without one); then for each room operative temperature °C, level,
# heat to its circuit W, and water that flows into it °C, which is mixed down to what its curve asks for.
POWER, HEAT, SUPPLY, OUTDOOR, SOLAR, LOSS, GAIN, STORED, TANK, ROOMS = range(10)

# Native thermostats: half of the dead band, K.
DEAD_BAND_K = 0.25
_LEAST_EXCESS_K = 0.01
# Halvings of the supply temperature when the machine is too small for the open valves: 1e-7 K.
_HALVINGS = 30

# Parameters of the heat pump; of a circuit's heating curve.
CAPACITY, CAPACITY_K, DESIGN_OUT, LOWEST, CARNOT, FIXED = range(6)
DESIGN, EXPONENT, SHIFT, LIMIT = range(4)

_cop = njit(cache=True)(heat_pump_cop)
_supply = njit(cache=True)(curve_supply_C)
_capacity = njit(cache=True)(full_capacity_W)


class HouseNetwork(NamedTuple):
    """Parameters of a house for `advance`, SI units and °C; Z rooms, D doors, n = 5 Z nodes in blocks of Z.

    `capacity_J_K` (n,), `between_W_K` (n, n) symmetric constant couplings, `outdoors_W_K` and `ground_W_K` (n,).
    `ventilation_W_K` (Z,) at mean wind. `door_rooms` (D, 2), `door_leak_W_K` and `door_open` (D,), W/K and W/K^1.5.
    `strength`, `exponent`, `convective`, `is_floor`, `flow_W_K` of the emitters (Z,), `curve` (Z, 4). `mass_share` of
    radiant gains that falls on the structure. `heat_pump` (6,).
    """

    capacity_J_K: np.ndarray
    between_W_K: np.ndarray
    outdoors_W_K: np.ndarray
    ground_W_K: np.ndarray
    ground_C: float
    ventilation_W_K: np.ndarray
    door_rooms: np.ndarray
    door_leak_W_K: np.ndarray
    door_open: np.ndarray
    strength: np.ndarray
    exponent: np.ndarray
    convective: np.ndarray
    is_floor: np.ndarray
    flow_W_K: np.ndarray
    curve: np.ndarray
    mass_share: float
    heat_pump: np.ndarray


def network(house: DrawnHouse) -> HouseNetwork:
    """Return the parameters of a house."""
    rooms, n = house.rooms, len(house.rooms)
    area = np.array([room.area_m2 for room in rooms])
    mass_area, mass_J_K = drawn_houses.MASSES[house.mass]
    floor = np.array([room.emitter == "floor" for room in rooms])
    surface_J_K = drawn_houses.SURFACE_J_M2_K * drawn_houses.SURFACE_PER_FLOOR * area
    # A room without a slab has a node that is coupled to nothing.
    slab_J_K = np.array([room.slab_J_K or 1.0 for room in rooms])
    water_J_K = np.array([room.emitter_J_K for room in rooms])
    capacity = np.concatenate(
        [water_J_K, slab_J_K, surface_J_K, drawn_houses.AIR_J_M2_K * area, mass_J_K * area - surface_J_K]
    )

    between = np.zeros((N_BLOCKS * n, N_BLOCKS * n))

    def couple(a: int, b: int, W_K: float) -> None:
        between[a, b] += W_K
        between[b, a] += W_K

    to_mass = drawn_houses.SURFACE_MASS_W_M2_K * mass_area * area
    outdoors, ground = np.zeros(N_BLOCKS * n), np.zeros(N_BLOCKS * n)
    for i, room in enumerate(rooms):
        couple(SURFACE * n + i, AIR * n + i, drawn_houses.SURFACE_AIR_W_M2_K * drawn_houses.SURFACE_PER_FLOOR * area[i])
        couple(SURFACE * n + i, MASS * n + i, to_mass[i])
        outdoors[SURFACE * n + i] = room.windows_W_K
        outdoors[MASS * n + i] = 1.0 / (1.0 / room.opaque_W_K - 1.0 / to_mass[i])
        ground[(SLAB if floor[i] else MASS) * n + i] = room.ground_W_K
        if floor[i]:
            couple(SLAB * n + i, SURFACE * n + i, room.slab_room_W_K)
            couple(WATER * n + i, SLAB * n + i, room.emitter_W_Kn)
    for contact in house.contacts:
        U = house.U_wall_inside if contact.kind == "wall" else house.U_floor_inside
        # Below a heated floor the screed itself is the warm side of the floor.
        upper = SLAB if contact.kind == "floor" and floor[contact.second] else MASS
        couple(MASS * n + contact.first, upper * n + contact.second, core_W_m2K(U) * contact.area_m2)

    pump = house.heat_pump
    curves = [house.curves[room.emitter] for room in rooms]
    return HouseNetwork(
        capacity_J_K=capacity,
        between_W_K=between,
        outdoors_W_K=outdoors,
        ground_W_K=ground,
        ground_C=drawn_houses.ground_C(house.warmer_K),
        ventilation_W_K=np.array([house.ventilation_W_K(room) for room in rooms]),
        door_rooms=np.array([(door.first, door.second) for door in house.doors], dtype=np.int64).reshape(-1, 2),
        door_leak_W_K=np.array([door.leak_W_K for door in house.doors]),
        door_open=np.array([door.open_W_K15 for door in house.doors]),
        strength=np.array([room.emitter_W_Kn for room in rooms]),
        exponent=np.array([room.emitter_exponent for room in rooms]),
        convective=np.array([room.convective for room in rooms]),
        is_floor=floor,
        flow_W_K=np.array([room.flow_W_K for room in rooms]),
        curve=np.array([(c.design_C, c.exponent, c.shift_K, c.limit_C) for c in curves]),
        mass_share=mass_area / drawn_houses.SURFACE_PER_FLOOR,
        heat_pump=np.array(
            [pump.capacity_W, pump.capacity_per_K, house.design_out_C, pump.lowest_level, pump.carnot, pump.fixed_W]
        ),
    )


@njit(cache=True)
def operative_C(T: np.ndarray, out: np.ndarray) -> None:
    """Write the operative temperatures of the nodes `T` (n,) into `out` (Z,), °C."""
    n = out.size
    for i in range(n):
        out[i] = drawn_houses.AIR_SHARE * T[AIR * n + i] + (1.0 - drawn_houses.AIR_SHARE) * T[SURFACE * n + i]


@njit(cache=True)
def open_circuit_W(h: HouseNetwork, i: int, T: np.ndarray, supply_C: float) -> float:
    """Return the heat that circuit `i` takes from water of `supply_C` with its valve fully open, W.

    That at which heat taken at design flow and heat emitted are equal, given slab (floor) or room (radiator).
    """
    n = h.strength.size
    sink = T[SLAB * n + i]
    if not h.is_floor[i]:
        sink = h.convective[i] * T[AIR * n + i] + (1.0 - h.convective[i]) * T[SURFACE * n + i]
    over = supply_C - sink
    if over <= 0.0:
        return 0.0
    flow, strength, exponent = h.flow_W_K[i], h.strength[i], h.exponent[i]
    if exponent == 1.0:
        return over * flow * strength / (flow + strength)
    # Newton from above: flow · (over − y) falls and strength · yⁿ rises with the excess y of the water, and is convex.
    y = over
    for _ in range(6):
        emitted = strength * y ** (exponent - 1.0)
        y -= (emitted * y - flow * (over - y)) / (exponent * emitted + flow)
    return flow * (over - y)


@njit(cache=True)
def circuits_W(
    h: HouseNetwork, T: np.ndarray, levels: np.ndarray, own_C: np.ndarray, supply_C: float, q: np.ndarray
) -> float:
    """Write the heat of each circuit into `q` (Z,) and return the sum, W, if the machine supplies `supply_C`.

    A circuit mixes down to `own_C` (Z,), what its heating curve asks for. Its level is the share of what it would take
    with the valve open; no more than design flow carries to its water, and nothing where that is warmer.
    """
    total = 0.0
    for i in range(q.size):
        q[i] = 0.0
        if levels[i] > 0.0:
            water = min(own_C[i], supply_C)
            carried = h.flow_W_K[i] * max(water - T[WATER * q.size + i], 0.0)
            q[i] = min(levels[i] * open_circuit_W(h, i, T, water), carried)
            total += q[i]
    return total


@njit(cache=True)
def _curve_C(h: HouseNetwork, i: int, raised_K: float, T_out_C: float) -> float:
    """Supply temperature, °C, by the heating curve of circuit `i`, raised by so much."""
    curve = h.curve[i]
    return _supply(
        curve[DESIGN], curve[EXPONENT], curve[SHIFT] + raised_K, curve[LIMIT], h.heat_pump[DESIGN_OUT], T_out_C
    )


@njit(cache=True)
def machine(
    h: HouseNetwork, T: np.ndarray, levels: np.ndarray, T_out_C: float, q: np.ndarray
) -> tuple[float, float, float]:
    """Write the heat of each circuit into `q` (Z,) and return heat W, electric power W and supply temperature °C.

    The machine supplies what the heating curve of the warmest open circuit asks for. Where the open circuits would
    take more than its capacity, the supply temperature sinks until they take just that. Below its lowest level the
    machine cycles; power is then a mean in proportion to its on-time. While off, the supply temperature is that of the
    curve.
    """
    n = q.size
    own = np.empty(n)
    supply, any_C = -1e9, -1e9
    for i in range(n):
        own[i] = _curve_C(h, i, 0.0, T_out_C)
        any_C = max(any_C, own[i])
        if levels[i] > 0.0:
            supply = max(supply, own[i])
    heat = circuits_W(h, T, levels, own, supply, q)
    if heat <= 0.0:
        return 0.0, 0.0, any_C
    capacity = _capacity(h.heat_pump[CAPACITY], h.heat_pump[CAPACITY_K], h.heat_pump[DESIGN_OUT], T_out_C)
    if heat > capacity:
        low, high = -50.0, supply
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if circuits_W(h, T, levels, own, middle, q) > capacity:
                high = middle
            else:
                low = middle
        supply = low
        heat = circuits_W(h, T, levels, own, supply, q)
    lowest = h.heat_pump[LOWEST] * capacity
    on = min(heat / lowest, 1.0)
    power = on * (h.heat_pump[FIXED] + max(heat, lowest) / _cop(h.heat_pump[CARNOT], T_out_C, supply))
    return heat, power, supply


@njit(cache=True)
def own_controller(
    h: HouseNetwork,
    T: np.ndarray,
    levels: np.ndarray,
    T_out_C: float,
    q: np.ndarray,
    state: np.ndarray,
    device: np.ndarray,
    contact: float,
    draw_W: float,
    dt: float,
) -> tuple[float, float, float]:
    """As `machine`, of one behind its own controller, whose `state` is advanced by `dt` s, see `device`."""
    n = q.size
    asked = np.empty(n)
    raised, wanted, is_open = device[RAISE] if contact >= RECOMMENDED else 0.0, -1e9, False
    for i in range(n):
        asked[i] = _curve_C(h, i, raised, T_out_C)
        if levels[i] > 0.0:
            wanted, is_open = max(wanted, asked[i]), True
    switched(state, device, wanted, is_open, contact, dt)
    water = state[BUFFER]
    taken = circuits_W(h, T, levels, asked, water, q)
    capacity = _capacity(h.heat_pump[CAPACITY], h.heat_pump[CAPACITY_K], h.heat_pump[DESIGN_OUT], T_out_C)
    least = h.heat_pump[LOWEST] * capacity
    was_tank = state[TANK_STATE]
    heat, defrosts = heat_of_device(state, device, taken, wanted, least, capacity, T_out_C, draw_W, dt)
    power = device[STANDBY]
    if defrosts > 0.0:
        power += h.heat_pump[FIXED] + DEFROST_POWER * capacity
    elif heat > 0.0:
        condenses = was_tank + device[TANK_OVER] if state[CHARGES] > 0.0 else max(water, wanted)
        power += h.heat_pump[FIXED] + heat / _cop(h.heat_pump[CARNOT], T_out_C, condenses)
    return taken, power, water


@njit(cache=True)
def thermostats(on: np.ndarray, room_C: np.ndarray, setpoint_C: np.ndarray) -> None:
    """Switch the rooms' native thermostats `on` (Z,), 0 or 1, at half a dead band from their set-points."""
    for i in range(on.size):
        error = setpoint_C[i] - room_C[i]
        if error > DEAD_BAND_K:
            on[i] = 1.0
        elif error < -DEAD_BAND_K:
            on[i] = 0.0


@njit(cache=True, nogil=True)
def advance(
    T: np.ndarray,
    on: np.ndarray,
    time_s: float,
    n_steps: int,
    dt: float,
    forced: np.ndarray,
    weather: np.ndarray,
    gains: np.ndarray,
    setpoints: np.ndarray,
    h: HouseNetwork,
    record: np.ndarray,
    state: np.ndarray,
    device: np.ndarray,
    draws: np.ndarray,
    contact: float,
    leads: int,
) -> None:
    """Advance nodes `T` (5 Z,) °C and thermostats `on` (Z,) in place by `n_steps` of `dt` s and fill `record`.

    Args:
        time_s: time at the start, s since 1 January.
        forced: levels in [0, 1], shape (Z,); NaN: native control.
        weather: year every 15 min, shape (35041, 2 + 2 Z), see `T_OUT` and following; interpolated.
        gains, setpoints: internal gains W and native set-points °C, shape (35041, Z); held for 15 min.
        record: one row per step, shape (n_steps, 9 + 4 Z), see `POWER` and following.
        state, device, draws: of the machine's own controller, see `device`; no `device`: an ideal machine.
        contact: state of its SG-Ready contacts.
        leads: room whose thermostat switches all circuits; −1: each room's switches its own.
    """
    n = on.size
    nodes = T.size
    fixed = -h.between_W_K
    for k in range(nodes):
        fixed[k, k] = h.capacity_J_K[k] / dt + h.between_W_K[k].sum() + h.outdoors_W_K[k] + h.ground_W_K[k]
    a, b, w = np.empty((nodes, nodes)), np.empty(nodes), np.empty(SUN + 2 * n)
    room_C, levels, q = np.empty(n), np.empty(n), np.empty(n)
    operative_C(T, room_C)
    for k in range(n_steps):
        now = time_s + k * dt
        row = drawn_houses.read(weather, now, w)
        thermostats(on, room_C, setpoints[row])
        if leads >= 0:
            on[:] = on[leads]
        for i in range(n):
            levels[i] = on[i] if math.isnan(forced[i]) else forced[i]
        if device.size:
            heat, power, supply = own_controller(h, T, levels, w[T_OUT], q, state, device, contact, draws[row], dt)
        else:
            heat, power, supply = machine(h, T, levels, w[T_OUT], q)
        raised = device[RAISE] if device.size and contact >= RECOMMENDED else 0.0
        for i in range(n):
            record[k, ROOMS + 3 * n + i] = min(_curve_C(h, i, raised, w[T_OUT]), supply)
        # Weather at the end of the step, schedules of its start.
        drawn_houses.read(weather, now + dt, w)
        T_out = w[T_OUT]

        a[:] = fixed
        for i in range(nodes):
            b[i] = h.capacity_J_K[i] / dt * T[i] + h.outdoors_W_K[i] * T_out + h.ground_W_K[i] * h.ground_C
        for i in range(n):
            water, surface, air, mass = WATER * n + i, SURFACE * n + i, AIR * n + i, MASS * n + i
            b[water] += q[i]
            ventilation = h.ventilation_W_K[i] * w[SUN + n + i]
            a[air, air] += ventilation
            # Half of the internal gains to the air, the rest and the sun to structure and surfaces (EN ISO 13790, C.2).
            radiant = 0.5 * gains[row, i] + w[SUN + i]
            b[air] += ventilation * T_out + 0.5 * gains[row, i]
            b[surface] += (1.0 - h.mass_share) * radiant
            b[mass] += h.mass_share * radiant
            if not h.is_floor[i]:
                excess = T[water] - h.convective[i] * T[air] - (1.0 - h.convective[i]) * T[surface]
                emission = h.strength[i] * max(abs(excess), _LEAST_EXCESS_K) ** (h.exponent[i] - 1.0)
                _couple(a, water, air, h.convective[i] * emission)
                _couple(a, water, surface, (1.0 - h.convective[i]) * emission)
        for d in range(h.door_leak_W_K.size):
            first, second = AIR * n + h.door_rooms[d, 0], AIR * n + h.door_rooms[d, 1]
            _couple(a, first, second, h.door_leak_W_K[d] + h.door_open[d] * math.sqrt(abs(T[first] - T[second])))
        drawn_houses.solve(a, b)

        lost, gained, stored = 0.0, 0.0, 0.0
        for i in range(nodes):
            T[i] = b[i]
            lost += h.outdoors_W_K[i] * (T[i] - T_out) + h.ground_W_K[i] * (T[i] - h.ground_C)
            stored += h.capacity_J_K[i] * T[i]
        operative_C(T, room_C)
        out = record[k]
        for i in range(n):
            lost += h.ventilation_W_K[i] * w[SUN + n + i] * (T[AIR * n + i] - T_out)
            gained += gains[row, i] + w[SUN + i]
            out[ROOMS + i], out[ROOMS + n + i], out[ROOMS + 2 * n + i] = room_C[i], levels[i], q[i]
        out[POWER], out[HEAT], out[SUPPLY] = power, heat, supply
        out[TANK] = state[TANK_STATE] if device.size else math.nan
        out[OUTDOOR], out[SOLAR], out[LOSS], out[GAIN], out[STORED] = T_out, w[GLOBAL], lost, gained, stored


@njit(cache=True, inline="always")
def _couple(a: np.ndarray, i: int, j: int, W_K: float) -> None:
    a[i, i] += W_K
    a[j, j] += W_K
    a[i, j] -= W_K
    a[j, i] -= W_K
