"""Plant and test case of a house of rooms, see `house.DrawnHouse` and docs/how-it-works/random-buildings.md.

When each room is used, its comfort bounds, native set-point, people and internal gains, stands first.
"""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.weather.synthetic import synthetic_weather
from thermoforce_mpc.boundary.weather.year import Weather as WeatherYear
from thermoforce_mpc.data import HOUR_S, Array, Commands, Levels, Measurement, Record
from thermoforce_mpc.data.series import means_between
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.drawn_houses import (
    GRID_S,
    DrawnHousePlant,
    air_change,
    on_facades,
    year,
)
from thermoforce_mpc.plants.people import PERSON_W, at_home, hour_of_day, live, set_back, varying
from thermoforce_mpc.plants.random_houses.plant import PREHEAT_H, SET_BACK_K
from thermoforce_mpc.plants.rooms import physics
from thermoforce_mpc.plants.rooms.device import BLOCKED, N_STATES, NORMAL, Device
from thermoforce_mpc.plants.rooms.draw import MOST_ROOMS, draw_rooms
from thermoforce_mpc.plants.rooms.house import USES, DrawnHouse, Kind, Room
from thermoforce_mpc.plants.shell import check_levels
from thermoforce_mpc.scenario.building import Machine, Zone, ZoneActuator
from thermoforce_mpc.scenario.comfort import THERMOSTAT_INSIDE_K
from thermoforce_mpc.scenario.testcase import MeasuredWeather, TestCase

# Comfort bounds of a room that is not used, °C (BOPTEST's of an empty house).
UNUSED_LOWER_C, UNUSED_UPPER_C = 15.0, 30.0
# Native set-point above the lower bound in use, K: more than the dead band of the thermostat.
NATIVE_ABOVE_K = 0.4
_NIGHT_FROM_H, _NIGHT_TO_H = 22.0, 6.0


def at_home_or_asleep(house: DrawnHouse, time_s: Array) -> NDArray[np.bool_]:
    """Return whether people are in at `time_s`: by the pattern of presence, and in a house from 22 to 6 h."""
    present = at_home(house.pattern, time_s)
    return present if house.use == "office" else np.asarray(present | _night(hour_of_day(time_s)))


def in_use(house: DrawnHouse, kind: Kind, time_s: Array) -> NDArray[np.bool_]:
    """Bedrooms 20 to 9 h, baths 6 to 9 and 18 to 22 h, others 6 to 22 h, while people are in; like `time_s`."""
    hour = hour_of_day(time_s)
    if kind == "bedroom":
        used = (hour < 9.0) | (hour >= 20.0)
    elif kind == "bath":
        used = ((hour >= _NIGHT_TO_H) & (hour < 9.0)) | ((hour >= 18.0) & (hour < _NIGHT_FROM_H))
    else:
        used = ~_night(hour)
    return np.asarray(used & at_home_or_asleep(house, time_s))


def bounds_C(house: DrawnHouse, time_s: Array) -> tuple[Array, Array]:
    """Return lower and upper comfort bounds of the rooms at `time_s` (n,), °C, shape (Z, n) each."""
    used = {kind: in_use(house, kind, time_s) for kind in {room.kind for room in house.rooms}}
    lower = [np.where(used[room.kind], room.lower_C, UNUSED_LOWER_C) for room in house.rooms]
    upper = [np.where(used[room.kind], room.upper_C, UNUSED_UPPER_C) for room in house.rooms]
    return np.array(lower), np.array(upper)


def native_setpoints_C(house: DrawnHouse, time_s: Array) -> Array:
    """Return the rooms' native set-points at `time_s` (n,), °C, shape (Z, n): set back while unused, preheated before.

    Set-back, its shrinking with the machine, and preheating are those of the emitter in a generated house.
    """
    shrink = min(max((house.sizing - 0.8) / 0.5, 0.0), 1.0)
    unused: dict[tuple[str, str], NDArray[np.bool_]] = {}
    rows = []
    for room in house.rooms:
        key = (room.kind, room.emitter)
        if key not in unused:
            unused[key] = set_back(
                lambda t, room=room: in_use(house, room.kind, t),  # type: ignore[misc]
                time_s,
                lead_s=PREHEAT_H[room.emitter] * HOUR_S,
            )
        rows.append(room.lower_C + NATIVE_ABOVE_K - unused[key] * SET_BACK_K[room.emitter] * shrink)
    return np.array(rows)


def people(house: DrawnHouse, time_s: Array) -> Array:
    """Return the expected number of people in each room at `time_s` (n,), shape (Z, n)."""
    return in_rooms(house, time_s, np.where(at_home_or_asleep(house, time_s), float(house.people), 0.0))


def in_rooms(house: DrawnHouse, time_s: Array, home: Array) -> Array:
    """Return people in each room, shape (Z, n), where `home` (n,) of them are in at `time_s` (n,)."""
    night = _night(hour_of_day(time_s))
    return np.array([home * np.where(night, room.people_night, room.people_day) for room in house.rooms])


def gains_W(house: DrawnHouse, time_s: Array) -> Array:
    """Return internal gains of each room on an equally spaced grid `time_s` (n,), W, shape (Z, n).

    People, and appliances that vary at random (see `varying`) in each room on its own, seeded by the house.
    """
    home = at_home(house.pattern, time_s)
    level_W_m2 = np.where(home, house.gains_home_W_m2, house.gains_empty_W_m2)

    def appliances_W(i: int, room: Room) -> Array:
        rng = np.random.default_rng([house.seed, len(house.rooms), 1, i])
        return level_W_m2 * room.appliances * room.area_m2 * varying(rng, time_s, house.gains_sd)

    appliances = np.array([appliances_W(i, room) for i, room in enumerate(house.rooms)])
    return np.asarray(PERSON_W * people(house, time_s) + appliances)


def _night(hour: Array) -> NDArray[np.bool_]:
    return np.asarray((hour >= _NIGHT_FROM_H) | (hour < _NIGHT_TO_H))


# Set-points that the thermostats of rooms take, °C.
LEAST_SETPOINT_C, MOST_SETPOINT_C = 5.0, 30.0
# Seed of the houses `house:Nrooms`.
SEED = 15

_NAME = re.compile(r"(house|office):(\d+)rooms?(?::(\d+))?")


def named_house(name: str) -> DrawnHouse:
    """Return the house `house:Nrooms`, N from 1 to 30, or `house:Nrooms:SEED` of another seed; `office:…` likewise.

    Raises `InputError` where `name` has another form, or N is out of range.
    """
    match = _NAME.fullmatch(name)
    if match is None or not 1 <= int(match[2]) <= MOST_ROOMS:
        raise InputError(
            f"house '{name}': expected house:Nrooms, house:Nrooms:SEED or office:… with N from 1 to {MOST_ROOMS}, "
            "such as house:5rooms"
        )
    return draw_rooms(int(match[2]), int(match[3] or SEED), USES[match[1]])


def house_of_rooms(name: str, people: int | None = None, highly_dynamic: tariffs.Tariff | None = None) -> HouseOfRooms:
    """Return the plant of a house, see `named_house`.

    `people`: seed of people who do not keep to the schedule; `highly_dynamic` replaces the tariff of that name.
    """
    return HouseOfRooms(named_house(name), people, highly_dynamic)


def house_testcase(name: str) -> TestCase:
    """Return the test case of a house or an office, see `named_house`."""
    return testcase_of(named_house(name), name)


def testcase_of(house: DrawnHouse, name: str) -> TestCase:
    """Return the test case of a house by `name`: its zones, valves and heat pump."""
    zones, actuators = {}, {}
    for room in house.rooms:
        zones[room.name] = Zone(
            temperature=f"T_zone[{room.name}]",
            floor_area_m2=float(room.area_m2),
            occupancy=f"occupancy[{room.name}]",
            lower=f"lower[{room.name}]",
            upper=f"upper[{room.name}]",
            thermostat_C=room.lower_C + THERMOSTAT_INSIDE_K,
        )
        valve, share = f"{room.name}_valve", room.emitter_W / house.heat_pump.capacity_W
        heat = (f"heat[{room.name}]",)
        actuators[valve] = ZoneActuator(point=valve, zone=room.name, machine="heat_pump", heat=heat, share=share)
    return TestCase(
        name=name,
        description=house.words,
        step_s=900.0,
        measurements=MeasuredWeather(outdoor_temperature="T_out", solar="solar"),
        zones=zones,
        actuators=actuators,
        machines={"heat_pump": Machine(power=("power",))},
        plant="rooms",
    )


class HouseOfRooms(DrawnHousePlant):
    """A drawn house with a valve in each room and one heat pump.

    A level is the share of the heat that the circuit would take now with its valve fully open, at design flow and the
    supply temperature of the moment; 0 is none, and more level is never less heat to the circuit. None leaves a valve
    to its thermostat. The thermostats of all rooms go on switching, so that native control takes over where it would
    stand. A command of a valve is the set-point of its thermostat, °C, which then acts.

    Attributes:
        curve_offset_K: offset of the heating curves of all circuits, K.
        flow_target_C: temperature of the water that is set for all circuits, °C, up to the limit of each; None: what
            their heating curves ask for.
        device: the controller of the heat pump itself; None: an ideal machine, which gives what is asked at once.
        reference: the room whose thermostat switches all circuits, whose valves are open otherwise; None: each room's
            switches its own. Commands of all valves are then its set-point.
        contact: state of its SG-Ready contacts, from 1 to 4; only with a device.
        is_enabled: its enable contact: whether it may run at all; only with a device.
        tank_target_C: target of the tank of hot water, °C; None: the device's own.
        charges: whether the tank is charged up to its target now, however little is missing.
        layout: rooms, valves and the heat pump; valve i stands in room i.
        zones, actuators: names by row of all arrays.
        thermostat_C: of the baseline thermostat of each room, shape (Z,).
    """

    house: DrawnHouse
    curve_offset_K: float = 0.0
    flow_target_C: float | None = None
    device: Device | None = None
    reference: str | None = None
    contact: int = NORMAL
    is_enabled: bool = True
    tank_target_C: float | None = None
    charges: bool = False
    _told: tuple[float | None, ...] = ()
    _kind = "house of rooms"
    _changing = (*DrawnHousePlant._changing, "_T", "_on", "_device_state")

    def __init__(
        self, house: DrawnHouse, people: int | None = None, highly_dynamic: tariffs.Tariff | None = None
    ) -> None:
        self.house = house
        self.weather = synthetic_weather(house.weather_seed, warmer_K=house.warmer_K, clearer=house.clearer)
        self.layout = testcase_of(house, house.name).layout
        self._names = self.layout.names
        self.zones, self.actuators = self._names.zones, self._names.actuators
        self.thermostat_C = np.array([room.lower_C for room in house.rooms]) + THERMOSTAT_INSIDE_K
        time_s = year()
        gains = np.ascontiguousarray(gains_W(house, time_s).T)
        self._scheduled = weather_grid(house, self.weather), gains
        self._lived = self._scheduled if people is None else _with_people(*self._scheduled, house, people)
        self._setpoints = np.ascontiguousarray(native_setpoints_C(house, time_s).T)
        self._network = physics.network(house)
        self._tariffs = tariffs.by_name(highly_dynamic)
        self.reset(0.0, 0.0)

    def _heat_year(self) -> tuple[Array, Array, Array]:
        weather, gains = self._scheduled
        T_out_C = weather[:, physics.T_OUT]
        heat_W = gains.sum(axis=1) + weather[:, physics.SUN : physics.SUN + len(self.zones)].sum(axis=1)
        return T_out_C, weather[:, physics.GLOBAL], self.house.loss_W_K * (20.0 - T_out_C) - heat_W

    def _bounds_C(self, time_s: Array) -> tuple[Array, Array]:
        return bounds_C(self.house, time_s)

    def _people(self, time_s: Array) -> Array:
        return people(self.house, time_s)

    def _power_and_rooms(self, rows: Array) -> tuple[Array, Array]:
        return rows[:, physics.POWER], rows[:, self._blocks()[0]].T

    def _past(self, edges: Array) -> Record:
        times, rows = self._samples.times, self._samples.rows

        def sampled(column: int) -> Array:
            return np.interp(edges, times, rows[:, column])

        rooms, valves, heats = self._blocks()
        return Record(
            names=self.layout.names,
            time_s=edges,
            T_zone_C=np.array([sampled(column) for column in rooms]),
            T_out_C=sampled(physics.OUTDOOR),
            solar_W_m2=sampled(physics.SOLAR),
            u=means_between(times, rows[1:, valves].T, edges),
            heat_W=means_between(times, rows[1:, heats].T, edges),
            power_W=means_between(times, rows[1:, [physics.POWER]].T, edges),
        )

    def recorded(self, start_s: float, final_s: float) -> tuple[Array, Array]:
        """Return times (n,), s, and rows (n, 9 + 4 Z) of `physics.advance` between two times, both included."""
        return self._samples.between(start_s, final_s)

    def flow_C(self, edges: Array) -> Array:
        """Mean temperature between `edges` (n + 1,), s, of the water that flows into each circuit: (Z, n), °C."""
        times, rows, n = self._samples.times, self._samples.rows, len(self.zones)
        return means_between(times, rows[1:, physics.ROOMS + 3 * n : physics.ROOMS + 4 * n].T, edges)

    def tank_C(self, start_s: float, final_s: float) -> tuple[Array, Array]:
        """Times (n,), s, and temperature of the tank of hot water (n,), °C, NaN without one; as `recorded`."""
        time_s, rows = self.recorded(start_s, final_s)
        return time_s, rows[:, physics.TANK]

    def _blocks(self) -> tuple[range, range, range]:
        """Columns of the rows with temperatures, levels and heat."""
        n = len(self.zones)
        first = physics.ROOMS
        return range(first, first + n), range(first + n, first + 2 * n), range(first + 2 * n, first + 3 * n)

    def advance(self, u: Levels, duration_s: float, command: Commands = None) -> Measurement:
        """As `PlantShell.advance`, or with thermostats at set-points `command` (A,), °C, where they are not None."""
        block = check_levels(u, duration_s, command, names=self._names)
        if self.device is None and (self.contact != NORMAL or not self.is_enabled):
            raise InputError("contact, is_enabled: contacts are of the heat pump's own controller: give it a device")
        told = [value if value is None or isinstance(value, float | int) else math.nan for value in block.command]
        for name, value in zip(self.actuators, told, strict=True):
            if value is not None and not LEAST_SETPOINT_C <= value <= MOST_SETPOINT_C:
                raise InputError(
                    f"command of '{name}': its thermostat takes a set-point from {LEAST_SETPOINT_C:g} to "
                    f"{MOST_SETPOINT_C:g} °C"
                )
        if self.reference is not None:
            if self.reference not in self.zones:
                raise InputError(f"reference: there is no room '{self.reference}'; there are {', '.join(self.zones)}")
            if len(set(told)) > 1:
                raise InputError(f"command: the thermostat in {self.reference} sets all rooms: give all the same")
        self._told = tuple(told)
        try:
            return self._advanced(block)
        finally:
            self._told = ()

    def _simulate(self, forced: Array, before_s: float, dt_s: float, rows: Array) -> None:
        weather, gains = self._lived
        setpoints, network = self._setpoints, self._network
        leads = -1 if self.reference is None else self.zones.index(self.reference)
        if any(value is not None for value in self._told):
            setpoints, forced = setpoints.copy(), forced.copy()
            first, last = (int(t // GRID_S) for t in (before_s, before_s + len(rows) * dt_s))
            for a, value in enumerate(self._told):
                if value is not None:
                    forced[a], setpoints[first : last + 1, a if leads < 0 else leads] = math.nan, value
        if self.curve_offset_K or self.flow_target_C is not None:
            curve = network.curve.copy()
            if self.flow_target_C is not None:  # a curve that is the same in all weather
                curve[:, physics.DESIGN], curve[:, physics.SHIFT] = 20.0, self.flow_target_C - 20.0
            curve[:, physics.SHIFT] += self.curve_offset_K
            network = network._replace(curve=curve)
        state = self._T, self._on, before_s, len(rows), dt_s
        parameters, draws = np.empty(0), np.empty(0)
        if self.device is not None:
            parameters, draws = self.device.told(self.tank_target_C, self.charges), self.device.draw_W
        own = self._device_state, parameters, draws, float(self.contact if self.is_enabled else BLOCKED)
        physics.advance(*state, forced, weather, gains, setpoints, network, rows, *own, leads)

    def _measured(self, before_s: float) -> Measurement:
        rooms, valves, heats = self._blocks()
        row = self._samples.rows[-1]
        columns = [*valves, *heats, physics.POWER, physics.SUPPLY]
        means = np.full(len(columns), math.nan)
        if before_s < self._now_s:
            time_s, rows = self.recorded(before_s, self._now_s)
            means = means_between(time_s, rows[1:, columns].T, np.array([before_s, self._now_s]))[:, 0]
        n = len(self.actuators)
        return Measurement(
            names=self.layout.names,
            time_s=self._now_s,
            T_zone_C=row[rooms].copy(),
            T_out_C=float(row[physics.OUTDOOR]),
            solar_W_m2=float(row[physics.SOLAR]),
            u=means[:n],
            heat_W=means[n : 2 * n],
            power_W=means[2 * n : 2 * n + 1],
            points={"T_supply_C": float(means[2 * n + 1]), "T_tank_C": float(row[physics.TANK])},
        )

    def _first_row(self) -> Array:
        n = len(self.zones)
        self._T = np.tile([room.lower_C for room in self.house.rooms], physics.N_BLOCKS)
        self._on = np.zeros(n)
        self._device_state = np.zeros(N_STATES) if self.device is None else self.device.begin()
        row = np.zeros(physics.ROOMS + 4 * n)
        row[self._blocks()[0]] = self._T[:n]
        row[physics.OUTDOOR], row[physics.SOLAR] = self._weather_now()
        row[physics.STORED] = float(self._network.capacity_J_K @ self._T)
        off = np.zeros(n)
        _, _, row[physics.SUPPLY] = physics.machine(
            self._network, self._T, off, float(row[physics.OUTDOOR]), off.copy()
        )
        row[physics.ROOMS + 3 * n :] = row[physics.SUPPLY]
        return row


def weather_grid(house: DrawnHouse, weather: WeatherYear) -> Array:
    """Return weather and sun through the windows every 15 min of a year, (35041, 2 + 2 Z), see `physics`; 0.5 s."""
    time_s, n = year(), len(house.rooms)
    windows = np.array([room.windows_m2 for room in house.rooms])
    grid = np.zeros((time_s.size, physics.SUN + 2 * n))
    grid[:, physics.T_OUT] = weather.at("T_dry_C", time_s)
    grid[:, physics.GLOBAL] = weather.at("global_W_m2", time_s)
    grid[:, physics.SUN + n :] = air_change(weather, time_s)[:, None]
    for i, (passing, _) in enumerate(on_facades(weather, time_s, house.turn_deg)):
        grid[:, physics.SUN : physics.SUN + n] += house.unshaded * house.g_value * np.outer(passing, windows[:, i])
    grid.setflags(write=False)
    return grid


def _with_people(weather: Array, gains: Array, house: DrawnHouse, seed: int) -> tuple[Array, Array]:
    time_s, n = year(), len(house.rooms)
    usual = at_home_or_asleep(house, time_s)
    life = live(
        [seed, house.seed, n],
        usual,
        house.people,
        T_out_C=weather[:, physics.T_OUT],
        solar_W_m2=weather[:, physics.GLOBAL],
        zones=n,
        cooks=house.use == "house",
    )
    kitchen = max(range(n), key=lambda i: (house.rooms[i].kind == "kitchen", house.rooms[i].kind == "living"))
    heat_W = PERSON_W * in_rooms(house, time_s, life.present - house.people * usual)
    heat_W[kitchen] += life.cooking_W
    shaded = weather.copy()
    shaded[:, physics.SUN : physics.SUN + n] *= life.sun.T
    shaded[:, physics.SUN + n :] += life.windows_1_h.T / house.air_changes_1_h
    shaded.setflags(write=False)  # as `weather`: numba compiles anew for an array that may be written
    return shaded, np.ascontiguousarray(gains + heat_W.T)
