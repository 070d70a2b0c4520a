"""House of rooms: energy balance, steady state, circuits, shared capacity and the effect of each valve on each room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.plants.drawn_houses import STEP_S
from thermoforce_mpc.plants.random_houses.draw import heat_pump_cop
from thermoforce_mpc.plants.rooms import DrawnHouse, HouseOfRooms, draw_rooms, physics
from thermoforce_mpc.plants.rooms.house import HOUSE, OFFICE, curve_supply_C

SEED = 7
ROWS = 35041


def house_with(emitters: set[str], n: int = 5, storeys: int | None = None) -> DrawnHouse:
    """The first drawn house, or office with air, whose rooms have just these emitters."""
    for seed in range(SEED, SEED + 300):
        house = draw_rooms(n, seed, OFFICE if "air" in emitters else HOUSE)
        if {room.emitter for room in house.rooms} == emitters and storeys in (None, house.storeys):
            return house
    raise AssertionError(f"no house with {emitters}")


def supply_C(house: DrawnHouse, emitter: str, T_out: float) -> float:
    """What the heating curve of an emitter asks for."""
    c = house.curves[emitter]
    return curve_supply_C(c.design_C, c.exponent, c.shift_K, c.limit_C, house.design_out_C, T_out)


def strong(house: DrawnHouse) -> DrawnHouse:
    """The house with a heat pump that is never too small."""
    return replace(house, heat_pump=replace(house.heat_pump, capacity_W=10.0 * house.heat_pump.capacity_W))


class Still:
    """A house without sun, gains and schedules at one outdoor temperature, from 20 °C throughout."""

    def __init__(self, house: DrawnHouse, T_out: float = 2.0, gains: float = 0.0) -> None:
        n = len(house.rooms)
        self.h, self.n = physics.network(house), n
        self.weather = np.zeros((ROWS, physics.SUN + 2 * n))
        self.weather[:, physics.T_OUT], self.weather[:, physics.SUN + n :] = T_out, 1.0
        self.weather.setflags(write=False)  # as a plant's own: numba compiles anew for an array that may be written
        self.gains = np.full((ROWS, n), gains)
        self.T, self.on, self.now = np.full(physics.N_BLOCKS * n, 20.0), np.zeros(n), 0.0

    def run(self, levels, hours: float, setpoint: float = 20.0) -> np.ndarray:
        rows = np.empty((round(hours * 120), physics.ROOMS + 4 * self.n))
        setpoints = np.full((ROWS, self.n), setpoint)
        forced = np.broadcast_to(np.asarray(levels, dtype=float), (self.n,)).copy()
        physics.advance(
            self.T,
            self.on,
            self.now,
            len(rows),
            30.0,
            forced,
            self.weather,
            self.gains,
            setpoints,
            self.h,
            rows,
            np.zeros(0),
            np.zeros(0),
            np.zeros(0),
            2.0,
            -1,
        )
        self.now += hours * HOUR_S
        return rows

    def rooms(self, rows: np.ndarray) -> np.ndarray:
        return rows[:, physics.ROOMS : physics.ROOMS + self.n].T

    def heats(self, rows: np.ndarray) -> np.ndarray:
        return rows[:, physics.ROOMS + 2 * self.n : physics.ROOMS + 3 * self.n].T


@pytest.mark.slow
@pytest.mark.parametrize("emitters", [{"floor"}, {"radiator"}, {"floor", "radiator"}, {"air"}])
def test_the_energy_balance_closes(emitters):
    plant = HouseOfRooms(house_with(emitters))
    plant.reset(40 * DAY_S, 0.0)
    rng = np.random.default_rng(0)
    for _ in range(48):
        levels = np.where(rng.uniform(size=5) < 0.3, np.nan, rng.uniform(size=5) * (rng.uniform(size=5) < 0.7))
        plant.advance([None if np.isnan(level) else level for level in levels], HOUR_S)
    _, rows = plant.recorded(40 * DAY_S, 42 * DAY_S)
    stored = rows[-1, physics.STORED] - rows[0, physics.STORED]
    into = STEP_S * (rows[:, physics.HEAT] + rows[:, physics.GAIN] - rows[:, physics.LOSS])[1:].sum()
    assert rows[:, physics.HEAT].max() > 0
    assert stored == pytest.approx(into, abs=1e-9 * STEP_S * rows[1:, physics.LOSS].sum())
    assert rows[:, physics.HEAT] == pytest.approx(rows[:, physics.ROOMS + 10 : physics.ROOMS + 15].sum(axis=1))


@pytest.mark.slow
def test_steady_state_of_one_room_is_that_of_the_hand_calculation():
    house = house_with({"radiator"}, n=1)
    room = house.rooms[0]
    still = Still(house, T_out=-3.0)
    rows = still.run(0.5, 24 * 90)
    Q = rows[-1, physics.HEAT]
    # Heat of the radiator, 70 % to the air. Air and surfaces behind a film, structure at the surfaces' temperature in
    # series with the walls; ground below it.
    film, deep = 3.45 * 4.5 * room.area_m2, 9.1 * still.h.mass_share * 4.5 * room.area_m2
    outer = 1.0 / (1.0 / room.opaque_W_K - 1.0 / deep)
    vent = house.ventilation_W_K(room)
    a = np.array(
        [
            [film + vent, -film, 0.0],
            [-film, film + deep + room.windows_W_K, -deep],
            [0.0, -deep, deep + outer + room.ground_W_K],
        ]
    )
    ground = room.ground_W_K * (10.3 + house.warmer_K)
    b = [0.7 * Q + vent * -3.0, 0.3 * Q + room.windows_W_K * -3.0, outer * -3.0 + ground]
    air, surface, _ = np.linalg.solve(a, b)
    assert still.rooms(rows)[0, -1] == pytest.approx(0.3 * air + 0.7 * surface, abs=1e-3)
    assert rows[-1, physics.LOSS] == pytest.approx(Q, rel=1e-4)


def test_radiator_output_follows_en_442_and_its_water_carries_it():
    house = strong(house_with({"radiator"}, n=2))
    still = Still(house)
    rows = still.run(1.0, 24 * 20)
    n = still.n
    for i, room in enumerate(house.rooms):
        mixed = 0.7 * still.T[physics.AIR * n + i] + 0.3 * still.T[physics.SURFACE * n + i]
        water, q = still.T[physics.WATER * n + i], still.heats(rows)[i, -1]
        assert q == pytest.approx(room.emitter_W_Kn * (water - mixed) ** 1.3, rel=1e-3)
        assert q == pytest.approx(room.flow_W_K * (supply_C(house, "radiator", 2.0) - water), rel=1e-3)


@pytest.mark.parametrize("emitters", [{"floor"}, {"radiator"}, {"air"}])
def test_level_is_the_share_of_the_heat_an_open_circuit_would_take(emitters):
    still = Still(strong(house_with(emitters)))
    q = np.zeros(still.n)
    taken = []
    for level in (0.0, 0.25, 0.5, 1.0):
        physics.machine(still.h, still.T, np.full(still.n, level), 2.0, q)
        taken.append(q.copy())
    taken = np.array(taken)
    assert (taken[0] == 0).all()
    assert (taken[-1] > 0).all()
    np.testing.assert_allclose(taken, np.outer([0.0, 0.25, 0.5, 1.0], taken[-1]))
    # Water warmer than the supply takes nothing; it never gives.
    still.T[: still.n] = 70.0
    assert physics.machine(still.h, still.T, np.ones(still.n), 2.0, q)[:2] == (0.0, 0.0)
    assert (q == 0).all()


@pytest.mark.parametrize("emitter", ["radiator", "air"])
def test_full_level_at_design_is_the_emitters_design_heat_and_the_curves_reserve(emitter):
    house = strong(house_with({emitter}))
    still = Still(house)
    for i, room in enumerate(house.rooms):
        still.T[:] = room.lower_C + 1.0
        plain = house.curves[emitter].design_C
        assert physics.open_circuit_W(still.h, i, still.T, plain) == pytest.approx(room.emitter_W, rel=1e-6)
    assert supply_C(house, emitter, house.design_out_C) == pytest.approx(plain + house.curves[emitter].shift_K)
    assert supply_C(house, emitter, -40.0) == 60.0
    assert supply_C(house, emitter, 25.0) == pytest.approx(20.0 + house.curves[emitter].shift_K)


@pytest.mark.parametrize("emitters", [{"floor"}, {"radiator"}, {"floor", "radiator"}, {"air"}])
def test_open_valves_share_the_capacity(emitters):
    house = house_with(emitters)
    small = replace(house, heat_pump=replace(house.heat_pump, capacity_W=0.4 * house.design_load_W))
    still = Still(small, T_out=house.design_out_C)
    q = np.zeros(still.n)

    def heats(levels) -> tuple[float, float, np.ndarray]:
        heat, _, supply = physics.machine(still.h, still.T, np.array(levels, dtype=float), house.design_out_C, q)
        assert heat == pytest.approx(q.sum())
        return heat, supply, q.copy()

    heat, supply, all_open = heats(np.ones(still.n))
    assert heat == pytest.approx(small.heat_pump.capacity_W, rel=1e-6)
    assert supply < max(supply_C(small, emitter, house.design_out_C) for emitter in emitters) - 1.0
    assert (all_open > 0).all()
    # Where one closes, the supply is warmer and each of the others has more.
    _, warmer, others = heats([0.0, *np.ones(still.n - 1)])
    assert warmer > supply
    assert others[0] == 0.0
    assert (others[1:] > all_open[1:]).all()
    # Half a level of one is less heat for it and more for the others, the sum being the capacity.
    half, _, some = heats([0.5, *np.ones(still.n - 1)])
    assert half == pytest.approx(small.heat_pump.capacity_W, rel=1e-6)
    assert 0 < some[0] < all_open[0]
    assert (some[1:] > all_open[1:]).all()


def test_the_machine_supplies_what_the_warmest_open_circuit_asks_and_pays_for_it():
    house = strong(house_with({"floor", "radiator"}))
    still = Still(house)
    floors = np.array([room.emitter == "floor" for room in house.rooms], dtype=float)
    heat, power, supply = physics.machine(still.h, still.T, floors, 2.0, np.zeros(still.n))
    assert supply == pytest.approx(supply_C(house, "floor", 2.0))
    q = np.zeros(still.n)
    mixed_heat, mixed_power, mixed_supply = physics.machine(still.h, still.T, np.ones(still.n), 2.0, q)
    assert mixed_supply == pytest.approx(supply_C(house, "radiator", 2.0))
    assert mixed_supply > supply
    assert q[floors > 0].sum() == pytest.approx(heat)  # floors mix down to their own curve
    machine = house.heat_pump
    lowest = machine.lowest_level * machine.capacity_W * (1 + 0.02 * (2.0 - house.design_out_C))
    assert mixed_heat < lowest  # so strong a machine cycles
    for q_W, watts, water in ((heat, power, supply), (mixed_heat, mixed_power, mixed_supply)):
        on = q_W / lowest
        assert watts == pytest.approx(on * (machine.fixed_W + lowest / heat_pump_cop(machine.carnot, 2.0, water)))


def test_above_its_lowest_level_the_machine_runs_through_and_below_it_cycles():
    house = house_with({"radiator"})
    still = Still(house)
    machine = house.heat_pump
    capacity = machine.capacity_W * (1 + 0.02 * (2.0 - house.design_out_C))
    q = np.zeros(still.n)
    low = [physics.machine(still.h, still.T, np.full(still.n, u), 2.0, q)[:2] for u in (0.05, 0.1)]
    assert low[1][0] < machine.lowest_level * capacity
    np.testing.assert_allclose(low[1], 2.0 * np.array(low[0]))
    heat, power, supply = physics.machine(still.h, still.T, np.full(still.n, 0.6), 2.0, q)
    assert machine.lowest_level * capacity < heat < capacity
    assert power == pytest.approx(machine.fixed_W + heat / heat_pump_cop(machine.carnot, 2.0, supply))


@pytest.mark.parametrize("emitters", [{"floor"}, {"radiator"}, {"floor", "radiator"}, {"air"}])
def test_more_level_of_one_valve_never_cools_any_room(emitters):
    house = strong(house_with(emitters))
    rng = np.random.default_rng(1)
    for valve in range(5):
        lower, higher = Still(house), Still(house)
        for _ in range(24):
            levels = rng.uniform(size=5) * (rng.uniform(size=5) < 0.6)
            more = levels.copy()
            more[valve] = rng.uniform(levels[valve], 1.0)
            effect = higher.rooms(higher.run(more, 0.5)) - lower.rooms(lower.run(levels, 0.5))
            assert effect.min() >= -1e-9
        assert (effect[:, -1] > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("emitters", [{"floor"}, {"radiator"}])
@pytest.mark.parametrize("storeys", [1, 2])
def test_a_valve_warms_its_own_room_most_and_first(emitters, storeys):
    house = strong(house_with(emitters, storeys=storeys))
    for valve in range(5):
        idle, pulsed = Still(house), Still(house)
        pulse = np.zeros(5)
        pulse[valve] = 1.0
        effect = np.hstack([pulsed.rooms(pulsed.run(u, hours)) for u, hours in ((pulse, 1.0), (np.zeros(5), 71.0))])
        effect -= idle.rooms(idle.run(0.0, 72.0))
        peak, when = effect.max(axis=1), effect.argmax(axis=1)
        others = np.arange(5) != valve
        assert effect.min() >= -1e-9
        assert (peak[others] < 0.5 * peak[valve]).all()
        assert (peak[others] > 0).all()
        assert (when[others] > when[valve]).all()


def test_an_open_door_carries_more_than_a_wall_and_grows_with_the_difference():
    house = house_with({"radiator"}, n=2)
    door = house.doors[0]
    shut = Still(replace(house, doors=(replace(door, open_W_K15=0.0),)))
    ajar = Still(replace(house, doors=(replace(door, open_W_K15=100.0),)))
    flows = []
    for still in (shut, ajar):
        still.T[physics.AIR * 2] = 24.0
        still.run(0.0, 1.0 / 120.0)
        flows.append(still.T[physics.AIR * 2 + 1])
    assert flows[1] > flows[0] + 0.1
    # 4 K: 100 · √4 W/K beside the leak, implicit over the step.
    gained = still.h.capacity_J_K[physics.AIR * 2 + 1] / 30.0 * (flows[1] - flows[0])
    assert 0.7 * 200.0 * 4.0 < gained < 200.0 * 4.0


def test_walls_and_floors_conduct_between_rooms_as_drawn():
    house = house_with({"radiator"}, storeys=2)
    h = physics.network(house)
    n = len(house.rooms)
    block = h.between_W_K[physics.MASS * n :, physics.MASS * n :]
    assert (h.between_W_K == h.between_W_K.T).all()
    for c in house.contacts:
        U = house.U_wall_inside if c.kind == "wall" else house.U_floor_inside
        films = 2.0 * 0.13 / c.area_m2
        assert 1.0 / (1.0 / block[c.first, c.second] + films) == pytest.approx(U * c.area_m2)
    heated = house_with({"floor"}, storeys=2)
    g = physics.network(heated).between_W_K
    c = next(c for c in heated.contacts if c.kind == "floor")
    assert g[physics.MASS * n + c.first, physics.SLAB * n + c.second] > 0
    assert g[physics.MASS * n + c.first, physics.MASS * n + c.second] == 0


def test_one_valve_without_a_level_is_left_to_its_own_thermostat():
    house = strong(house_with({"radiator"}))
    still = Still(house)
    rows = still.run([0.0, np.nan, 0.3, 0.3, 0.3], 24.0, setpoint=19.0)
    levels = rows[:, physics.ROOMS + still.n : physics.ROOMS + 2 * still.n]
    assert (levels[:, 0] == 0).all()
    assert set(np.unique(levels[:, 1])) == {0.0, 1.0}
    settled = still.rooms(rows)[1, 12 * 120 :]
    switched = np.flatnonzero(np.diff(levels[:, 1]))
    for k in switched:  # the level of a row follows from the temperature of the row before
        before = still.rooms(rows)[1, k]
        assert before < 18.75 if levels[k + 1, 1] else before > 19.25
    assert 18.5 < settled.mean() < 19.5
